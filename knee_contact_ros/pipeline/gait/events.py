"""Gait events from flexion angle and load alone; no ground reaction is known here.

Both are brought onto a grid of 200 Hz and smoothed (Gaussian, 20 ms), whatever the rate of the samples; the numbers are
in `rules.py`.

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
to 29 ms at three heel strikes, 20 to 35 ms at three toe-offs). `docs/report.md` has the errors that remain.

Limits: these are times of level walking at a usual speed; at other speeds and in running expect errors of some tens of
ms. Where the knee does not flex after landing (a stiff knee, or going upstairs, where the foot lands on a bent knee and
the knee extends from there) no heel strike is found. At the start and the end of a recording an event within some 60 ms
is less certain, or missed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.pipeline.gait.rules import (
    ANGLE,
    LOAD,
    LOADING_TIME,
    LONGEST_TURN,
    PEAK_DISTANCE,
    PEAK_LOAD,
    TURN,
    TURN_AT_END,
    Stretch,
    extension_peak,
    flexion_rate_peak,
    is_load_peak,
    points,
)
from knee_contact_ros.pipeline.gait.signal import PERIOD, Floats, Grid, Smoother
from knee_contact_ros.pipeline.gait.turns import LocalExtrema, Turn, Turns

Stamps = NDArray[np.int64]

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
