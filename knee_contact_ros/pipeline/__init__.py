"""From samples of two streams to answers; no file, no clock."""
