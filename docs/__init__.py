"""Programs of the documentation."""
