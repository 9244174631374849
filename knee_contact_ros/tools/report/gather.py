"""Gather what the report needs of a run from its answers, block by block, in memory that does not grow with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.model.types import FLAT, Rows
from knee_contact_ros.streams.gait_events import GAP, HEEL_STRIKE, LOAD_PEAK, TOE_OFF, GaitEvent, GaitEvents
from knee_contact_ros.streams.strides import CERTAIN, KEPT, spans
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.streams.watch import Doubts
from knee_contact_ros.tools.report.cycles import COLUMNS, Cycle, Floats, Mean, curves, measured
from knee_contact_ros.tools.report.totals import Course, Totals


class Moment(NamedTuple):
    """Gait event, or another moment, with the contact at it."""

    event: GaitEvent
    elapsed: float
    """Time [s] since the run's first tick, by the stamps; where these went back, as if the run had gone on at once"""
    load: float
    """Load [N], > 0 in compression"""
    contact_force: float
    """Contact force [N]"""
    penetration_depth: float
    """Penetration depth [m], >= 0 in overlap"""
    force_error: float
    """Estimated error of the contact force [N]; NaN if the recording has none"""
    depth_error: float
    """Estimated error of the penetration depth [m]"""
    flexion_angle: float
    """Flexion angle [rad], positive in flexion"""
    femoral_height: float
    """Height of the femur over the tibia [m]"""


MOMENT = ("load", "contact_force", "penetration_depth", "force_error_estimate", "error_estimate", "flexion_angle",
        "femoral_height")  # fmt: skip
"""Names of the columns of a moment's numbers, in the order of its fields"""
LARGEST = {"load": "largest load", "contact_force": "largest contact force"}
"""Name of the moment at which a column is largest, by the column"""


class Gathered:
    """Totals, course over time, moments and gait cycles of a run, gathered from its answers."""

    def __init__(
        self,
        body_weight: float,
        doubts: Doubts | None = None,
        model: KneeModel | None = None,
        height_prescribed: bool = False,
    ) -> None:
        """Begin without answers.

        Args:
            body_weight: body weight [N].
            doubts: doubts about the run's parameters.
            model: model that computed all of the run; None: it is not known, and neither are patch and pressure.
            height_prescribed: whether the femoral height is prescribed: no load drives then, and the largest contact
                force is looked for instead of the largest load.
        """
        self.of_largest = "contact_force" if height_prescribed else "load"
        self.body_weight, self._model = body_weight, model if model and model.patch else None
        self.totals, self.course, self.mean = Totals(doubts or Doubts()), Course(len(COLUMNS)), Mean()
        self.moments: list[Moment] = []
        self.largest: Moment | None = None
        """Moment at which the column `of_largest` is largest; None: there are no answers"""
        self.cycles: list[Cycle] = []
        self.strikes = 0
        """Number of heel strikes that another one followed, which is that of cycles if all of them were plausible"""
        self._finder = GaitEvents(body_weight)
        self._stamps, self._values = np.empty(0, dtype=np.int64), np.empty((0, len(COLUMNS)))
        self._since = 0
        """Difference [ns] of stamps and elapsed time"""
        self._pending: list[GaitEvent] = []

    @property
    def reads_off(self) -> bool:
        """Whether patch and pressure of the contact are known."""
        return self._model is not None

    def add(self, answers: Rows) -> None:
        """Add answers, n >= 1, in the order of their ticks."""
        cuts = np.flatnonzero((np.diff(answers["stamp"]) <= 0) | (np.diff(answers["stamp"]) > GAP)) + 1
        for part in np.split(np.arange(len(answers)), cuts):
            self._add(answers[part])

    def finish(self) -> Gathered:
        """Complete events and cycles after the last answer; return the object itself."""
        self._take(self._finder.finish(), ended=True)
        self.moments.sort(key=lambda moment: moment.elapsed)
        return self

    def _add(self, part: Rows) -> None:
        first, last = int(part["stamp"][0]), self.totals.last_stamp
        goes_on = self.totals.ticks > 0 and 0 < first - last <= GAP
        if not self.totals.ticks:
            self._since = first
        elif not goes_on:
            self._take(self._finder.finish(), ended=True)
            self._since -= max(last - first, 0)  # stamps that went back: as if it went on at once
        values = self._columns(part)
        self.totals.add(part, np.diff(part["stamp"], prepend=last if goes_on else first) / NANOSECONDS)
        self.course.add(part["stamp"] - self._since, values)
        self._stamps = np.append(self._stamps, part["stamp"])
        self._values = np.concatenate((self._values, values))
        self._largest(part["stamp"], values)
        self._take(self._finder.add(part["stamp"], part["flexion_angle"], part["load"]), ended=False)

    def _columns(self, part: Rows) -> Floats:
        """Values of `COLUMNS` in answers, shape (n, columns), with readouts of the model where it is known."""
        read = self._model.readouts(part) if self._model else dict.fromkeys(SPREAD, np.full(len(part), np.nan))
        return np.column_stack([read[name] if name in SPREAD else part.view(FLAT)[name] for name in COLUMNS])

    def _largest(self, stamps: NDArray[np.int64], values: Floats) -> None:
        column = COLUMNS.index(self.of_largest)
        at = int(values[:, column].argmax())
        if self.largest is None or values[at, column] > getattr(self.largest, self.of_largest):
            event = GaitEvent(int(stamps[at]), LARGEST[self.of_largest], "")
            self.largest = Moment(event, (event.stamp - self._since) / NANOSECONDS, *contact_in(values[at]))

    def _take(self, events: list[GaitEvent], *, ended: bool) -> None:
        for event in events:
            elapsed = (event.stamp - self._since) / NANOSECONDS
            self.moments.append(Moment(event, elapsed, *self._contact_at(event.stamp)))
        self._pending += [event for event in events if event.kind != LOAD_PEAK]
        self._cycles(ended=ended)
        if ended:
            self._pending, self._stamps, self._values = [], self._stamps[:0], self._values[:0]
        elif len(self._stamps):
            kept = np.searchsorted(self._stamps, self._stamps[-1] - KEPT)
            self._stamps, self._values = self._stamps[kept:], self._values[kept:]

    def _contact_at(self, stamp: int) -> list[float]:
        """Numbers of a moment at the tick with a stamp [ns], or else at the last tick before it."""
        return contact_in(self._values[max(int(np.searchsorted(self._stamps, stamp, "right")) - 1, 0)])

    def _cycles(self, *, ended: bool) -> None:
        """Add the cycles whose events are all certain."""
        strikes = sorted(event.stamp for event in self._pending if event.kind == HEEL_STRIKE)
        toe_offs = sorted(event.stamp for event in self._pending if event.kind == TOE_OFF)
        certain = [stamp for stamp in strikes if ended or stamp <= self._stamps[-1] - CERTAIN]
        for span in spans(certain, toe_offs):
            if self._stamps[0] <= span.start:
                self.mean.add(curves(self._stamps, self._values, span))
                self.cycles.append(measured(self._stamps, self._values, span))
        self.strikes += max(len(certain) - 1, 0)
        oldest = max(certain[-1] if certain else 0, int(self._stamps[-1]) - KEPT) if len(self._stamps) else 0
        self._pending = [event for event in self._pending if event.stamp >= oldest]


def contact_in(row: Floats) -> list[float]:
    """Numbers of a moment, in the order of `MOMENT`, from a row of `COLUMNS`."""
    return [float(row[COLUMNS.index(name)]) for name in MOMENT]
