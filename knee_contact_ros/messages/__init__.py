"""Bytes of messages, and the numbers in them."""
