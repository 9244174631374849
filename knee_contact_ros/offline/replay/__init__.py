"""Replay of a bag over ROS 2 topics."""
