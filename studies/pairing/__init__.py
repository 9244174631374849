"""Pairing under disturbances of the stamps, held against a plain account of what every good sample must get."""
