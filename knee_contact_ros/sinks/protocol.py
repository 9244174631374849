"""What makes an output, and what the node and its process tell each other; see `process.py` and `worker.py`.

An output is one module, which a section of the parameters names. It has `sink_for`, which describes it to the node, and
`open_output`, which opens it in its process.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from knee_contact_ros.messages.answer import Ending

if TYPE_CHECKING:
    from knee_contact_ros.core.model import KneeModel

OPEN, REFUSED, FAILED, ENDED, DONE = "open", "refused", "failed", "ended", "done"
"""States of a child: its output is open, could not be opened, stopped, is complete sooner than it was to be, is
complete"""


PROVENANCE = "knee_contact"
"""Name of the metadata record that says how answers come about (`bags/provenance.py`)"""
LOAD_PROVENANCE = "knee_load"
"""Likewise of estimated joint reactions; by the other one they would be computed again as contacts"""


class Knee(NamedTuple):
    """What outputs are described from."""

    parameters: Any
    """Of the node, with a section for each output"""
    models: Mapping[str, KneeModel]
    """Of each compartment, by the topic of its answers, the medial one first"""
    names: Mapping[str, str]
    """The absolute name under which each topic is recorded"""
    provenance: Mapping[str, str]
    """What recordings say of themselves"""
    told_as: str = PROVENANCE
    """Name of the metadata record that says it"""


class Job(NamedTuple):
    """What a child is for."""

    module: str
    """It has a function `open_output` that gives an `Output`"""
    arguments: tuple[Any, ...]
    """Of that function"""


class Sink(NamedTuple):
    """An output, as `sink_for` describes it to the node for a `Knee`; that gives None if parameters ask for none."""

    title: str
    """In /diagnostics"""
    kind: str
    """In messages"""
    name: str
    """Of the file, unless another one turns out to be free; empty if there is none"""
    job: Job
    part: str
    """What is sent of an answer: its `row` or its `records`, which are quick to send"""
    gaps_allowed: bool
    """Whether answers beyond the queue are dropped and counted; otherwise the sink has failed then"""
    niceness: int = 0
    """Added to the node's"""
    gather: float = 0.01
    """How long [s] answers are gathered before they are sent, while more come: each time costs the node and the output
    as much as many answers do"""


class Output(Protocol):
    """What a sink writes to."""

    name: str
    """Of the file; empty if there is none"""
    period: float
    """How often [s] to flush"""

    def write(self, parts: Sequence[Any]) -> None:
        """Take what was sent of answers that came together, at least one, in their order."""

    def note(self, name: str, values: dict[str, str]) -> None:
        """Take a note."""

    def flush(self) -> None:
        """Leave nothing for later."""

    def must_end(self) -> str:
        """Why the output has to be completed though more may come; empty if it has not. Asked once a second."""

    def news(self) -> tuple[str, ...]:
        """What the user shall know and was not told yet. Asked once a second."""

    def finish(self, ending: Ending | None) -> None:
        """Complete the output; without an ending, because the node is gone or it has to end."""

    def discard(self) -> None:
        """Leave nothing behind."""


Parts = tuple[list[Any], bool]
"""What is sent of answers that came together, and whether more wait already"""


class Note(NamedTuple):
    """Something to be told between two answers."""

    name: str
    values: dict[str, str]


class Discard(NamedTuple):
    """The output shall vanish."""


class Report(NamedTuple):
    """What a child says of itself."""

    state: str
    written: int
    """Answers"""
    name: str = ""
    """Of the file, once it is open; empty if there is none"""
    reason: str = ""
    """Why it refused, failed or ended"""
    remarks: tuple[str, ...] = ()
    """What else the user shall know"""
