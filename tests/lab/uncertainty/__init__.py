"""Uncertainty of inputs and parameters."""
