"""From samples of two streams to answers, without files and clocks."""
