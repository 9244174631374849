"""`knee-contact latency`: what the node adds to what ROS itself takes, beside a bare node in the same run."""
