"""What happened, as text: contact that begins and ends, bone, events of gait, status bits, changes to the node."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.types import ContactState, Rows, Status
from knee_contact_ros.pipeline.gait.events import GaitEvents

INFO, WARNING = "INFO", "WARN"


class Remark(NamedTuple):
    """A line."""

    stamp: int
    """[ns]"""
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


class Remarks:
    """Finds what is worth a line, batch by batch; how answers are cut into batches makes no difference."""

    def __init__(self, body_weight: float) -> None:
        """`body_weight` is in N."""
        self._gait = GaitEvents(body_weight)
        self._state = -1
        self._status = 0

    def take(self, shown: Rows) -> list[Remark]:
        """What became certain with these answers, at least one."""
        found = [
            Remark(event.stamp, event.text)
            for event in self._gait.add(shown["stamp"], shown["flexion_angle"], shown["load"])
        ]
        return sorted([*found, *self._contact(shown), *self._flags(shown)])

    def finish(self) -> list[Remark]:
        """What is left at the end."""
        return [Remark(event.stamp, event.text) for event in self._gait.finish()]

    def _contact(self, shown: Rows) -> list[Remark]:
        states = np.concatenate([[self._state], shown["contact_state"].astype(int)])
        self._state = int(states[-1])
        changes = np.flatnonzero(np.diff(states)).tolist()
        pairs = [(int(shown["stamp"][i]), (int(states[i]), int(states[i + 1]))) for i in changes]
        return [Remark(stamp, CONTACT[pair]) for stamp, pair in pairs if pair in CONTACT]

    def _flags(self, shown: Rows) -> list[Remark]:
        status = np.concatenate([[self._status], shown["status"].astype(int)])
        self._status = int(status[-1])
        begun = status[1:] & ~status[:-1]
        return [
            Remark(int(shown["stamp"][i]), text, WARNING)
            for i in np.flatnonzero(begun).tolist()
            for bit, text in STATUS.items()
            if begun[i] & bit
        ]


def remark_of_note(stamp: int, name: str, values: Mapping[str, str]) -> Remark:
    """A line on something that happened to the node, as `Outputs.note` tells it."""
    told = ", ".join(f"{key} = {_plain(value)}" for key, value in values.items() if key != "tick")
    return Remark(stamp, name.replace("_", " ") + (f": {told}" if told else ""))


def _plain(value: str) -> str:
    try:
        return str(json.loads(value))
    except ValueError:
        return value
