"""Reads what can be read of damaged recordings, and knows what is missing."""
