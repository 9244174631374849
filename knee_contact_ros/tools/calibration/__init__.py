"""From measured depth, force or gap to the parameters of the model, with intervals."""
