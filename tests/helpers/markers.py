"""What a viewer makes of markers: their points where the message's frame has them."""

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation


def place_of(marker):
    """Where a marker's own origin lies, shape (3,) [m]."""
    position = marker.pose.position
    return np.array([position.x, position.y, position.z])


def drawn(marker):
    """Its points, shape (n, 3) [m]."""
    turn = marker.pose.orientation
    points = np.array([[point.x, point.y, point.z] for point in marker.points])
    return Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(points) + place_of(marker)


def distance(place, line):
    """From a place to the nearest point of a line with corners `line`, shape (n, 3) [m]."""
    nearest = np.inf
    for begin, end in pairwise(line):
        along = end - begin
        length = float(along @ along)
        part = np.clip((place - begin) @ along / length, 0.0, 1.0) if length else 0.0
        nearest = min(nearest, float(np.linalg.norm(place - begin - part * along)))
    return nearest


def sagitta(line):
    """How far the curve may bulge between two corners of a line [m]: an eighth of chord times turn at a corner."""
    steps = np.diff(line, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    steps, lengths = steps[lengths > 0.0], lengths[lengths > 0.0]
    if len(steps) < 2:
        return 0.0
    cosines = np.sum(steps[1:] * steps[:-1], axis=1) / (lengths[1:] * lengths[:-1])
    turns = np.arccos(np.clip(cosines, -1.0, 1.0))
    return float((np.maximum(lengths[1:], lengths[:-1]) * turns).max() / 8.0)
