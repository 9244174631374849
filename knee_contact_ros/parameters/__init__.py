"""Reads parameters, and builds models from them."""
