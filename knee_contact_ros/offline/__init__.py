"""Commands and functions that work on bags and recordings: solve, estimate the load, replay, view, and the demo."""
