"""Pairs many samples at once, as `Synchroniser` does one by one while nothing unusual happens."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.pipeline.synchronise import STALE_INPUT
from knee_contact_ros.pipeline.timeline import FAR, STEPS

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Indices = NDArray[np.intp]
EXACT = 2**53
"""Limit [ns] below which differences of stamps are exact as floating-point numbers"""


class PairedSamples(NamedTuple):
    """Ticks for the first n of the loads given; all arrays but the last have shape (n,)."""

    angle: Floats
    """Flexion angles [rad] at the stamps of the loads"""
    height: Floats | None
    """Femoral heights [m] at these stamps, with the displacement drive"""
    status: NDArray[np.int64]
    """Bits of `Status`"""
    tick_of_angle: Indices
    """For every angle sample given, the first tick at or after its stamp, with which it is recorded; n if none yet"""


def pair(
    angle_stamps: Stamps, angles: Floats, heights: Floats | None, load_stamps: Stamps, last: int | None, max_gap: int
) -> PairedSamples | None:
    """Pair loads with angles; the loads after the last angle have to wait.

    Args:
        angle_stamps: Stamps of the angles [ns], increasing.
        angles: Flexion angles [rad].
        heights: Femoral heights [m], with the displacement drive.
        load_stamps: Stamps of the loads [ns], increasing, not before the first angle.
        last: Stamp of the previous tick [ns]; None if there is none.
        max_gap: Largest gap [ns] that is not stale.

    Returns:
        The pairs; None if the stamps are not as described.
    """
    if not (len(angle_stamps) and len(load_stamps)) or load_stamps[0] < angle_stamps[0]:
        return None
    for stamps in (angle_stamps, load_stamps):
        steps = np.diff(stamps)
        if (steps <= 0).any() or (steps >= EXACT).any():
            return None
    if last is not None and load_stamps[0] <= last:
        return None
    stamps = load_stamps[: np.searchsorted(load_stamps, angle_stamps[-1], "right")]
    before = np.searchsorted(angle_stamps, stamps, "right") - 1
    exact = angle_stamps[before] == stamps
    after = np.where(exact, before, before + 1)
    gap = angle_stamps[after] - angle_stamps[before]
    part = (stamps - angle_stamps[before]) / np.where(exact, 1, gap)
    previous = np.concatenate([[stamps[0] if last is None else last], stamps[:-1]]) if len(stamps) else stamps
    stale = (gap > max_gap) | (stamps - previous > max_gap)
    return PairedSamples(
        np.where(exact, angles[before], _between(angles, before, after, part)),
        None if heights is None else np.where(exact, heights[before], _between(heights, before, after, part)),
        np.where(stale, STALE_INPUT, 0),
        np.searchsorted(stamps, angle_stamps, "left"),
    )


def steps_of(stamps: Stamps, last: int | None, before: tuple[int, ...]) -> Stamps:
    """Steps [ns] of a stream: those `before` its stamp `last`, the one to `stamps`, and those between these."""
    new = np.diff(stamps) if last is None else np.diff(stamps, prepend=last)
    return np.concatenate([np.array(before, np.int64), new])


def all_go_on(steps: Stamps, known: int, max_gap: int) -> bool:
    """Whether a `Timeline` would accept all steps [ns] behind the first `known` ones: forward, and not too far."""
    if len(steps) <= known:
        return False
    recent = np.concatenate([np.zeros(STEPS, np.int64), steps[:-1]])
    but_one, longest = np.sort(np.lib.stride_tricks.sliding_window_view(recent, STEPS), axis=1)[:, -2:].T
    usual = np.where(but_one > 0, but_one, longest)
    near = steps <= np.where(usual > 0, FAR * usual, max_gap)
    return bool((near & (steps > 0))[known:].all())


def _between(values: Floats, before: Indices, after: Indices, part: Floats) -> Floats:
    """Interpolate between samples `before` and `after`, linear in time."""
    return values[before] + part * (values[after] - values[before])
