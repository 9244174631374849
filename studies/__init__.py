"""Studies of the model: measured here, kept in docs, and run again with `make studies`."""
