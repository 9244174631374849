"""Gait events from flexion angle and load alone; no ground reaction is known here.

Both are brought onto a grid of 200 Hz and smoothed (Gaussian, 20 ms), whatever the rate of the samples.

- **Heel strike**: 30 ms after the extension peak at the end of swing. That is a minimum of the angle to which it fell
  by 5° or more within 0.1 s, from which the knee flexes again by 3° or more, and at which the load rises: before,
  it was below 0.45 of what it reaches within 0.4 s.
- **Toe-off**: 25 ms after the largest flexion rate of a flexion by 20° or more in which the load falls: just after,
  it is below 0.45 of what it was within 0.4 s before.
- **Load peak**: the largest load within 0.25 s on either side, of 1 BW or more, where the load varies by 0.15 BW or
  more; not at the ends of the run. It is that of the largest sample within 50 ms of the smoothed load's peak.

Knee extension peaks shortly before the foot lands, and the knee flexes most quickly shortly before the foot leaves the
ground. The times between were measured against the vertical ground reaction (above 20 N) of two persons who walked at
their own speed: the two shipped bags (27 to 34 ms at four heel strikes, 16 to 26 ms at three toe-offs), and the walking
trial published with Rajagopal et al. (2016), doi:10.1109/TBME.2016.2586891 (subject 11, angle from marker clusters: 19
to 29 ms at three heel strikes, 20 to 35 ms at three toe-offs). `docs/how-to/report.md` has the errors that remain.

Limits: these are times of level walking at a usual speed; at other speeds and in running expect errors of some tens of
ms. Where the knee does not flex after landing (a stiff knee, or going upstairs, where the foot lands on a bent knee and
the knee extends from there) no heel strike is found. At the start and the end of a recording an event within some 60 ms
is less certain, or missed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
SECOND = 1_000_000_000
"""Number of nanoseconds in a second"""
PERIOD = 5_000_000
"""Period of the grid [ns]; its points are the multiples"""


def points(time: float) -> int:
    """Number of grid points in a time [s]."""
    return round(time * SECOND / PERIOD)


SMOOTHING = 0.02
"""Standard deviation [s] of the Gaussian: gait below 6 Hz passes, noise of single samples is reduced to a quarter"""
REACH = points(3.0 * SMOOTHING)
"""Number of grid points on either side that a smoothed one depends on"""
WEIGHTS = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / points(SMOOTHING)) ** 2)
WEIGHTS /= WEIGHTS.sum()
TURN, TURN_AT_END = math.radians(3.0), math.radians(0.5)
"""Angle [rad] by which the knee must turn back after an extremum; at the end of a run"""
FALL, FALL_TIME = math.radians(5.0), 0.1
"""Smallest extension of the knee [rad] before heel strike, within this time [s]"""
SWING = math.radians(20.0)
"""Smallest flexion around toe-off [rad]"""
RATE_OVER = points(0.02)
"""Number of grid points on either side over which the flexion rate is taken"""
LONGEST_TURN = 1.0
"""Longest time [s] of a flexion around toe-off, and from its end, or from an extension peak, to the next turn"""
UNLOADED, LEAST_LOAD = 0.45, 0.5
"""Share of the stance's load below which the leg swings; smallest load of a stance [BW]"""
LOADING_TIME = 0.4
"""Time [s] of stance within which its load is looked for"""
BEFORE_LANDING = (-0.25, -0.07)
"""Times [s] after the extension peak between which the leg swings"""
AFTER_LEAVING = (0.08, 0.2)
"""Times [s] after the largest flexion rate between which the leg swings"""
PEAK_LOAD, PEAK_DISTANCE, PEAK_PROMINENCE = 1.0, 0.25, 0.15
"""Smallest load [BW] of a peak, smallest time [s] between two, smallest range [BW] of the load around"""
HEEL_STRIKE, TOE_OFF, LOAD_PEAK = "heel strike", "toe-off", "load peak"
AFTER = {HEEL_STRIKE: 30_000_000, TOE_OFF: 25_000_000}
"""Time [ns] from the extension peak to heel strike, and from the largest flexion rate to toe-off"""
NEARBY = 50_000_000
"""Largest distance [ns] of the largest sample from a peak of the smoothed load"""
GAP = 500_000_000
"""Largest time [ns] between two samples; beyond it everything starts anew"""
KEPT = points(2.0 * LONGEST_TURN + LOADING_TIME) + 100
"""Number of grid points that are kept, as decisions look back at them"""
ANGLE, LOAD = 0, 1
"""Columns of samples and grid points"""


class GaitEvent(NamedTuple):
    """Event in a gait."""

    stamp: int
    """Stamp [ns]"""
    kind: str
    """`HEEL_STRIKE`, `TOE_OFF` or `LOAD_PEAK`"""
    text: str
    """Description for a person, with units"""


class Extremum(NamedTuple):
    """Local extremum of a smoothed signal."""

    place: int
    """Grid point; of a plateau the first one"""
    value: float
    is_maximum: bool


class GaitEvents:
    """Finds the events of a stream of any length in bounded memory.

    The events do not depend on how the stream is cut into batches. Grid points are counted from the first one.
    """

    def __init__(self, body_weight: float) -> None:
        """Begin a stream of a person with this body weight [N]."""
        self._body_weight = body_weight
        self._begin()

    def _begin(self) -> None:
        self._stamps, self._samples = np.empty(0, np.int64), np.empty((0, 2))
        self._first = self._origin = 0  # stamps of the first sample and the first grid point
        self._points, self._next, self._begun = np.empty((0, 2)), 0, False  # points that the filter still needs
        self._smooth, self._start = np.empty((0, 2)), 0  # smoothed points, and the number of the first one
        self._moved: list[tuple[int, float, int]] = []  # of each signal: where it moved last, its value, and which way
        self._latest: Extremum | None = None  # of the angle, and where it turned before that
        self._since = 0
        self._waiting: list[tuple[int, str, int, int]] = []  # last point to wait for, kind, extremum, turn before it

    def add(self, stamps: Stamps, flexion_angle: Floats, load: Floats) -> list[GaitEvent]:
        """Take samples; return the events that have become certain, in the order in which they did.

        That is up to two seconds after an event's stamp, so an earlier one of another kind may come later. Where stamps
        do not increase, or leave a gap of more than half a second, everything starts anew.

        Args:
            stamps: Stamps [ns], shape (n,).
            flexion_angle: Flexion angles [rad], shape (n,), finite.
            load: Loads of the compartment [N], compression positive, shape (n,), finite.
        """
        if not len(stamps):
            return []
        samples, events = np.column_stack((flexion_angle, load / self._body_weight)), list[GaitEvent]()
        steps = np.diff(stamps, prepend=self._stamps[-1] if len(self._stamps) else stamps[0] - 1)
        cuts = np.flatnonzero((steps <= 0) | (steps > GAP)).tolist()
        for begin, end in zip([0, *cuts], [*cuts, len(stamps)], strict=True):
            if begin in cuts:
                events += self.finish()
            if end > begin:
                events += self._take(stamps[begin:end], samples[begin:end])
        return events

    def finish(self) -> list[GaitEvent]:
        """End the stream; return the events that this makes certain. Samples after it start a new stream."""
        if self._begun:
            self._smoothed(2.0 * self._points[-1:] - self._points[-2 : -2 - REACH : -1])
            latest, value = self._latest, float(self._smooth[-1, ANGLE])
            if latest and (latest.value - value) * (1.0 if latest.is_maximum else -1.0) >= TURN_AT_END:
                self._turned(latest, self._end - 1)
        events = self._decided(ended=True)
        self._begin()
        return events

    @property
    def _end(self) -> int:
        """Number of the point behind the last smoothed one."""
        return self._start + len(self._smooth)

    def _take(self, stamps: Stamps, samples: Floats) -> list[GaitEvent]:
        """Take samples without a gap."""
        if not len(self._stamps):
            self._first, self._origin = int(stamps[0]), -(-int(stamps[0]) // PERIOD) * PERIOD
        self._stamps, self._samples = np.append(self._stamps, stamps), np.concatenate((self._samples, samples))
        since = self._stamps - self._origin
        at = np.arange(self._next, int(since[-1]) // PERIOD + 1)
        self._next += len(at)
        self._smoothed(np.column_stack([np.interp(PERIOD * at, since, column) for column in self._samples.T]))
        return self._decided(ended=False)

    def _smoothed(self, grid: Floats) -> None:
        """Filter new grid points, and look for extrema in the smoothed ones.

        Beyond the ends the signals are continued by their mirror images through the ends.
        """
        waiting = np.concatenate((self._points, grid))
        if not self._begun and len(waiting) > REACH:
            waiting, self._begun = np.concatenate((2.0 * waiting[:1] - waiting[REACH:0:-1], waiting)), True
        ready = len(waiting) - 2 * REACH if self._begun else 0
        self._points = waiting[max(ready, 0) :]
        if ready <= 0:
            return
        new, begin = np.zeros((ready, 2)), self._end
        for place, weight in enumerate(WEIGHTS):
            new += weight * waiting[place : place + ready]
        self._smooth = np.concatenate((self._smooth, new))
        self._moved = self._moved or [(0, value, 0) for value in new[0].tolist()]
        for index, values in enumerate(new.tolist(), begin):
            for column, value in enumerate(values):
                place, before, way = self._moved[column]
                if value != before:
                    now = 1 if value > before else -1
                    if way * now < 0:
                        self._extremum(column, Extremum(place, before, way > 0), index)
                    self._moved[column] = index, value, now

    def _extremum(self, column: int, found: Extremum, known: int) -> None:
        """Note a possible load peak, or an extremum of the angle, from which it turned if it came back far enough."""
        if column == LOAD:
            if found.is_maximum:
                self._waiting.append((found.place + points(PEAK_DISTANCE), LOAD_PEAK, found.place, 0))
            return
        latest = self._latest
        if latest is None or latest.is_maximum == found.is_maximum:
            if latest is None or (found.value > latest.value) == latest.is_maximum:
                self._latest = found
        elif abs(found.value - latest.value) >= TURN:
            self._turned(latest, known)
            self._latest, self._since = found, latest.place

    def _turned(self, at: Extremum, known: int) -> None:
        """Note a possible step where the angle turned, which is known at a later point."""
        if known - at.place <= points(LONGEST_TURN):
            due, kind = max(known, at.place + points(LOADING_TIME)), TOE_OFF if at.is_maximum else HEEL_STRIKE
            self._waiting.append((due, kind, at.place, self._since))

    def _decided(self, *, ended: bool) -> list[GaitEvent]:
        """Events that can be decided by now (all if no more points will come); forget old samples."""
        due = sorted(each for each in self._waiting if ended or each[0] < self._end)
        self._waiting = [each for each in self._waiting if not (ended or each[0] < self._end)]
        found = [self._load_peak(place, ended=ended) if kind == LOAD_PEAK else self._step(kind, place, since)
                 for _, kind, place, since in due]  # fmt: skip
        old = max(len(self._smooth) - KEPT, 0)
        self._smooth, self._start = self._smooth[old:], self._start + old
        unused = int(np.searchsorted(self._stamps, self._origin + PERIOD * self._start))
        self._stamps, self._samples = self._stamps[unused:], self._samples[unused:]
        return [event for event in found if event]

    def _between(self, column: int, first: int, last: int) -> Floats:
        """Smoothed values from one point to another, both included, as far as there are any."""
        return self._smooth[max(first - self._start, 0) : max(last + 1 - self._start, 0), column]

    def _swings(self, at: int, times: tuple[float, float], stance: Floats) -> bool:
        """Whether the leg is unloaded between two times [s] after a point, compared with the loads of its stance."""
        first, last = (at + points(time) for time in times)
        swing = self._between(LOAD, first, max(last, self._start))  # at the beginning one point must do
        return bool(
            len(swing) and len(stance) and stance.max() >= LEAST_LOAD and swing.max() <= UNLOADED * stance.max()
        )

    def _step(self, kind: str, place: int, since: int) -> GaitEvent | None:
        """Heel strike or toe-off at an extremum of the angle, if it is one."""
        peak = self._extension_peak(place) if kind == HEEL_STRIKE else self._flexion_rate_peak(place, since)
        if peak is None:
            return None
        stamp = min(self._origin + round(PERIOD * peak) + AFTER[kind], int(self._stamps[-1]))
        nearest = min(round(stamp / PERIOD) - self._origin // PERIOD, self._end - 1)
        angle = self._smooth[nearest - self._start, ANGLE]
        return GaitEvent(stamp, kind, f"{kind} at {np.degrees(angle):.0f}° of flexion")

    def _extension_peak(self, at: int) -> float | None:
        """Where the knee is straightest before a heel strike, if its smallest angle at a point is that."""
        fall = self._between(ANGLE, at - points(FALL_TIME), at).max() - self._smooth[at - self._start, ANGLE]
        stance = self._between(LOAD, at, at + points(LOADING_TIME))
        if fall < FALL or not self._swings(at, BEFORE_LANDING, stance):
            return None
        return at + vertex(self._between(ANGLE, at - 1, at + 1))

    def _flexion_rate_peak(self, at: int, since: int) -> float | None:
        """Where the knee flexes most quickly before its largest angle, if the foot leaves the ground there."""
        begin = max(since, at - points(LONGEST_TURN), self._start)
        rise = self._between(ANGLE, begin, at)
        if rise[-1] - rise[0] < SWING:
            return None
        begin = max(begin, self._start + RATE_OVER)
        angle = self._between(ANGLE, begin - RATE_OVER, at + 1 + RATE_OVER)
        rates = angle[2 * RATE_OVER :] - angle[: -2 * RATE_OVER]
        quickest = begin + int(rates[: at + 1 - begin].argmax())
        if quickest <= self._start + RATE_OVER:  # it may have been quicker before
            return None
        stance = self._between(LOAD, quickest - points(LOADING_TIME), quickest)
        if not self._swings(quickest, AFTER_LEAVING, stance):
            return None
        around = self._between(ANGLE, quickest - 1 - RATE_OVER, quickest + 1 + RATE_OVER)
        return quickest + vertex(around[2 * RATE_OVER :] - around[: -2 * RATE_OVER])

    def _load_peak(self, at: int, *, ended: bool) -> GaitEvent | None:
        """Load peak at the largest sample near a maximum of the smoothed load, if it is one of stance."""
        reach = points(PEAK_DISTANCE)
        before, after = self._between(LOAD, at - reach, at), self._between(LOAD, at, at + reach)
        if before.argmax() < len(before) - 1 or after.max() > before[-1]:
            return None
        if before[-1] - min(before.min(), after.min()) < PEAK_PROMINENCE:
            return None
        stamp = self._origin + PERIOD * at
        begin, end = np.searchsorted(self._stamps, (stamp - NEARBY, stamp + NEARBY + 1))
        largest = int(begin + self._samples[begin:end, LOAD].argmax())
        stamp, load = int(self._stamps[largest]), float(self._samples[largest, LOAD])
        if load < PEAK_LOAD or stamp == self._first or (ended and largest == len(self._stamps) - 1):
            return None
        return GaitEvent(stamp, LOAD_PEAK, f"load peak {load:.2f} BW ({load * self._body_weight:.1f} N)")


def vertex(heights: Floats) -> float:
    """Place of the vertex of a parabola through three neighbours, from the middle one; 0 where one is missing."""
    if len(heights) < 3:
        return 0.0
    left, middle, right = heights.tolist()
    bend = left - 2.0 * middle + right
    return min(max(0.5 * (left - right) / bend, -0.5), 0.5) if bend else 0.0
