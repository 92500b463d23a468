"""Bounds compared, priced and reduced: many fits side by side, on any executor."""
