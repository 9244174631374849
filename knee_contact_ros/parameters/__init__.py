"""From names in a file to a model."""
