"""Gait events from flexion angle and load alone, without ground reactions.

Angle and load are resampled at 200 Hz and smoothed (Gaussian, 20 ms), at any rate of the samples.

- **Heel strike**: 30 ms after the extension peak at the end of swing. This is a minimum of the angle after a fall by
  5° or more within 0.1 s and before a flexion by 3° or more. The load must rise there: before, it was below 0.45
  times its maximum within the next 0.4 s. If the knee stays extended for longer than 0.1 s, or extends more slowly, the
  load decides: 20 ms before it passes 0.45 times its maximum of the 0.6 s after a fall by 5°.
- **Toe-off**: 25 ms after the largest flexion rate of a flexion by 20° or more. The load must fall there: just after,
  it is below 0.45 times its maximum within the 0.4 s before. The load decides if the knee flexes by 5° or more only, or
  most quickly more than 0.2 s later: 60 ms after it passes 0.45 times its maximum of the 0.6 s before.
- Of a knee that flexes or extends so little, only loads of 1 BW or more decide: people sway with smaller ones.
- **Load peak**: the largest load within 0.25 s on either side, where the load varies by 0.15 BW or more; of 1 BW or
  more, or of 0.5 BW and half of the largest load within 0.4 s; not at the ends of the run. Its stamp is that of the
  largest sample within 50 ms of the smoothed load's peak.

Knee extension peaks shortly before the foot lands, and the knee flexes most quickly shortly before the foot leaves the
ground. The times between were measured against the vertical ground reaction (above 20 N) of two persons who walked at
their own speed: the two shipped bags (27 to 34 ms at four heel strikes, 16 to 26 ms at three toe-offs), and the walking
trial published with Rajagopal et al. (2016), doi:10.1109/TBME.2016.2586891 (subject 11, angle from marker clusters: 19
to 29 ms at three heel strikes, 20 to 35 ms at three toe-offs). `docs/how-to/report.md` has the errors that remain.

Limits: these times hold for level walking at a usual speed; at other speeds and in running expect errors of tens of ms.
No heel strike is found if the knee swings by less than 5°, or goes upstairs, where it lands bent and then extends.
Within about 60 ms of the start and end of a recording an event is less certain, or missed.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.types import Floats, Stamps

SECOND = 1_000_000_000
"""Number of nanoseconds in a second"""
GRID_PERIOD = 5_000_000
"""Period of the grid [ns]; its points are the multiples"""


def points(time: float) -> int:
    """Number of grid points in a time [s]."""
    return round(time * SECOND / GRID_PERIOD)


SMOOTHING = 0.02
"""Standard deviation [s] of the Gaussian, which passes gait below 6 Hz and reduces noise of samples to a quarter"""
REACH = points(3.0 * SMOOTHING)
"""Number of grid points on either side that a smoothed one depends on"""
WEIGHTS = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / points(SMOOTHING)) ** 2)
WEIGHTS /= WEIGHTS.sum()
TURN, TURN_AT_END = math.radians(3.0), math.radians(0.5)
"""Angle [rad] by which the knee must turn back after an extremum; at the end of a run"""
FALL, FALL_TIME = math.radians(5.0), points(0.1)
"""Smallest extension of the knee [rad] before heel strike, within this number of points"""
FLAT_POINTS = points(0.1)
"""Number of points near the extension peak from which it tells no time; in shipped gaits it has 4 to 6"""
LANDING_TIME = points(0.6)
"""Number of points after an extension to a flat end in which the foot lands and its load is searched"""
LANDED = points(0.02)
"""Number of points from heel strike until the load passes `SWING_LOAD`: 10, 20 and 25 ms in the shipped gaits"""
SWING = math.radians(20.0)
"""Smallest flexion around toe-off [rad]"""
LEAVING = points(0.06)
"""Number of points from where the load passes `SWING_LOAD` until toe-off: -30 to 115 ms in measured gaits"""
LONGEST_LEAVING = points(0.2)
"""Number of points from there from which a largest flexion rate is not that of toe-off: at most 90 ms in those gaits"""
RATE_OVER = points(0.02)
"""Number of points on either side for computing the flexion rate"""
LONGEST_TURN = points(1.0)
"""Largest number of points of a flexion around toe-off, and from an extremum until the knee has turned back"""
SWING_LOAD, LEAST_LOAD = 0.45, 0.5
"""Fraction of the stance's load below which the leg swings; smallest load of a stance [BW]"""
LOADING_TIME = points(0.4)
"""Number of points of stance in which its load is searched"""
BEFORE_LANDING, AFTER_LEAVING = (points(-0.25), points(-0.07)), (points(0.08), points(0.2))
"""Points after the extension peak, and after the largest flexion rate, between which the leg swings"""
PEAK_LOAD, PEAK_DISTANCE, PEAK_PROMINENCE = 1.0, points(0.25), 0.15
"""Load [BW] of a sure peak, smallest number of points between two, smallest range [BW] of the load around"""
PEAK_RATIO = 0.5
"""Smallest ratio of a peak between `LEAST_LOAD` and `PEAK_LOAD` to the largest load of its stance: in a compartment the
second hump may be there, and in a whole knee a swinging leg's"""
HEEL_STRIKE, TOE_OFF, LOAD_PEAK = "heel strike", "toe-off", "load peak"
AFTER = {HEEL_STRIKE: 30_000_000, TOE_OFF: 25_000_000}
"""Time [ns] from the extension peak to heel strike, and from the largest flexion rate to toe-off"""
NEARBY = 50_000_000
"""Largest distance [ns] of the largest sample from a peak of the smoothed load"""
GAP = 500_000_000
"""Largest time [ns] between two samples; after a longer gap everything starts again"""
PAUSE = 50_000_000
"""Shortest time [ns] between two looks at a stream"""
KEPT_TIME = 3 * SECOND + GAP
"""Time [ns] that samples are kept: an event is certain a second after it, and depends on the 1.5 s before it"""


def runs(stamps: Stamps, before: Stamps) -> Iterator[tuple[slice, bool]]:
    """Yield the parts of stamps [ns] without a gap, in order, and whether each starts again, after those `before`."""
    steps = np.diff(stamps, prepend=before[-1:] if len(before) else stamps[:1] - 1)
    cuts = np.flatnonzero((steps <= 0) | (steps > GAP)).tolist()
    for begin, end in pairwise([0, *cuts, len(stamps)]):
        if begin < end:
            yield slice(begin, end), begin in cuts


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

    def __init__(self, body_weight: float, known: Sequence[GaitEvent] = ()) -> None:
        """Begin a stream of a person with this body weight [N].

        `known` events take the place of those of their kinds that would be found; they lie within the samples, or up to
        `NEARBY` before or behind them.
        """
        self._body_weight = body_weight
        self._known = known
        self._begin()

    def _begin(self) -> None:
        self._stamps, self._samples = np.empty(0, np.int64), np.empty((0, 2))
        self._looked, self._open = (
            -SECOND,
            0,
        )  # stamp of the last look; the grid point before which all is decided
        self._told = set[tuple[str, int]]()  # kind and extremum of events after it

    def add_samples(self, stamps: Stamps, flexion_angle: Floats, load: Floats) -> list[GaitEvent]:
        """Add samples; return the events that have become certain, sorted.

        An event is certain up to one second after its stamp, so an earlier one of another kind may come later. If
        stamps do not increase, or leave a gap of more than half a second, everything starts again.

        Args:
            stamps: Stamps [ns], shape (n,).
            flexion_angle: Flexion angles [rad], shape (n,), finite.
            load: Loads of the compartment [N], compression positive, shape (n,), finite.
        """
        samples, events = (
            np.column_stack((flexion_angle, load / self._body_weight)),
            list[GaitEvent](),
        )
        for part, anew in runs(stamps, self._stamps):
            if anew:
                events += self.finish_events()
            self._stamps = np.append(self._stamps, stamps[part])
            self._samples = np.concatenate((self._samples, samples[part]))
            if self._stamps[-1] - self._looked >= PAUSE:
                events += self._found(ended=False)
        return events

    def finish_events(self) -> list[GaitEvent]:
        """End the stream; return the events that this makes certain. Samples after it start a new stream."""
        events = self._found(ended=True)
        self._begin()
        return events

    def _found(self, *, ended: bool) -> list[GaitEvent]:
        """Return the newly certain events, sorted; forget old samples."""
        if not len(self._stamps):
            return []
        first, last = int(self._stamps[0]), int(self._stamps[-1])
        begin = first - NEARBY if self._looked < first else self._looked + 1
        end = last + NEARBY * ended
        kinds = {event.kind for event in self._known}
        window = Window(self._stamps, self._samples, self._body_weight, ended=ended)
        new = {
            key: event
            for key, event in window.events(self._open)
            if key not in self._told and event.kind not in kinds
        }
        known = [event for event in self._known if begin <= event.stamp <= end]
        self._looked, self._open = last, window.end - LONGEST_TURN - 1
        self._told = {key for key in (*self._told, *new) if key[1] >= self._open}
        old = np.searchsorted(self._stamps, self._looked - KEPT_TIME)
        self._stamps, self._samples = self._stamps[old:], self._samples[old:]
        return sorted([*new.values(), *known])


class Window:
    """Samples without a gap, on the grid and smoothed."""

    def __init__(
        self, stamps: Stamps, samples: Floats, body_weight: float, *, ended: bool
    ) -> None:
        """Filter samples, flexion angle [rad] and load [BW], shape (n, 2); `ended`: no more will come.

        Beyond the ends the signals are continued by their mirror images through the ends.
        """
        self._stamps, self._samples, self._body_weight, self._ended = (
            stamps,
            samples,
            body_weight,
            ended,
        )
        self._origin = -(-int(stamps[0]) // GRID_PERIOD)
        grid = GRID_PERIOD * np.arange(self._origin, int(stamps[-1]) // GRID_PERIOD + 1)
        signals = [np.interp(grid - stamps[0], stamps - stamps[0], column) for column in samples.T]
        smooth = np.zeros((2, len(grid)))
        if len(grid):
            padded = np.pad(signals, ((0, 0), (REACH, REACH)), "reflect", reflect_type="odd")
            for place, weight in enumerate(WEIGHTS):
                smooth += weight * padded[:, place : place + len(grid)]
        self._angle, self._load = smooth if ended else smooth[:, :-REACH]
        self._rates = np.full(len(self._angle), -np.inf)
        self._rates[RATE_OVER:-RATE_OVER] = (
            self._angle[2 * RATE_OVER :] - self._angle[: -2 * RATE_OVER]
        )

    @property
    def end(self) -> int:
        """Number of the grid point after the last smoothed one."""
        return self._origin + len(self._angle)

    def events(self, begin: int) -> Iterator[tuple[tuple[str, int], GaitEvent]]:
        """Yield certain events, each with its kind and the grid point of its extremum, which is not before `begin`."""
        first = max(begin - self._origin, 0)
        for kind, signal in (
            (HEEL_STRIKE, -self._angle),
            (TOE_OFF, self._angle),
            (LOAD_PEAK, self._load),
        ):
            known = len(signal) if self._ended else len(signal) - LOADING_TIME
            for at in maxima(signal[:known]).tolist():
                if at >= first:
                    event = (
                        self._load_peak(at) if kind == LOAD_PEAK else self._step(kind, signal, at)
                    )
                    if event:
                        yield (kind, self._origin + at), event

    def _step(self, kind: str, signal: Floats, at: int) -> GaitEvent | None:
        """Heel strike or toe-off at a maximum of extension or of flexion, if it is one."""
        before = until_higher(signal[max(at - LONGEST_TURN, 0) : at][::-1], signal[at])
        after = until_higher(signal[at + 1 : at + 1 + LONGEST_TURN], signal[at])
        at_end = self._ended and at + LONGEST_TURN >= len(signal)
        if signal[at] - after.min(initial=signal[at]) < (TURN_AT_END if at_end else TURN):
            return None
        peak, offset = (
            self._extension(before, after, at)
            if kind == HEEL_STRIKE
            else self._flexion_rate(before, at)
        )
        if peak is None:
            return None
        stamp = min(
            GRID_PERIOD * (self._origin + peak) + round(GRID_PERIOD * offset) + AFTER[kind],
            int(self._stamps[-1]),
        )
        angle = self._angle[min(round(stamp / GRID_PERIOD) - self._origin, len(self._angle) - 1)]
        return GaitEvent(stamp, kind, f"{kind} at {np.degrees(angle):.0f}° of flexion")

    def _extension(self, before: Floats, after: Floats, at: int) -> tuple[int | None, float]:
        """Place of the extension peak before a heel strike: grid point, and offset in points; None: nowhere."""
        near = [
            len(until_higher(-side, TURN_AT_END + self._angle[at])) for side in (before, after)
        ]
        if sum(near) >= FLAT_POINTS:
            return self._loaded_extension(before, at), 0.0
        fall = -self._angle[at] - before[:FALL_TIME].min(initial=-self._angle[at])
        stance = self._load[at : at + LOADING_TIME + 1]
        if fall < FALL and stance.max() >= PEAK_LOAD:
            return self._loaded_extension(before, at), 0.0
        if fall < FALL or not self._swings(at, BEFORE_LANDING, stance):
            return None, 0.0
        return at, vertex(self._angle[at - 1 : at + 2])

    def _loaded_extension(self, before: Floats, at: int) -> int | None:
        """Where the extension peak before a heel strike would be by the load, after an extension to a flat end."""
        bent = np.flatnonzero(before <= -self._angle[at] - FALL)
        if not len(bent) or before[: bent[0]].max(initial=-np.inf) == -self._angle[at]:
            return None  # the first of equal ones counts
        begin = at - 1 - int(bent[0])
        stance = self._load[begin : begin + LANDING_TIME]
        loaded = np.flatnonzero(stance > SWING_LOAD * stance.max())
        is_known = self._ended or len(stance) == LANDING_TIME
        if not is_known or not len(loaded) or loaded[0] == 0:
            return None
        peak = begin + int(loaded[0]) - LANDED - points(AFTER[HEEL_STRIKE] / SECOND)
        return peak if peak > 0 and self._swings(peak, BEFORE_LANDING, stance) else None

    def _flexion_rate(self, before: Floats, at: int) -> tuple[int | None, float]:
        """Place of the largest flexion rate before the largest angle, if the foot leaves the ground there."""
        bend = self._angle[at] - before.min(initial=self._angle[at])
        if bend < FALL:
            return None, 0.0
        begin = at - 1 - int(before.argmin())
        quickest = begin + int(self._rates[begin : at + 1].argmax())
        unloaded = self._unloaded_flexion(begin, at)
        if bend < SWING or (unloaded is not None and unloaded < quickest - LONGEST_LEAVING):
            return unloaded, 0.0
        stance = self._load[max(quickest - LOADING_TIME, 0) : quickest + 1]
        if quickest <= RATE_OVER or not self._swings(
            quickest, AFTER_LEAVING, stance
        ):  # or it was quicker before
            return None, 0.0
        return quickest, vertex(self._rates[quickest - 1 : quickest + 2])

    def _unloaded_flexion(self, begin: int, at: int) -> int | None:
        """Where the largest flexion rate before a toe-off would be by the load, in or before a flexion to a point."""
        first = max(at - LANDING_TIME, 0)
        load = self._load[first : at + 1]
        loaded = np.flatnonzero(load > SWING_LOAD * load.max())
        if not len(loaded) or loaded[-1] == at - first:
            return None
        left = first + int(loaded[-1]) + 1
        if self._angle[left : begin + 1].max(initial=0.0) - self._angle[begin] >= TURN:
            return None  # this flexion comes after that of swing
        peak = left + LEAVING - points(AFTER[TOE_OFF] / SECOND)
        stance = self._load[max(peak - LOADING_TIME, 0) : peak + 1]
        is_sure = peak < at and stance.max() >= PEAK_LOAD
        return peak if is_sure and self._swings(peak, AFTER_LEAVING, stance) else None

    def _swings(self, at: int, times: tuple[int, int], stance: Floats) -> bool:
        """Whether the leg is unloaded between two points after a given one, compared with the loads of its stance."""
        first, last = (
            max(at + times[0], 0),
            max(at + times[1], 0),
        )  # at the beginning one point must do
        swing = self._load[first : last + 1]
        return bool(
            len(swing) and stance.max() >= LEAST_LOAD and swing.max() <= SWING_LOAD * stance.max()
        )

    def _load_peak(self, at: int) -> GaitEvent | None:
        """Load peak at the largest sample near a maximum of the smoothed load, if it is one of stance."""
        around = self._load[max(at - PEAK_DISTANCE, 0) : at + PEAK_DISTANCE + 1]
        if (
            around.argmax() != min(at, PEAK_DISTANCE)
            or self._load[at] - around.min() < PEAK_PROMINENCE
        ):
            return None
        stamp = GRID_PERIOD * (self._origin + at)
        begin, end = np.searchsorted(self._stamps, (stamp - NEARBY, stamp + NEARBY + 1))
        if begin == end:  # it lies in a pause
            return None
        largest = int(begin + self._samples[begin:end, 1].argmax())
        load = float(self._samples[largest, 1])
        stance = self._load[max(at - LOADING_TIME, 0) : at + LOADING_TIME + 1].max()
        least = PEAK_LOAD if self._load[at] < PEAK_RATIO * stance else LEAST_LOAD
        if load < least or largest == 0 or (self._ended and largest == len(self._stamps) - 1):
            return None
        text = f"load peak {load:.2f} BW ({load * self._body_weight:.1f} N)"
        return GaitEvent(int(self._stamps[largest]), LOAD_PEAK, text)


def maxima(signal: Floats) -> NDArray[np.intp]:
    """Places of the local maxima; for a plateau the first point."""
    return 1 + np.flatnonzero((signal[1:-1] > signal[:-2]) & (signal[1:-1] >= signal[2:]))


def until_higher(values: Floats, top: float) -> Floats:
    """Values up to the first one that is higher than `top`."""
    higher = np.flatnonzero(values > top)
    return values[: higher[0]] if len(higher) else values


def vertex(heights: Floats) -> float:
    """Place of the vertex of a parabola through three neighbours, from the middle one; 0 where one is missing."""
    if len(heights) < 3 or not np.isfinite(heights).all():
        return 0.0
    left, middle, right = heights.tolist()
    bend = left - 2.0 * middle + right
    return min(max(0.5 * (left - right) / bend, -0.5), 0.5) if bend else 0.0
