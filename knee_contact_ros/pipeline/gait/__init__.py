"""Gait events in angle and load: NumPy only."""
