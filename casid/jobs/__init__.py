"""Work in many processes, kept as soon as it is done and taken up where it stopped."""
