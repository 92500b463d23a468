"""What to fly next: inputs that tell the parameters of a structure apart, within limits."""
