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
RATE = SECOND // PERIOD
"""Number of grid points per second"""
SMOOTHING = 0.02
"""Standard deviation [s] of the Gaussian: gait below 6 Hz passes, noise of single samples is reduced to a quarter"""
REACH = round(3.0 * SMOOTHING * RATE)
"""Number of grid points on either side that a smoothed one depends on"""


def _gaussian() -> Floats:
    weights = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / (SMOOTHING * RATE)) ** 2)
    return np.asarray(weights / weights.sum())


WEIGHTS = _gaussian()


class Grid:
    """Linear interpolation of samples at multiples of `PERIOD`."""

    def __init__(self) -> None:
        self.first = 0
        """Index of the first grid point: its stamp over `PERIOD`"""
        self._next: int | None = None
        self._last_stamps = np.empty(0, dtype=np.int64)
        self._last_values = np.empty((0, 2))

    def add(self, stamps: NDArray[np.int64], values: Floats) -> Floats:
        """Take samples, at least one, with increasing stamps [ns], shape (n,), and values, shape (n, 2).

        Returns:
            Values at the new grid points, shape (m, 2).
        """
        if self._next is None:
            self.first = self._next = -(-int(stamps[0]) // PERIOD)
        stamps = np.concatenate((self._last_stamps, stamps))
        values = np.concatenate((self._last_values, values))
        at = PERIOD * np.arange(self._next, int(stamps[-1]) // PERIOD + 1)
        self._next += len(at)
        self._last_stamps, self._last_values = stamps[-1:], values[-1:]
        after = np.searchsorted(stamps, at)
        before = np.maximum(after - 1, 0)
        apart = np.maximum(stamps[after] - stamps[before], 1)  # 1: the first sample lies on the grid
        share = ((stamps[after] - at) / apart)[:, None]
        return np.asarray(values[after] - (values[after] - values[before]) * share)


class Smoother:
    """Gaussian filter over grid points. Beyond the ends the signal is continued by its mirror image through the end."""

    def __init__(self) -> None:
        self._points = np.empty((0, 2))
        self._begun = False

    def add(self, points: Floats) -> Floats:
        """Take grid points, shape (n, 2); return the smoothed points that they complete, shape (m, 2)."""
        self._points = np.concatenate((self._points, points))
        if not self._begun:
            if len(self._points) <= REACH:
                return np.empty((0, 2))
            mirrored = 2.0 * self._points[:1] - self._points[REACH:0:-1]
            self._points = np.concatenate((mirrored, self._points))
            self._begun = True
        ready = len(self._points) - 2 * REACH
        smooth = np.zeros((max(ready, 0), 2))
        for place, weight in enumerate(WEIGHTS[: 2 * REACH + 1] if ready > 0 else ()):
            smooth += weight * self._points[place : place + ready]
        self._points = self._points[max(ready, 0) :]
        return smooth

    def finish(self) -> Floats:
        """Return the remaining smoothed points, up to the last grid point, shape (m, 2)."""
        if not self._begun:
            return np.empty((0, 2))
        return self.add(2.0 * self._points[-1:] - self._points[-2 : -2 - REACH : -1])


class Extremum(NamedTuple):
    """Local extremum of a signal."""

    place: int
    """Index of the extremum, counted from the signal's first point; for a plateau that of its start"""
    value: float
    highest: bool
    """Whether it is a maximum"""
    known: int
    """Index of the point at which it is known to be an extremum"""


class LocalExtrema:
    """Finder of all local extrema of a signal."""

    def __init__(self) -> None:
        self._last = np.empty(0)
        self._place = 0
        """Index of the next point"""
        self._moved: tuple[float, int, float] | None = None
        """Last step that was not zero: its sign, and the index and value at which it ended"""

    def add(self, values: Floats) -> list[Extremum]:
        """Take points, shape (n,); return the extrema that they show."""
        start = self._place - len(self._last)
        joined = np.concatenate((self._last, values))
        self._last, self._place = joined[-1:], self._place + len(values)
        steps = np.diff(joined)
        moving = np.flatnonzero(steps)
        signs, ends, heights = np.sign(steps[moving]), moving + 1 + start, joined[moving + 1]
        if self._moved is not None:
            signs, ends, heights = (np.append(*pair) for pair in zip(self._moved, (signs, ends, heights), strict=True))
        if len(signs):
            self._moved = float(signs[-1]), int(ends[-1]), float(heights[-1])
        return [
            Extremum(int(ends[step]), float(heights[step]), bool(signs[step] > 0.0), int(ends[step + 1]))
            for step in np.flatnonzero(signs[1:] != signs[:-1])
        ]


class Turn(NamedTuple):
    """Extremum from which a signal has returned by a given amount."""

    place: int
    """Index of the extremum"""
    highest: bool
    """Whether it is a maximum"""
    since: int
    """Index of the previous turn; 0 for the first one"""
    known: int
    """Index of the point at which it is known to be a turn"""


class Turns:
    """Finder of the turns of a signal, without those of small fluctuations."""

    def __init__(self, least: float) -> None:
        """Find turns from which the signal returns by at least this amount."""
        self._least = least
        self._latest: Extremum | None = None
        self._since = 0

    def add(self, extremum: Extremum) -> Turn | None:
        """Take the next local extremum; return the turn that it shows."""
        latest = self._latest
        if latest is None or latest.highest == extremum.highest:
            if latest is None or (extremum.value > latest.value) == latest.highest:
                self._latest = extremum
            return None
        if abs(extremum.value - latest.value) < self._least:
            return None
        turn = Turn(latest.place, latest.highest, self._since, extremum.known)
        self._latest, self._since = extremum, latest.place
        return turn

    def finish(self, index: int, value: float, least: float) -> Turn | None:
        """Return the turn that the signal's last point shows, if the signal has returned by `least`."""
        latest = self._latest
        if latest is None or ((latest.value - value) if latest.highest else (value - latest.value)) < least:
            return None
        return Turn(latest.place, latest.highest, self._since, index)


TURN, TURN_AT_END = math.radians(3.0), math.radians(0.5)
"""Angle [rad] by which the knee must turn back after an extremum; at the end of a run"""
FALL, FALL_TIME = math.radians(5.0), 0.1
"""Smallest extension of the knee [rad] before heel strike, within this time [s]"""
SWING = math.radians(20.0)
"""Smallest flexion around toe-off [rad]"""
RATE_OVER = 0.04
"""Time [s] over which the flexion rate is taken"""
LONGEST_TURN = 1.0
"""Longest time [s] of a flexion around toe-off, and from its end, or from an extension peak, to the next turn"""
UNLOADED, LEAST_LOAD = 0.45, 0.5
"""Share of the stance's load below which the leg swings; smallest load of a stance [BW]"""
LOADING_TIME = 0.4
"""Time [s] of stance within which its load is looked for"""
BEFORE_LANDING = (0.25, 0.07)
"""Times [s] before the extension peak between which the leg swings"""
AFTER_LEAVING = (0.08, 0.2)
"""Times [s] after the largest flexion rate between which the leg swings"""
PEAK_LOAD, PEAK_DISTANCE, PEAK_PROMINENCE = 1.0, 0.25, 0.15
"""Smallest load [BW] of a peak, smallest time [s] between two, smallest range [BW] of the load around"""
ANGLE, LOAD = 0, 1
"""Columns of the smoothed signals"""


def points(time: float) -> int:
    """Number of grid points in a time [s]."""
    return round(time * RATE)


class Stretch(NamedTuple):
    """Part of the smoothed signals."""

    values: Floats
    """Angle [rad] and load [BW], shape (n, 2)"""
    first: int
    """Index of the first point"""

    @property
    def end(self) -> int:
        """Index behind the last point."""
        return self.first + len(self.values)

    def between(self, column: int, first: int, last: int) -> Floats:
        """Values of a column from one index to another, both included, as far as there are any."""
        return self.values[max(first - self.first, 0) : max(last + 1 - self.first, 0), column]

    def fraction(self, index: int, sign: float, heights: Floats) -> float:
        """Fractional index of the peak of a parabola through the point of `heights` at `index` and its neighbours.

        `sign` is 1 for a maximum, and -1 for a minimum.
        """
        place = index - self.first
        if not 0 < place < len(heights) - 1:
            return float(index)
        left, middle, right = sign * heights[place - 1 : place + 2]
        bend = left - 2.0 * middle + right
        return index + (min(max(0.5 * float((left - right) / bend), -0.5), 0.5) if bend < 0.0 else 0.0)


def extension_peak(of: Stretch, index: int) -> float | None:
    """Fractional index of the extension peak before a heel strike, if a minimum of the angle at `index` is one."""
    fall = of.between(ANGLE, index - points(FALL_TIME), index).max() - of.values[index - of.first, ANGLE]
    begin, end = (index - points(time) for time in BEFORE_LANDING)
    swing = of.between(LOAD, begin, max(end, of.first, 0))
    stance = of.between(LOAD, index, index + points(LOADING_TIME))
    if fall < FALL or not _unloaded(swing, stance):
        return None
    return of.fraction(index, -1.0, of.values[:, ANGLE])


def flexion_rate_peak(of: Stretch, index: int, since: int) -> float | None:
    """Fractional index of the largest flexion rate between a turn `since` and a maximum of the angle at `index`.

    None if the foot does not leave the ground there.
    """
    begin = max(since, index - points(LONGEST_TURN))
    rise = of.between(ANGLE, begin, index)
    if rise[-1] - rise[0] < SWING:
        return None
    angle, reach = of.values[:, ANGLE], points(RATE_OVER / 2.0)
    rates = np.full(len(angle), -np.inf)
    rates[reach : len(angle) - reach] = angle[2 * reach :] - angle[: len(angle) - 2 * reach]
    quickest = begin + int(rates[begin - of.first : index - of.first + 1].argmax())
    if quickest - reach <= of.first:  # it may have been quicker before
        return None
    stance = of.between(LOAD, quickest - points(LOADING_TIME), quickest)
    swing = of.between(LOAD, *(quickest + points(time) for time in AFTER_LEAVING))
    if not _unloaded(swing, stance):
        return None
    return of.fraction(quickest, 1.0, rates)


def is_load_peak(of: Stretch, index: int) -> bool:
    """Whether a maximum of the load at `index` is a peak of stance."""
    reach = points(PEAK_DISTANCE)
    before, after = of.between(LOAD, index - reach, index), of.between(LOAD, index, index + reach)
    load = before[-1]
    if before.argmax() < len(before) - 1 or after.max() > load:
        return False
    return bool(load - min(before.min(), after.min()) >= PEAK_PROMINENCE)


def _unloaded(swing: Floats, stance: Floats) -> bool:
    """Whether the loads `swing` are those of a swing phase, compared with the loads `stance`."""
    if not (len(swing) and len(stance)):
        return False
    return bool(stance.max() >= LEAST_LOAD and swing.max() <= UNLOADED * stance.max())


HEEL_STRIKE, TOE_OFF, LOAD_PEAK = "heel strike", "toe-off", "load peak"
AFTER_EXTENSION = 30_000_000
"""Time [ns] from the extension peak to heel strike"""
AFTER_RATE_PEAK = 25_000_000
"""Time [ns] from the largest flexion rate to toe-off"""
NEARBY = 50_000_000
"""Largest distance [ns] of the largest sample from a peak of the smoothed load"""
GAP = 500_000_000
"""Largest time [ns] between two samples; beyond it everything starts anew"""
KEPT = points(2.0 * LONGEST_TURN + LOADING_TIME) + 100
"""Number of grid points that are kept, as decisions look back at them"""


class GaitEvent(NamedTuple):
    """Event in a gait."""

    stamp: int
    """Stamp [ns]"""
    kind: str
    """`HEEL_STRIKE`, `TOE_OFF` or `LOAD_PEAK`"""
    text: str
    """Description for a person, with units"""


class GaitEvents:
    """Finds the events of a stream of any length in bounded memory.

    The events do not depend on how the stream is cut into batches.
    """

    def __init__(self, body_weight: float) -> None:
        """Begin a stream of a person with this body weight [N]."""
        self._body_weight = body_weight
        self._run = _Run(body_weight)
        self._last: int | None = None

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
        values = np.column_stack((flexion_angle, load))
        steps = np.diff(stamps, prepend=stamps[0] - 1 if self._last is None else self._last)
        cuts = np.flatnonzero((steps <= 0) | (steps > GAP)).tolist()
        events: list[GaitEvent] = []
        for begin, end in zip([0, *cuts], [*cuts, len(stamps)], strict=True):
            if begin in cuts:
                events += self.finish()
            if end > begin:
                events += self._run.add(stamps[begin:end], values[begin:end])
        self._last = int(stamps[-1])
        return events

    def finish(self) -> list[GaitEvent]:
        """End the stream; return the events that this makes certain. Samples after it start a new stream."""
        events = self._run.finish()
        self._run, self._last = _Run(self._body_weight), None
        return events


class _Waiting(NamedTuple):
    """Possible event that cannot be decided yet."""

    due: int
    """Index of the last point that it depends on"""
    kind: str
    place: int
    """Index of the extremum"""
    since: int
    """Index of the previous turn"""


class _Run:
    """Samples without a gap. An index counts grid points, from the first one."""

    def __init__(self, body_weight: float) -> None:
        self._body_weight = body_weight
        self._grid, self._smoother = Grid(), Smoother()
        self._angles, self._loads, self._turns = LocalExtrema(), LocalExtrema(), Turns(TURN)
        self._smooth = Stretch(np.empty((0, 2)), 0)
        self._stamps, self._raw_loads = np.empty(0, dtype=np.int64), np.empty(0)
        """Stamps [ns] and loads [N] of the samples themselves"""
        self._first_stamp: int | None = None
        self._waiting: list[_Waiting] = []

    def add(self, stamps: Stamps, values: Floats) -> list[GaitEvent]:
        """Take samples, at least one; return the events that have become certain."""
        if self._first_stamp is None:
            self._first_stamp = int(stamps[0])
        self._stamps = np.append(self._stamps, stamps)
        self._raw_loads = np.append(self._raw_loads, values[:, LOAD])
        self._take(self._smoother.add(self._grid.add(stamps, values / (1.0, self._body_weight))))
        return self._decided(self._smooth.end)

    def finish(self) -> list[GaitEvent]:
        """End the samples; return the events that this makes certain."""
        self._take(self._smoother.finish())
        end = self._smooth.end
        if end and (turn := self._turns.finish(end - 1, float(self._smooth.values[-1, ANGLE]), TURN_AT_END)):
            self._consider(turn)
        return self._decided(None)

    def _take(self, smooth: Floats) -> None:
        self._smooth = self._smooth._replace(values=np.concatenate((self._smooth.values, smooth)))
        for extremum in self._angles.add(smooth[:, ANGLE]):
            if turn := self._turns.add(extremum):
                self._consider(turn)
        for extremum in self._loads.add(smooth[:, LOAD]):
            if extremum.highest:
                due = extremum.place + points(PEAK_DISTANCE)
                self._waiting.append(_Waiting(due, LOAD_PEAK, extremum.place, 0))

    def _consider(self, turn: Turn) -> None:
        if turn.known - turn.place <= points(LONGEST_TURN):
            due = max(turn.known, turn.place + points(LOADING_TIME))
            self._waiting.append(_Waiting(due, TOE_OFF if turn.highest else HEEL_STRIKE, turn.place, turn.since))

    def _decided(self, end: int | None) -> list[GaitEvent]:
        """Events that the points before index `end` decide (None: no more will come); forget old samples."""
        due = sorted(possible for possible in self._waiting if end is None or possible.due < end)
        self._waiting = [possible for possible in self._waiting if end is not None and possible.due >= end]
        events = [event for possible in due if (event := self._decide(possible, ended=end is None))]
        old = max(len(self._smooth.values) - KEPT, 0)
        self._smooth = Stretch(self._smooth.values[old:], self._smooth.first + old)
        unused = np.searchsorted(self._stamps, self._stamp(self._smooth.first))
        self._stamps, self._raw_loads = self._stamps[unused:], self._raw_loads[unused:]
        return events

    def _decide(self, possible: _Waiting, *, ended: bool) -> GaitEvent | None:
        if possible.kind == LOAD_PEAK:
            return self._load_peak(possible.place, ended=ended) if is_load_peak(self._smooth, possible.place) else None
        if possible.kind == HEEL_STRIKE:
            place, later = extension_peak(self._smooth, possible.place), AFTER_EXTENSION
        else:
            place, later = flexion_rate_peak(self._smooth, possible.place, possible.since), AFTER_RATE_PEAK
        if place is None:
            return None
        stamp = min(self._stamp(place) + later, int(self._stamps[-1]))
        (angle,) = self._smooth.between(ANGLE, *2 * [min(self._index(stamp), self._smooth.end - 1)])
        return GaitEvent(stamp, possible.kind, f"{possible.kind} at {np.degrees(angle):.0f}° of flexion")

    def _load_peak(self, index: int, *, ended: bool) -> GaitEvent | None:
        """Load peak at the largest sample near a peak of the smoothed load; None if it is too small, or at an end."""
        stamp = self._stamp(index)
        begin, end = np.searchsorted(self._stamps, (stamp - NEARBY, stamp + NEARBY + 1))
        at = int(begin + self._raw_loads[begin:end].argmax())
        stamp, load = int(self._stamps[at]), float(self._raw_loads[at])
        at_the_end = stamp == self._first_stamp or (ended and at == len(self._stamps) - 1)
        if load < PEAK_LOAD * self._body_weight or at_the_end:
            return None
        return GaitEvent(stamp, LOAD_PEAK, f"load peak {load / self._body_weight:.2f} BW ({load:.1f} N)")

    def _stamp(self, place: float) -> int:
        """Stamp [ns] of an index, which may lie between two points."""
        return self._grid.first * PERIOD + round(place * PERIOD)

    def _index(self, stamp: int) -> int:
        return round(stamp / PERIOD) - self._grid.first
