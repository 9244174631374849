"""From OpenSim to a gait bag."""
