"""Gait events in flexion angle and load; needs NumPy only."""
