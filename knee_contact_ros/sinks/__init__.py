"""Outputs for answers, each in a process of its own."""
