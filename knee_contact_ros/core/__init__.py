"""The contact model: plain numbers in, plain numbers out. No ROS, no file, no clock."""
