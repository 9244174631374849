"""A knee's angle and joint reaction over time, in SI units and the package's signs and frames.

Both have stamps of their own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.offline.gait_files.storage import Floats, Stamps
from knee_contact_ros.system.errors import UsageError


class Angles(NamedTuple):
    """Flexion angles of a joint over time."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    angle: Floats
    """[rad], positive in flexion; shape (n,)"""
    rate: Floats | None
    """[rad/s], shape (n,); None: to be derived from the angles"""


class Reactions(NamedTuple):
    """Joint reactions that the femur exerts on the tibia, in the tibia frame (x anterior, y superior, z right)."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    force: Floats
    """[N], shape (n, 3)"""
    torque: Floats
    """[N m] about the tibia frame's origin, shape (n, 3)"""


def common_window(
    angles: Angles, reactions: Reactions, start: float | None, end: float | None, ground: Stamps | None = None
) -> tuple[int, int]:
    """Return the first and the last stamp [ns] of the time that all inputs cover, within `start` and `end` [s].

    Times before 0 are left out. `ground` are the stamps [ns] of the ground forces, shape (n,), where there are some.

    Raises:
        UsageError: the inputs have no time in common, or none within `start` and `end`.
    """
    three = (angles.stamps, reactions.stamps, *(() if ground is None else (ground,)))
    spans = [(int(stamps[0]), int(stamps[-1])) for stamps in three]
    first, last = max(0, *(span[0] for span in spans)), min(span[1] for span in spans)
    if first >= last:
        covered = " and ".join(f"{a / NANOSECONDS:g} to {b / NANOSECONDS:g} s" for a, b in spans)
        what = "kinematics and reactions" if ground is None else "kinematics, reactions and ground forces"
        raise UsageError(f"{what} have no time in common: {covered}")
    wanted = (first if start is None else round(start * NANOSECONDS), last if end is None else round(end * NANOSECONDS))
    if max(first, wanted[0]) >= min(last, wanted[1]):
        options = f"--start {wanted[0] / NANOSECONDS:g} --end {wanted[1] / NANOSECONDS:g}"
        raise UsageError(f"{options}: nothing is left of {first / NANOSECONDS:g} to {last / NANOSECONDS:g} s")
    return max(first, wanted[0]), min(last, wanted[1])


def cut(angles: Angles, reactions: Reactions, window: tuple[int, int]) -> tuple[Angles, Reactions]:
    """Cut both to a window [ns]; the angles keep one neighbour on either side, so that every reaction has its angle.

    Raises:
        UsageError: fewer than two reactions are left.
    """
    kept = (reactions.stamps >= window[0]) & (reactions.stamps <= window[1])
    if np.count_nonzero(kept) < 2:
        low, high = (stamp / NANOSECONDS for stamp in window)
        raise UsageError(f"fewer than two rows of the reactions are within {low:g} to {high:g} s")
    first = max(int(np.searchsorted(angles.stamps, window[0], "right")) - 1, 0)
    last = int(np.searchsorted(angles.stamps, window[1], "left")) + 1
    rate = None if angles.rate is None else angles.rate[first:last]
    inside = Reactions(reactions.stamps[kept], reactions.force[kept], reactions.torque[kept])
    return Angles(angles.stamps[first:last], angles.angle[first:last], rate), inside


def resample(angles: Angles, reactions: Reactions, window: tuple[int, int], rate: float) -> tuple[Angles, Reactions]:
    """Resample both at the multiples of 1/`rate` [Hz] within the window [ns], by linear interpolation.

    Raises:
        UsageError: fewer than two multiples are in the window.
    """
    period = NANOSECONDS / rate
    counts = np.arange(np.ceil(window[0] / period - 1e-6), np.floor(window[1] / period + 1e-6) + 1)
    stamps = np.clip(np.rint(counts * period).astype(np.int64), *window)
    if len(stamps) < 2:
        raise UsageError(f"--rate {rate:g}: fewer than two samples in {(window[1] - window[0]) / NANOSECONDS:g} s")

    def at(known: Stamps, values: Floats) -> Floats:
        return np.interp(stamps - window[0], known - window[0], values)

    angle = at(angles.stamps, angles.angle)
    speed = None if angles.rate is None else at(angles.stamps, angles.rate)
    force, torque = (np.column_stack([at(reactions.stamps, column) for column in values.T]) for values in reactions[1:])
    return Angles(stamps, angle, speed), Reactions(stamps, force, torque)


def with_rate(angles: Angles) -> Angles:
    """Return angles with their rate: derived by differences of second order if there is none."""
    if angles.rate is not None:
        return angles
    seconds = (angles.stamps - angles.stamps[0]) / NANOSECONDS
    return angles._replace(rate=np.gradient(angles.angle, seconds))


def mirrored(reactions: Reactions) -> Reactions:
    """Mirror the reactions of a left knee to a right one: force z and torques x and y change their signs."""
    return reactions._replace(
        force=reactions.force * np.array([1.0, 1.0, -1.0]), torque=reactions.torque * np.array([-1.0, -1.0, 1.0])
    )
