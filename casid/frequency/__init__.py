"""Frequency responses of records, and of other tools."""
