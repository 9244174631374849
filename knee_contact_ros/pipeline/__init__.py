"""Computes answers from the samples of two streams, without files and clocks."""
