"""Logs of autopilots and flight-test recorders: what is in them, and records made of it."""
