"""Recordings: written, read, recovered."""
