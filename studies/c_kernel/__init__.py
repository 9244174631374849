"""The compiled kernel against the same algorithm in C."""
