"""The knee in Rerun: sagittal plane, curves and events, the same live, in a file and from a recording.

Entities stand under the name of the knee. Lengths are mm; units stand in the names of the curves. One timeline,
`stamp`, has the ROS stamps.
"""
