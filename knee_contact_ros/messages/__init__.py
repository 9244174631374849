"""Conversion between the bytes of messages and their contents."""
