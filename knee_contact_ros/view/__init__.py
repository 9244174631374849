"""The knee in Rerun: sagittal plane, curves and events, the same live, in a file and from a recording.

Entities are under the name of the knee. Lengths are mm; names of curves include the units. The one timeline, `stamp`,
has the ROS stamps.
"""
