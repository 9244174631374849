"""Comparisons that are run from a clone: with other solvers, and with ROS nodes that compute nothing."""
