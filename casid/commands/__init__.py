"""What the command line does beside identifying."""
