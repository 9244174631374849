"""A knee's angle as OpenSim has it → flexion in rad, positive in flexion."""

from __future__ import annotations

import math

import numpy as np

from knee_contact_ros.offline.gait_files.storage import Floats, Storage
from knee_contact_ros.system.errors import UsageError

DEGREES, RADIANS, AUTO = "deg", "rad", "auto"
LARGEST_RADIANS = 3.5
"""[rad] No knee bends so far: numbers beyond are degrees"""
SMALLEST_DEGREES = 3.5
"""[deg] What stays below may as well be radians"""
FLEXES = math.radians(20.0)
"""[rad] which a knee flexes in every step, and never extends"""
TIMES_MORE = 2.0
"""How many times as far it must go to the one side as to the other for the sign to be clear"""
EXTENDS = math.radians(30.0)
"""[rad] Hyperextension and flexion beyond which a sign or a unit is wrong"""
LARGEST_FLEXION = math.radians(170.0)


def unit_of(storage: Storage, column: str, asked: str) -> str:
    """Whether a column is in `deg` or `rad`, as asked for or as header and values say.

    Raises:
        UsageError: header and values contradict each other, or neither says.
    """
    if asked != AUTO:
        return asked
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


def sign_of(angle: Floats, where: str, asked: int | None, bounds: tuple[float, float] | None) -> int:
    """What makes an angle [rad] positive in flexion, 1 or -1.

    As asked for; else from the data, as a walking knee flexes far more than it extends; else from `bounds`, the
    coordinate's range [rad] in the model. `where` names file and column.

    Raises:
        UsageError: the sign asked for cannot be, or nothing tells it.
    """
    low, high = float(angle.min()), float(angle.max())
    span = f"{where} goes from {math.degrees(low):.1f} to {math.degrees(high):.1f} deg"
    sign = asked or clear_sign(low, high) or (clear_sign(*bounds) if bounds else None)
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
    """The sign of flexion if a range [rad] goes clearly further to one side."""
    if high >= FLEXES and high >= -TIMES_MORE * low:
        return 1
    if -low >= FLEXES and -low >= TIMES_MORE * high:
        return -1
    return None
