"""The deepest point of a femoral profile under a tibial surface.

Where the common normal by Newton's method is not proven (`certain.py`), bounds of blocks of segments leave a few
segments, and these are searched.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.base import Closest, Pose
from knee_contact_ros.core.contact_pairs.certain import certain_contact
from knee_contact_ros.core.contact_pairs.femoral_curve import (
    ArcDistance,
    FemoralCurve,
    common_normal,
    least_distance,
    turned_arc,
)
from knee_contact_ros.core.contact_pairs.least import NOTHING, least
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface
from knee_contact_ros.core.kernel_source import allocating, in_kernel

RESOLUTION = 1e-9
"""Difference [m] below which two minima in one segment count as one, if the bounds cannot separate them"""
ROUNDING = 1e-14
"""Rounding of the bounds, as a part of the distances"""


class ProfileSearch(NamedTuple):
    """A profile whose deepest point can be found, as a `Searched`."""

    curve: FemoralCurve

    def deepest(self, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
        """Return the common normal at the deepest point; see `Searched.deepest`."""
        certain = certain_contact(self.curve, tibia, pose, height)
        return certain.contact if certain.proven else searched_contact(self.curve, tibia, pose, height)


@allocating
def searched_contact(curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
    """Return the common normal at the deepest point of all segments, at a height [m]."""
    shortlist = np.empty((len(curve.cubics) - 1, 2), np.float64)
    listed = _fill(shortlist, curve, tibia, pose, height)
    return deepest_of(shortlist[:listed], curve, tibia, pose, height)


@in_kernel
def deepest_of(shortlist: Floats, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
    """Return the common normal at the deepest point of the listed segments, at a height [m].

    The list has the shape (segments, 2): a lower bound of the distance [m] of a segment, and its index, in the order of
    the bounds.
    """
    slack = _rounding(pose.x, height)
    best, answer = NOTHING, Closest(depth=math.nan, extent=math.nan, turning=math.nan, normal_x=0.0, normal_y=1.0)
    for k in range(len(shortlist)):
        if shortlist[k, 0] > best.value + slack:
            break
        arc = turned_arc(curve, int(shortlist[k, 1]), pose.sine, pose.cosine)
        found = least(ArcDistance(arc, tibia, pose.x, height), 0.0, arc.length, best, RESOLUTION)
        if not best.value <= found.value:
            best, answer = found, common_normal(arc, found.place, found.value, found.normal)
    return answer


@allocating
def _fill(shortlist: Floats, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> int:
    """List the segments that may have the deepest point at a height [m], and return their number.

    Blocks of segments that may have it are halved.
    """
    margin = _rounding(pose.x, height)
    count, width = len(curve.cubics) - 1, len(curve.blocks) // 2
    begin, upper = _bounds_of(0, curve, tibia, pose, height)
    end, other = _bounds_of(count, curve, tibia, pose, height)
    upper = min(upper, other)
    listed = 0
    # Block, its first segment and their number, bounds at both ends, bound of all between
    blocks = [(1, 0, width, begin, end, least_distance(curve, 1, tibia, begin, end))]
    while len(blocks) > 0:
        block, first, width, begin, end, lowest = blocks.pop()
        if lowest > upper + margin:
            continue
        if width == 1:
            _insert(shortlist, listed, first, lowest)
            listed += 1
            continue
        half = width // 2
        middle = first + half
        if middle >= count:  # the other half is empty
            blocks.append((2 * block, first, half, begin, end, lowest))
            continue
        at, other = _bounds_of(middle, curve, tibia, pose, height)
        upper = min(upper, other)
        one = (2 * block, first, half, begin, at, least_distance(curve, 2 * block, tibia, begin, at))
        two = (2 * block + 1, middle, half, at, end, least_distance(curve, 2 * block + 1, tibia, at, end))
        near, far = (one, two) if one[5] <= two[5] else (two, one)
        blocks.append(far)
        blocks.append(near)  # the likelier one comes next
    while listed > 0 and shortlist[listed - 1, 0] > upper + margin:
        listed -= 1
    return listed


@in_kernel
def _insert(shortlist: Floats, listed: int, segment: int, lowest: float) -> None:
    """Insert a segment into the list, in the order of bounds [m], and of segments where these are equal."""
    k = listed
    while k > 0 and (lowest, segment) < (float(shortlist[k - 1, 0]), int(shortlist[k - 1, 1])):
        shortlist[k, 0], shortlist[k, 1] = shortlist[k - 1, 0], shortlist[k - 1, 1]
        k -= 1
    shortlist[k, 0], shortlist[k, 1] = lowest, segment


@in_kernel
def _bounds_of(point: int, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> tuple[float, float]:
    """Return bounds of the signed distance [m] of one of the profile's points."""
    x, y = float(curve.cubics[point, 2]), float(curve.cubics[point, 6])
    turned_x, turned_y = pose.cosine * x - pose.sine * y, pose.sine * x + pose.cosine * y
    return tibia.bounds(pose.x + turned_x, height + turned_y)


@in_kernel
def _rounding(x: float, height: float) -> float:
    """Return the rounding error of the bounds [m]."""
    return ROUNDING * (1.0 + abs(x) + abs(height))
