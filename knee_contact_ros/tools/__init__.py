"""What is not needed to compute: each a command of its own; none imports another."""
