"""The door for ROS."""
