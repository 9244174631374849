"""The contact model: mathematics on numbers and arrays, without ROS, files and clocks."""
