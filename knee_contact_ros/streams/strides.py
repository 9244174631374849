"""Strides, from a heel strike to the next of the same leg, and the contact in each."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.arrays import check_answers
from ..model.types import ROW, UNUSABLE, ContactState, Floats, Rows, Stamps
from .gait_events import (
    HEEL_STRIKE,
    LOAD_PEAK,
    NEARBY,
    SECOND,
    GaitEvent,
    GaitEvents,
    runs,
)

SHORTEST, LONGEST_STRIDE = 0.4, 2.5
"""Range of plausible durations of a stride [s]"""
CERTAIN = round(2.2 * SECOND)
"""Time [ns] after which all events are certain: a toe-off may have to wait for a slow flexion and extension"""
RISE_TIME = 0.02
"""Duration [s] over which the loading rate is computed"""
_KEPT = round((LONGEST_STRIDE + 3.0) * SECOND)
"""Time [ns] that samples must be kept: a stride, and the time until events are certain"""


class Span(NamedTuple):
    """Times of a stride.

    Example:
        >>> from knee_contact_ros import solve
        >>> from knee_contact_ros.streams.strides import strides_of
        >>> span = strides_of(solve("bags/gait2354_right"), 737.0)[0].span
        >>> print(f"{span.duration:.2f} s, stance {span.stance:.0f} %")
        1.23 s, stance 64 %
    """

    start: int
    """Stamp of the heel strike [ns]"""
    toe_off: int
    """Stamp of the toe-off [ns]"""
    end: int
    """Stamp of the next heel strike [ns]"""

    @property
    def duration(self) -> float:
        """Duration of the stride [s]."""
        return (self.end - self.start) / SECOND

    @property
    def stance(self) -> float:
        """Part of the stride from heel strike to toe-off [%]."""
        return 100.0 * (self.toe_off - self.start) / (self.end - self.start)

    def percent(self, stamp: int) -> float:
        """Position of a stamp [ns] in the stride [%].

        Example:
            >>> from knee_contact_ros.streams.strides import Span
            >>> Span(1_000_000_000, 1_620_000_000, 2_000_000_000).percent(1_500_000_000)
            50.0
        """
        return 100.0 * (stamp - self.start) / (self.end - self.start)


class Stride(NamedTuple):
    """The contact in a stride.

    Example:
        >>> from knee_contact_ros import solve
        >>> from knee_contact_ros.streams.strides import strides_of
        >>> [stride.usable for stride in strides_of(solve("bags/gait2354_right"), 737.0)]
        [True]
    """

    span: Span
    peak_force: float
    """Largest contact force [N]"""
    peak_depth: float
    """Largest penetration depth [m]"""
    impulse: float
    """Impulse of the contact force from heel strike to heel strike [N s]"""
    stance_impulse: float
    """Impulse from heel strike to toe-off [N s]"""
    loading_rate: float
    """Largest rise of the contact force over `RISE_TIME` in the first half of stance [N/s]"""
    usable: bool
    """Whether no answer of the stride, nor those on either side of its ends, has a bit of `UNUSABLE`"""
    sliding_distance: float
    """Distance [m] that the femur slides along the tibia, forward and backward, while in contact; NaN: not recorded"""
    ringing: float = math.nan
    """How far the contact force rings [N], under a law that is hardly damped: `peak_force` and `loading_rate` contain
    it. NaN: not known"""


def spans(strikes: Sequence[int], toe_offs: Sequence[int]) -> list[Span]:
    """Strides between heel strikes [ns], in order: those of a plausible duration, with one toe-off [ns]."""
    strides = []
    for start, end in pairwise(strikes):
        between = [stamp for stamp in toe_offs if start < stamp < end]
        if len(between) == 1 and SHORTEST <= (end - start) / SECOND <= LONGEST_STRIDE:
            strides.append(Span(start, between[0], end))
    return strides


def rows_of(span: Span, stamps: Stamps) -> slice:
    """Select the rows of a stride, and the next one on either side; not that behind a gap close to the stride's end.

    There, as where a recording begins or ends up to `NEARBY` within a stride, the values at its ends are held.
    """
    first = int(np.searchsorted(stamps, span.start, "right")) - 1
    last = int(np.searchsorted(stamps, span.end))
    steps = np.diff(stamps[max(first, 0) : last + 1])
    if first < 0 or (steps[0] > 2 * NEARBY and stamps[first + 1] - span.start <= NEARBY):
        first += 1
    if last == len(stamps) or (steps[-1] > 2 * NEARBY and span.end - stamps[last - 1] <= NEARBY):
        last -= 1
    return slice(first, last + 1)


def cut(stamps: Stamps, values: Floats, start: int, end: int) -> tuple[Floats, Floats]:
    """Samples between two stamps [ns], with interpolated values at both; the last column is held instead.

    Returns:
        Time [s] since `start`, shape (n,), and values, shape (n, columns).
    """
    inner = slice(*np.searchsorted(stamps, (start + 1, end)))
    edges = at_stamps(stamps, values, np.array([start, end]))
    at = np.concatenate(([start], stamps[inner], [end]))
    return (at - start) / SECOND, np.concatenate((edges[:1], values[inner], edges[1:]))


def at_stamps(stamps: Stamps, values: Floats, at: Stamps) -> Floats:
    """Values at stamps [ns], shape (n, columns), interpolated; the last column is held instead."""
    since, wanted = (stamps - stamps[0]).astype(float), (at - stamps[0]).astype(float)
    last = values[np.clip(np.searchsorted(stamps, at, "right") - 1, 0, None), -1]
    return np.column_stack((*(np.interp(wanted, since, column) for column in values.T[:-1]), last))


def sliding_distance(time: Floats, sliding_velocity: Floats, contact_state: Floats) -> float:
    """Integral of the sliding speed over the time in contact [m]: ∫ |v| dt, v linear between ticks.

    Args:
        time: Times of the ticks [s], shape (n,), not decreasing.
        sliding_velocity: Sliding velocities [m/s], shape (n,).
        contact_state: `ContactState`, shape (n,); a tick's holds for the interval before it.

    Returns:
        The distance; NaN if a velocity is NaN.
    """
    touching = contact_state[1:] != ContactState.SEPARATED
    begin, end = sliding_velocity[:-1][touching], sliding_velocity[1:][touching]
    speeds = np.abs(begin) + np.abs(end)
    turned = begin * end < 0.0  # then two triangles
    mean = (
        np.where(turned, (begin * begin + end * end) / np.where(turned, speeds, 1.0), speeds) / 2.0
    )
    return float(np.sum(mean * np.diff(time)[touching]))


def integral(time: Floats, values: Floats) -> float:
    """Integrate values over time [s], both of shape (n,), by trapezoids; `np.trapezoid` has another name in NumPy 1."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))


def loading_rate(time: Floats, force: Floats) -> float:
    """Largest rise [N/s] of a force over `RISE_TIME` in the first half of a stance; times begin with it."""
    last = 0.5 * time[-1] - RISE_TIME
    begins = np.concatenate(
        (time, time - RISE_TIME, [last])
    )  # the force is straight between samples
    begins = begins[(begins >= 0.0) & (begins <= last)]
    rises = np.interp(begins + RISE_TIME, time, force) - np.interp(begins, time, force)
    return float(rises.max(initial=0.0)) / RISE_TIME


class Strides:
    """Strides of a stream of answers of any length, in bounded memory; each is returned once, when it is certain.

    They do not depend on how the stream is cut into batches. A stride is certain when the heel strike that ends it is
    (`GaitEvents`), about 0.4 s after it.
    """

    def __init__(self, body_weight: float, known: Sequence[GaitEvent] = ()) -> None:
        """Begin a stream of a person with this body weight [N]; for `known` events see `GaitEvents`."""
        self._finder = GaitEvents(body_weight, known)
        self.events: list[GaitEvent] = []
        """Events that have become certain since the last `add` began"""
        self._begin()

    def _begin(self) -> None:
        self._rows: Rows = np.empty(0, ROW)
        self._ringing: Floats = np.empty(0)
        self._strikes, self._toe_offs = list[int](), list[int]()
        self._last = (0, 0)  # heel strikes of the stride that was told last

    def add_answers(self, rows: Rows, ringing: Floats | None = None) -> list[Stride]:
        """Add answers, shape (n,), and their ringing [N], if known; return the strides that are certain now, in order.

        If stamps do not increase, or leave a gap of more than half a second, everything starts again.
        """
        strides: list[Stride] = []
        self.events = []
        known = np.full(len(rows), np.nan) if ringing is None else ringing
        for part, anew in runs(rows["stamp"], self._rows["stamp"]):
            if anew:
                strides += self.finish_strides()
            new = rows[part]
            self._rows = np.concatenate((self._rows, new))
            self._ringing = np.concatenate((self._ringing, known[part]))
            strides += self._certain_strides(
                self._finder.add_samples(new["stamp"], new["flexion_angle"], new["load"])
            )
            kept = np.searchsorted(self._rows["stamp"], self._rows["stamp"][-1] - _KEPT)
            self._rows, self._ringing = self._rows[kept:], self._ringing[kept:]
        return strides

    def finish_strides(self) -> list[Stride]:
        """End the stream; return the strides that this makes certain. Answers after it start a new stream."""
        strides = self._certain_strides(self._finder.finish_events())
        self._begin()
        return strides

    def _certain_strides(self, events: Sequence[GaitEvent]) -> list[Stride]:
        strides = []
        self.events += events
        for event in events:
            if event.kind == LOAD_PEAK:
                continue
            known = self._strikes if event.kind == HEEL_STRIKE else self._toe_offs
            known[:] = [*known[-2:], event.stamp]
            for span in spans(self._strikes[-2:], self._toe_offs):
                if (span.start, span.end) != self._last:
                    self._last = span.start, span.end
                    strides.append(stride_of(span, self._rows, self._ringing))
        return strides


def stride_of(
    span: Span, rows: Rows | Mapping[str, NDArray[Any]], ringing: Floats | None = None
) -> Stride:
    """The contact in a stride, from answers around it: rows, or arrays by field, with increasing stamps.

    `ringing` [N] of the answers has the same shape (n,); None: it is not known.
    """
    part = rows_of(span, rows["stamp"])
    stamps = rows["stamp"][part]
    names = ("contact_force", "penetration_depth", "sliding_velocity", "contact_state")
    values = np.column_stack([rows[name][part] for name in names])
    (time, whole), (stance_time, stance) = (
        cut(stamps, values, span.start, end) for end in (span.end, span.toe_off)
    )
    within = slice(*np.searchsorted(stamps, (span.start, span.end)))
    largest = math.nan if ringing is None else float(np.abs(ringing[part][within]).max())
    return Stride(
        span,
        float(whole[:, 0].max()),
        float(whole[:, 1].max()),
        integral(time, whole[:, 0]),
        integral(stance_time, stance[:, 0]),
        loading_rate(stance_time, stance[:, 0]),
        not (rows["status"][part].astype(int) & UNUSABLE).any(),
        sliding_distance(time, *whole.T[2:]),
        largest if math.isfinite(largest) else math.nan,
    )


def strides_of(series: Rows, body_weight: float) -> list[Stride]:
    """Find the strides in the answers of a run, as on the topic `knee_contact/stride`. Needs no ROS.

    Args:
        series: Answers, shape (n,), of `KneeModel.run`, `solve` or `read_answers`. `solve` also knows the gait events
            of an imported bag.
        body_weight: Body weight [N].

    Returns:
        One entry per whole stride, in order; none where there is no gait.

    Example:
        >>> from knee_contact_ros import solve
        >>> from knee_contact_ros.streams.strides import strides_of
        >>> stride = strides_of(solve("bags/gait2354_right"), body_weight=737.0)[0]
        >>> print(f"{stride.span.duration:.2f} s, {stride.peak_force:.0f} N")
        1.23 s, 1557 N
    """
    answers = np.asarray(check_answers(series, *(ROW.names or ())))
    strides = Strides(body_weight, getattr(series, "gait_events", ()))
    model = getattr(series, "model", None)
    ringing = model.ringing(series) if model else None
    return strides.add_answers(answers, ringing) + strides.finish_strides()
