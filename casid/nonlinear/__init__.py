"""Structures that are nonlinear in their states and inputs, and their linearisations."""
