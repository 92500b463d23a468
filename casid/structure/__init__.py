"""Structures from files, laid open and judged before any fit."""
