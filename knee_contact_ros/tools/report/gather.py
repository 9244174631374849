"""Gathers what a report says of a run from its answers, block by block, in memory that does not grow with them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.readouts import SPREAD
from knee_contact_ros.core.types import FLAT, Rows
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.pipeline.gait.events import GAP, HEEL_STRIKE, LOAD_PEAK, TOE_OFF, GaitEvent, GaitEvents
from knee_contact_ros.pipeline.gait.strides import CERTAIN, KEPT, Span, spans
from knee_contact_ros.tools.report.cycles import COLUMNS, Cycle, Floats, Mean, curves, measured
from knee_contact_ros.tools.report.totals import Course, Totals


class Moment(NamedTuple):
    """A gait event and the contact at it."""

    event: GaitEvent
    elapsed: float
    """[s] since the run's first tick; as stamps go, but for those that went back"""
    load: float
    """[N]"""
    contact_force: float
    """[N]"""
    penetration_depth: float
    """[m]"""
    force_error: float
    """[N] estimated error of the contact force; not a number if the recording does not tell"""
    depth_error: float
    """[m] that of the depth"""
    flexion_angle: float
    """[rad]"""
    femoral_height: float
    """[m]"""


TOLD = ("load", "contact_force", "penetration_depth", "force_error_estimate", "error_estimate", "flexion_angle",
        "femoral_height")  # fmt: skip
"""Columns of a moment"""
LARGEST = {"load": "largest load", "contact_force": "largest contact force"}
"""What is largest at a moment, by its column"""


class Gathered:
    """All that a report says of a run."""

    def __init__(
        self,
        body_weight: float,
        doubts: Doubts | None = None,
        model: KneeModel | None = None,
        height_prescribed: bool = False,
    ) -> None:
        """`body_weight` is in N; `doubts` are those about the run's parameters; `model` computed all of the run.

        Where the femoral height is prescribed no load drives, and the contact force tells where most is borne.
        """
        self.of_largest = "contact_force" if height_prescribed else "load"
        self.body_weight, self._model = body_weight, model if model and model.patch else None
        self.totals, self.course, self.mean = Totals(doubts or Doubts()), Course(len(COLUMNS)), Mean()
        self.moments: list[Moment] = []
        self.largest: Moment | None = None
        """Where `of_largest` is largest, which its event names; None: nothing came"""
        self.cycles: list[Cycle] = []
        self.strikes = 0
        """Heel strikes that another one followed: as many cycles, if all had been plausible"""
        self._finder = GaitEvents(body_weight)
        self._stamps, self._values = np.empty(0, dtype=np.int64), np.empty((0, len(COLUMNS)))
        self._since = 0
        """[ns] that elapsed time lags behind the stamps"""
        self._pending: list[GaitEvent] = []

    @property
    def reads_off(self) -> bool:
        """Whether patch and pressure are known."""
        return self._model is not None

    def add(self, answers: Rows) -> None:
        """Take answers, at least one."""
        cuts = np.flatnonzero((np.diff(answers["stamp"]) <= 0) | (np.diff(answers["stamp"]) > GAP)) + 1
        for part in np.split(np.arange(len(answers)), cuts):
            self._add(answers[part])

    def finish(self) -> Gathered:
        """No more will come."""
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
        """`COLUMNS` of answers, shape (n, columns)."""
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
        """The contact of the tick at a stamp, or the last one before."""
        return contact_in(self._values[max(int(np.searchsorted(self._stamps, stamp, "right")) - 1, 0)])

    def _cycles(self, *, ended: bool) -> None:
        """Take the cycles whose events are all certain."""
        strikes = sorted(event.stamp for event in self._pending if event.kind == HEEL_STRIKE)
        toe_offs = sorted(event.stamp for event in self._pending if event.kind == TOE_OFF)
        certain = [stamp for stamp in strikes if ended or stamp <= self._stamps[-1] - CERTAIN]
        for span in spans(certain, toe_offs):
            if self._stamps[0] <= span.start:
                self._add_cycle(span)
        self.strikes += max(len(certain) - 1, 0)
        oldest = max(certain[-1] if certain else 0, int(self._stamps[-1]) - KEPT) if len(self._stamps) else 0
        self._pending = [event for event in self._pending if event.stamp >= oldest]

    def _add_cycle(self, span: Span) -> None:
        self.mean.add(curves(self._stamps, self._values, span))
        self.cycles.append(measured(self._stamps, self._values, span))


def contact_in(row: Floats) -> list[float]:
    """What a moment tells of the contact, of a row of `COLUMNS`."""
    return [float(row[COLUMNS.index(name)]) for name in TOLD]
