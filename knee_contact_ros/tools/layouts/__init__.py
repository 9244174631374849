"""Layouts of other viewers, which open a recording as it is: Rerun by itself, Foxglove, PlotJuggler."""
