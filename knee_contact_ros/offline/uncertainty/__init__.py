"""How far depth and force may be off because angle, load, share or a constant of the knee is not known exactly."""
