"""Determine unit and sign of a knee's angle in OpenSim's files."""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.offline.gait_files.storage import Floats, Storage
from knee_contact_ros.system.errors import UsageError

DEGREES, RADIANS, AUTO = "deg", "rad", "auto"
LARGEST_RADIANS = 3.5
"""Angle [rad] that no knee reaches: larger numbers are in degrees"""
SMALLEST_DEGREES = 3.5
"""Angle [deg] below which numbers may also be in radians"""
FLEXES = math.radians(20.0)
"""Angle [rad] that a knee reaches in flexion in every step, and never in extension"""
TIMES_MORE = 2.0
"""Least ratio of the angles to both sides for which the sign is clear"""
EXTENDS = math.radians(30.0)
"""Hyperextension [rad] beyond which a sign or unit is wrong"""
LARGEST_FLEXION = math.radians(170.0)
"""Flexion angle [rad] beyond which a sign or unit is wrong"""


def unit_of(storage: Storage, column: str, requested: str) -> str:
    """Unit of a column, `deg` or `rad`: the requested one, or with `auto` that of the header, checked by the values.

    Raises:
        UsageError: header and values contradict each other, or the unit is not clear.
    """
    if requested != AUTO:
        return requested
    values = storage.column(column)
    reach, span = float(np.abs(values).max()), f"{column} goes from {values.min():.3g} to {values.max():.3g}"
    if storage.degrees is None:
        if reach > LARGEST_RADIANS:
            return DEGREES
        raise UsageError(f"{storage.path} does not say inDegrees, and {span}; give --angle-unit deg or rad")
    if storage.degrees and reach < SMALLEST_DEGREES:
        raise UsageError(f"{storage.path} says inDegrees=yes, but {span}, like rad; give --angle-unit deg or rad")
    if not storage.degrees and reach > LARGEST_RADIANS:
        raise UsageError(f"{storage.path} says inDegrees=no, but {span}, like degrees; give --angle-unit deg or rad")
    return DEGREES if storage.degrees else RADIANS


def sign_of(angle: Floats, where: str, requested: int | None, bounds: tuple[float, float] | None) -> int:
    """Sign that makes an angle [rad] positive in flexion, 1 or -1.

    It is the requested one, or else follows from the data, as a walking knee flexes far more than it extends, or else
    from `bounds`, the coordinate's range [rad] in the model. `where` names file and column in messages.

    Raises:
        UsageError: the sign is impossible for a knee, or is not clear.
    """
    low, high = float(angle.min()), float(angle.max())
    span = f"{where} goes from {math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
    sign = requested or clear_sign(low, high) or (clear_sign(*bounds) if bounds else None)
    if sign is None:
        raise UsageError(f"{span}: which sign is flexion? Give --angle-sign 1 or -1, or --model")
    lowest, highest = (low, high) if sign > 0 else (-high, -low)
    if lowest < -EXTENDS or highest > LARGEST_FLEXION:
        raise UsageError(
            f"{span}; with sign {sign:+d} that is {math.degrees(lowest):.1f} to {math.degrees(highest):.1f} deg of "
            f"flexion, and a knee has {-math.degrees(EXTENDS):.0f} to {math.degrees(LARGEST_FLEXION):.0f}: "
            "see --angle-sign and --angle-unit"
        )
    return sign


def clear_sign(low: float, high: float) -> int | None:
    """Sign of flexion if a range of angles [rad] reaches clearly further to one side; None if it does not."""
    if high >= FLEXES and high >= -TIMES_MORE * low:
        return 1
    if -low >= FLEXES and -low >= TIMES_MORE * high:
        return -1
    return None
