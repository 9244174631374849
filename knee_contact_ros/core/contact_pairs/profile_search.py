"""The deepest point of a femoral profile under a tibial surface.

Bounds of blocks of segments leave a few segments for a cell of heights, and these are searched at each height.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.core.contact_pairs.base import Closest
from knee_contact_ros.core.contact_pairs.femoral_curve import (
    Arc,
    ArcDistance,
    FemoralCurve,
    least_distance,
    place_on,
    turned_arc,
)
from knee_contact_ros.core.contact_pairs.least import NOTHING, Sample, least
from knee_contact_ros.core.contact_pairs.tibial_surface import TibialSurface
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined

CELL = 2.0**-14
"""Heights within a cell of this size [m] share one shortlist; a power of 2, so that its middle is exact"""
RESOLUTION = 1e-9
"""Two dips of the distance within one segment that the bounds cannot tell apart count as one below this [m]"""
ROUNDING = 1e-14
"""Kept from the bounds, as a part of the distances: they are rounded themselves"""


class Pose(NamedTuple):
    """Where the femur is but for its height."""

    x: float
    """Of the reference point [m]"""
    sine: float
    """Of the flexion angle"""
    cosine: float


class ProfileOver(NamedTuple):
    """A profile in a pose over a tibial surface; see `Search`."""

    curve: FemoralCurve
    tibia: TibialSurface
    pose: Pose
    shortlist: Floats
    """Shape (segments + 1, 2): the segments that can hold the deepest point at the heights of one cell.

    In the first row the cell's middle [m], nan before there is one, and how many segments follow. In the others, the
    likeliest first, the least distance [m] that a segment may have in the cell's middle, and the segment.
    """

    def deepest(self, height: float) -> Closest:
        """See `Search`."""
        cell = cell_of(height)
        if self.shortlist[0, 0] != cell:
            _fill(self.shortlist, self.curve, self.tibia, self.pose, cell)
        return deepest_of(self.shortlist, self.curve, self.tibia, self.pose, height)


class ProfileSearch(NamedTuple):
    """A profile that is searched for its deepest point; see `Searched`."""

    curve: FemoralCurve

    def over(self, tibia: TibialSurface, angle: float, x: float) -> ProfileOver:
        """See `Searched`."""
        shortlist = np.empty((len(self.curve.cubics), 2), np.float64)
        shortlist[0, 0] = math.nan
        return ProfileOver(self.curve, tibia, Pose(x, math.sin(angle), math.cos(angle)), shortlist)


@in_kernel
def cell_of(height: float) -> float:
    """Middle of the cell of heights that a height belongs to [m]."""
    raised = height + 0.5 * CELL
    return raised - raised % CELL


@never_inlined
def deepest_of(shortlist: Floats, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> Closest:
    """The common normal at the deepest point of the listed segments, at a height [m] within the list's cell."""
    raised = height - float(shortlist[0, 0])
    slack = max(-raised, -raised * tibia.least_normal_y()) + _rounding(pose.x, height)
    best, answer = NOTHING, Closest(depth=math.nan, extent=math.nan, turning=math.nan, normal_x=0.0, normal_y=1.0)
    for k in range(1, 1 + int(shortlist[0, 1])):
        if shortlist[k, 0] > best.value + slack:
            break
        arc = turned_arc(curve, int(shortlist[k, 1]), pose.sine, pose.cosine)
        found = least(ArcDistance(arc, tibia, pose.x, height), 0.0, arc.length, best, RESOLUTION)
        if not best.value <= found.value:
            best, answer = found, _common_normal(arc, found)
    return answer


@in_kernel
def _common_normal(arc: Arc, sample: Sample) -> Closest:
    """The common normal at the femur's deepest point."""
    x, y = place_on(arc, sample.place)
    normal_x, normal_y = sample.normal
    turning = normal_x * y - normal_y * x
    return Closest(
        depth=-sample.value, extent=-(x * normal_x + y * normal_y), turning=turning, normal_x=normal_x,
        normal_y=normal_y,
    )  # fmt: skip


@never_inlined
def _fill(shortlist: Floats, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, cell: float) -> None:
    """List the segments that can hold the deepest point at some height of a cell with this middle [m].

    Blocks of segments are halved as long as they can. Over a height dy, a distance changes by dy n_y, so one segment
    gains on another no more than dy (1 - least n_y).
    """
    margin = 0.5 * CELL * (1.0 - tibia.least_normal_y()) + _rounding(pose.x, cell)
    count, width = len(curve.cubics) - 1, len(curve.blocks) // 2
    begin, upper = _bounds_of(0, curve, tibia, pose, cell)
    end, other = _bounds_of(count, curve, tibia, pose, cell)
    upper = min(upper, other)
    shortlist[0, 0], shortlist[0, 1] = cell, 0.0
    # Block, its first segment and their number, bounds at both ends, bound of all between
    blocks = [(1, 0, width, begin, end, least_distance(curve, 1, tibia, begin, end))]
    while len(blocks) > 0:
        block, first, width, begin, end, lowest = blocks.pop()
        if lowest > upper + margin:
            continue
        if width == 1:
            _insert(shortlist, first, lowest)
            continue
        half = width // 2
        middle = first + half
        if middle >= count:  # the other half is empty
            blocks.append((2 * block, first, half, begin, end, lowest))
            continue
        at, other = _bounds_of(middle, curve, tibia, pose, cell)
        upper = min(upper, other)
        one = (2 * block, first, half, begin, at, least_distance(curve, 2 * block, tibia, begin, at))
        two = (2 * block + 1, middle, half, at, end, least_distance(curve, 2 * block + 1, tibia, at, end))
        near, far = (one, two) if one[5] <= two[5] else (two, one)
        blocks.append(far)
        blocks.append(near)  # the likelier one comes next
    listed = int(shortlist[0, 1])
    while listed > 0 and shortlist[listed, 0] > upper + margin:
        listed -= 1
    shortlist[0, 1] = listed


@in_kernel
def _insert(shortlist: Floats, segment: int, lowest: float) -> None:
    """Put a segment in its place on the list; the first of two that are equally likely is the first on the curve."""
    k = int(shortlist[0, 1]) + 1
    shortlist[0, 1] = k
    while k > 1 and (lowest, segment) < (float(shortlist[k - 1, 0]), int(shortlist[k - 1, 1])):
        shortlist[k, 0], shortlist[k, 1] = shortlist[k - 1, 0], shortlist[k - 1, 1]
        k -= 1
    shortlist[k, 0], shortlist[k, 1] = lowest, segment


@in_kernel
def _bounds_of(point: int, curve: FemoralCurve, tibia: TibialSurface, pose: Pose, height: float) -> tuple[float, float]:
    """Bounds of the signed distance of one of the profile's points [m]."""
    x, y = float(curve.cubics[point, 2]), float(curve.cubics[point, 6])
    turned_x, turned_y = pose.cosine * x - pose.sine * y, pose.sine * x + pose.cosine * y
    return tibia.bounds(pose.x + turned_x, height + turned_y)


@in_kernel
def _rounding(x: float, height: float) -> float:
    """What the bounds may be wrong by [m]."""
    return ROUNDING * (1.0 + abs(x) + abs(height))
