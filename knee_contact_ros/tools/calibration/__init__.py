"""Calibration: fit parameters of the model to a measured depth, force or gap, with intervals."""
