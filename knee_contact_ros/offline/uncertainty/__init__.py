"""Standard deviations of depth and force that follow from those of angle, load, share and constants of the knee."""
