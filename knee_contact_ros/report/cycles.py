"""Gait cycles: from heel strike to heel strike, brought to percent, with what they amount to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.types import ContactState
from knee_contact_ros.messages import NANOSECONDS

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

PERCENT = np.arange(101.0)
"""Where curves are given"""
COLUMNS = ("flexion_angle", "load", "contact_force", "penetration_depth", "contact_point_x", "bone_depth",
           "contact_state")  # fmt: skip
"""Fields of the answers that cycles are made of"""
CURVES = COLUMNS[:-1]
"""Those that become curves"""
STATE = COLUMNS.index("contact_state")
FORCE, DEPTH = COLUMNS.index("contact_force"), COLUMNS.index("penetration_depth")
SHORTEST, LONGEST = 0.4, 2.5
"""[s] of a gait cycle"""
RISE_TIME = 0.02
"""[s] over which the loading rate is taken"""
FEW = 12
"""Single cycles that are drawn"""


class Span(NamedTuple):
    """When a cycle was."""

    start: int
    """[ns] heel strike"""
    toe_off: int
    """[ns]"""
    end: int
    """[ns] the next heel strike"""

    @property
    def duration(self) -> float:
        """[s]."""
        return (self.end - self.start) / NANOSECONDS

    @property
    def stance(self) -> float:
        """Share of the cycle from heel strike to toe-off [%]."""
        return 100.0 * (self.toe_off - self.start) / (self.end - self.start)

    def percent(self, stamp: int) -> float:
        """Where a stamp [ns] lies [%]."""
        return 100.0 * (stamp - self.start) / (self.end - self.start)


class Cycle(NamedTuple):
    """What a cycle amounts to."""

    span: Span
    impulse: float
    """[N s] of the contact force over the cycle"""
    stance_impulse: float
    """[N s] from heel strike to toe-off"""
    loading_rate: float
    """[N/s] largest rise of the contact force over `RISE_TIME` in the first half of stance"""
    largest_force: float
    """[N] of contact"""
    largest_force_at: float
    """[%]"""
    largest_depth: float
    """[m]"""
    largest_depth_at: float
    """[%]"""
    bone_time: float
    """[s] with contact in the second layer"""
    apart_time: float
    """[s] without contact"""


def spans(strikes: Sequence[int], toe_offs: Sequence[int]) -> list[Span]:
    """The cycles between heel strikes [ns] in their order: of a plausible duration, with one toe-off."""
    found = []
    for start, end in pairwise(strikes):
        between = [stamp for stamp in toe_offs if start < stamp < end]
        if len(between) == 1 and SHORTEST <= (end - start) / NANOSECONDS <= LONGEST:
            found.append(Span(start, between[0], end))
    return found


def cut(stamps: Stamps, values: Floats, start: int, end: int) -> tuple[Floats, Floats]:
    """Samples between two stamps [ns], with interpolated ones at both.

    Returns:
        Time [s] since `start`, shape (n,), and values, shape (n, columns).
    """
    inner = slice(*np.searchsorted(stamps, (start + 1, end)))
    at = np.concatenate(([start], stamps[inner], [end]))
    edges = at_stamps(stamps, values, np.array([start, end]))
    return (at - start) / NANOSECONDS, np.concatenate((edges[:1], values[inner], edges[1:]))


def at_stamps(stamps: Stamps, values: Floats, at: Stamps) -> Floats:
    """Values interpolated at stamps, shape (n, columns); the last column, the contact state, is held."""
    since = (stamps - stamps[0]).astype(np.float64)
    wanted = (at - stamps[0]).astype(np.float64)
    columns = [np.interp(wanted, since, column) for column in values.T[:STATE]]
    held = values[np.clip(np.searchsorted(stamps, at, "right") - 1, 0, None), STATE]
    return np.column_stack((*columns, held))


def curves(stamps: Stamps, values: Floats, span: Span) -> Floats:
    """A cycle at every percent, shape (101, `CURVES`)."""
    at = span.start + np.round((span.end - span.start) * PERCENT / 100.0).astype(np.int64)
    return at_stamps(stamps, values, at)[:, :STATE]


def measured(stamps: Stamps, values: Floats, span: Span) -> Cycle:
    """What a cycle amounts to, by all its samples."""
    time, cycle = cut(stamps, values, span.start, span.end)
    stance_time, stance = cut(stamps, values, span.start, span.toe_off)
    force, depth = cycle[:, FORCE], cycle[:, DEPTH]
    hardest, deepest = int(force.argmax()), int(depth.argmax())
    steps, state = np.diff(time), cycle[1:, STATE]
    return Cycle(
        span,
        impulse=_integral(time, force),
        stance_impulse=_integral(stance_time, stance[:, FORCE]),
        loading_rate=_loading_rate(stance_time, stance[:, FORCE]),
        largest_force=float(force[hardest]),
        largest_force_at=100.0 * float(time[hardest]) / span.duration,
        largest_depth=float(depth[deepest]),
        largest_depth_at=100.0 * float(time[deepest]) / span.duration,
        bone_time=float(steps[state == ContactState.BONE].sum()),
        apart_time=float(steps[state == ContactState.SEPARATED].sum()),
    )


def _integral(time: Floats, values: Floats) -> float:
    """By trapezoids; `np.trapezoid` has another name in NumPy 1."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))


def _loading_rate(time: Floats, force: Floats) -> float:
    begins = np.arange(0.0, 0.5 * time[-1] - RISE_TIME, 0.25 * RISE_TIME)
    rises = np.interp(begins + RISE_TIME, time, force) - np.interp(begins, time, force)
    return float(rises.max(initial=0.0)) / RISE_TIME


class Mean:
    """Mean and spread of curves that come one by one, in numbers that do not grow."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = np.zeros((len(PERCENT), len(CURVES)))
        self._squares = np.zeros_like(self.mean)
        self.first: list[Floats] = []
        """The first `FEW`"""

    def add(self, curve: Floats) -> None:
        """Take a cycle, shape (101, `CURVES`); Welford's update."""
        self.count += 1
        difference = curve - self.mean
        self.mean = self.mean + difference / self.count
        self._squares = self._squares + difference * (curve - self.mean)
        if len(self.first) < FEW:
            self.first.append(curve)

    @property
    def deviation(self) -> Floats | None:
        """Standard deviation over the cycles (of the sample, n - 1), shape (101, `CURVES`); None of a single one."""
        return None if self.count < 2 else np.sqrt(self._squares / (self.count - 1))
