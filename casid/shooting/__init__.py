"""Output error by multiple shooting, and what it says of its own precision."""
