"""The door for a bag."""
