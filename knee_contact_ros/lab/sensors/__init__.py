"""From a laboratory's own sensors to gait bags, and what their angle sensor is off by."""
