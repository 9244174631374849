"""Events as text: contact and bone, gait with the impulse of strides, status bits, changes of the node."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.model.types import ContactState, Rows, Status
from knee_contact_ros.pipeline.gait.events import GAP, HEEL_STRIKE, LOAD_PEAK, TOE_OFF, GaitEvent, GaitEvents
from knee_contact_ros.pipeline.gait.strides import CERTAIN, KEPT, impulse_of, spans

INFO, WARNING = "INFO", "WARN"


class Remark(NamedTuple):
    """A line of the events."""

    stamp: int
    """Stamp [ns]"""
    text: str
    level: str = INFO


CONTACT: dict[tuple[int, int], str] = {
    (ContactState.SEPARATED, ContactState.CARTILAGE): "touch-down",
    (ContactState.SEPARATED, ContactState.BONE): "touch-down, down to the bone",
    (ContactState.CARTILAGE, ContactState.BONE): "bone contact begins",
    (ContactState.BONE, ContactState.CARTILAGE): "bone contact ends",
    (ContactState.CARTILAGE, ContactState.SEPARATED): "lift-off",
    (ContactState.BONE, ContactState.SEPARATED): "lift-off from the bone",
}
STATUS = {
    Status.STALE_INPUT: "stale input: a long gap between stamps",
    Status.TIME_RESET: "time reset: started anew",
    Status.INPUT_HELD: "input held: no angle came in time",
    Status.NOT_CONVERGED: "not converged: a tolerance is not met",
    Status.INPUT_REJECTED: "a sample was refused",
    Status.IMPLAUSIBLE: "implausible: deeper than any knee",
}


class Gait:
    """Finds the events of gait and, at the end of every stride, its impulse."""

    def __init__(self, body_weight: float) -> None:
        """Look for events relative to `body_weight` [N]."""
        self._events = GaitEvents(body_weight)
        self._known: list[GaitEvent] = []
        """Events with which a stride may still begin or continue"""
        self._stamps, self._force = np.empty(0, dtype=np.int64), np.empty(0)

    def take(self, answers: Rows) -> list[Remark]:
        """Return the remarks that become certain with these answers, at least one."""
        stamps, remarks = answers["stamp"], []
        steps = np.diff(stamps, prepend=self._stamps[-1] if len(self._stamps) else stamps[0] - 1)
        cuts = np.flatnonzero((steps <= 0) | (steps > GAP)).tolist()
        for begin, end in zip([0, *cuts], [*cuts, len(answers)], strict=True):
            if begin in cuts:
                remarks += self.finish()
            if end > begin:
                remarks += self._continue(answers[begin:end])
        return remarks

    def finish(self) -> list[Remark]:
        """Return the remarks that the end makes certain; later answers start anew."""
        remarks = self._remarks_on(self._events.finish(), math.inf)
        self._known, self._stamps, self._force = [], self._stamps[:0], self._force[:0]
        return remarks

    def _continue(self, part: Rows) -> list[Remark]:
        """Take answers without a gap; return the remarks that become certain."""
        self._stamps = np.append(self._stamps, part["stamp"])
        self._force = np.append(self._force, part["contact_force"])
        last = int(self._stamps[-1])
        events = self._events.add(part["stamp"], part["flexion_angle"], part["load"])
        remarks = self._remarks_on(events, last - CERTAIN)
        kept = np.searchsorted(self._stamps, last - KEPT)
        self._stamps, self._force = self._stamps[kept:], self._force[kept:]
        return remarks

    def _remarks_on(self, events: Sequence[GaitEvent], certain: float) -> list[Remark]:
        """Return remarks on events, and on the strides that end up to the stamp `certain` [ns]."""
        remarks = [Remark(event.stamp, event.text) for event in events]
        self._known += [event for event in events if event.kind != LOAD_PEAK]
        strikes, toe_offs = (
            sorted(event.stamp for event in self._known if event.kind == kind and event.stamp <= certain)
            for kind in (HEEL_STRIKE, TOE_OFF)
        )
        for span in spans(strikes, toe_offs):
            _, whole, stance = impulse_of(span, self._stamps, self._force)
            text = f"stride of {span.duration:.2f} s: impulse {whole:.1f} N s, stance {stance:.1f} N s"
            remarks.append(Remark(span.end, text))
        if strikes:
            self._known = [event for event in self._known if event.stamp >= strikes[-1]]
        return remarks


class Remarks:
    """Finds the events in answers, batch by batch; the result does not depend on the batches."""

    def __init__(self, body_weight: float) -> None:
        """Look for events relative to `body_weight` [N]."""
        self._gait = Gait(body_weight)
        self._state = -1
        self._status = 0

    def take(self, answers: Rows) -> list[Remark]:
        """Return the remarks that become certain with these answers, at least one, by their stamps."""
        return sorted([*self._gait.take(answers), *self._contact(answers), *self._flags(answers)])

    def finish(self) -> list[Remark]:
        """Return the remarks that the end makes certain."""
        return self._gait.finish()

    def _contact(self, answers: Rows) -> list[Remark]:
        """Return remarks on changes of the contact state."""
        states = np.concatenate([[self._state], answers["contact_state"].astype(int)])
        self._state = int(states[-1])
        changes = np.flatnonzero(np.diff(states)).tolist()
        pairs = [(int(answers["stamp"][i]), (int(states[i]), int(states[i + 1]))) for i in changes]
        return [Remark(stamp, CONTACT[pair]) for stamp, pair in pairs if pair in CONTACT]

    def _flags(self, answers: Rows) -> list[Remark]:
        """Return remarks on status bits that are set anew."""
        status = np.concatenate([[self._status], answers["status"].astype(int)])
        self._status = int(status[-1])
        begun = status[1:] & ~status[:-1]
        return [
            Remark(int(answers["stamp"][i]), text, WARNING)
            for i in np.flatnonzero(begun).tolist()
            for bit, text in STATUS.items()
            if begun[i] & bit
        ]


def remark_of_note(stamp: int, name: str, values: Mapping[str, str]) -> Remark:
    """Return the remark on a note of something that happened to the node, as a reset or changed parameters."""
    text = ", ".join(f"{key} = {_plain(value)}" for key, value in values.items() if key != "tick")
    return Remark(stamp, name.replace("_", " ") + (f": {text}" if text else ""))


def _plain(value: str) -> str:
    """Return a value in JSON as text without quotes; other text unchanged."""
    try:
        return str(json.loads(value))
    except ValueError:
        return value
