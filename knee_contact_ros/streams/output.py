"""Definition of an output, and the messages between the node and its process.

An output is one module, which a section of the parameters names. It has a function `sink_for`, which describes it to
the node, and a function `open_output`, which opens it in its process. The node's side is `node/outputs.py`, that of the
process `node/output_process.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from knee_contact_ros.streams.topics import Ending

if TYPE_CHECKING:
    from knee_contact_ros.model.knee import KneeModel

OPEN, REFUSED, FAILED, ENDED, DONE = "open", "refused", "failed", "ended", "done"
"""States of a child: its output is open, could not be opened, has failed, is complete earlier than intended, is
complete"""


PROVENANCE = "knee_contact"
"""Name of the metadata record that describes how contacts were computed (`bags/provenance.py`)"""
LOAD_PROVENANCE = "knee_load"
"""Name of that record for estimated joint reactions; under the other name they would be computed again as contacts"""


class Knee(NamedTuple):
    """A knee as outputs need to know it."""

    parameters: Any
    """Parameters of the node, with a section for each output"""
    models: Mapping[str, KneeModel]
    """Model of each compartment by the topic of its answers, the medial one first"""
    names: Mapping[str, str]
    """Absolute name under which each topic is recorded"""
    provenance: Mapping[str, str]
    """Content of the metadata record that describes how the answers were computed"""
    told_as: str = PROVENANCE
    """Name of that metadata record"""


class Job(NamedTuple):
    """Task of a child: the output that it opens."""

    module: str
    """Name of the module with the function `open_output`, which returns an `Output`"""
    arguments: tuple[Any, ...]
    """Arguments of that function"""


class Sink(NamedTuple):
    """Description of an output, as `sink_for` returns it for a `Knee`; None instead if the parameters ask for none."""

    title: str
    """Name of the output in /diagnostics"""
    kind: str
    """Word for the output in messages"""
    name: str
    """Name of the file, unless it turns out to be taken; empty if there is none"""
    job: Job
    """Task of its process"""
    part: str
    """Attribute of an answer that is sent: its `row` or its `records`, which are quick to send"""
    gaps_allowed: bool
    """Whether answers beyond the queue are dropped and counted; if not, the sink fails then"""
    niceness: int = 0
    """Niceness of the process, added to the node's"""
    gather: float = 0.01
    """Time [s] for which answers are gathered before they are sent, while more come: each sending costs the node and
    the output as much as many answers do"""


class Output(Protocol):
    """An open output in its process: a file or a viewer."""

    name: str
    """Name of the file; empty if there is none"""
    period: float
    """Time [s] between two flushes"""

    def write(self, parts: Sequence[Any]) -> None:
        """Take the parts of answers that came together, at least one, in their order."""

    def note(self, name: str, values: dict[str, str]) -> None:
        """Take a note."""

    def flush(self) -> None:
        """Write out everything that was taken."""

    def must_end(self) -> str:
        """Reason why the output has to be completed early; empty if it has not. Called once a second."""

    def news(self) -> tuple[str, ...]:
        """Messages for the user that are new since the last call. Called once a second."""

    def finish(self, ending: Ending | None) -> None:
        """Complete the output; `ending` is None if the node is gone or the output has to end early."""

    def discard(self) -> None:
        """Remove the output."""


Parts = tuple[list[Any], bool]
"""Parts of answers that are sent together, and whether more wait already"""


class Note(NamedTuple):
    """A remark that belongs between two answers, such as a change of parameters."""

    name: str
    """Name of the metadata record"""
    values: dict[str, str]
    """Content of the record"""


class Discard(NamedTuple):
    """Last item for a child: the output is to be removed."""


class Report(NamedTuple):
    """Report of a child on its output."""

    state: str
    """One of `OPEN`, `REFUSED`, `FAILED`, `ENDED` and `DONE`"""
    written: int
    """Number of answers written"""
    name: str = ""
    """Name of the file once it is open; empty if there is none"""
    reason: str = ""
    """Reason why the output was refused, has failed or has ended"""
    remarks: tuple[str, ...] = ()
    """Further messages for the user"""
