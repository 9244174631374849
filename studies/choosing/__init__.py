"""What level, tolerance and geometry cost and leave out, and what the inputs leave open: docs/studies/choosing.md."""
