"""Definition of an output, and the messages between the node and its process.

An output is one module, which a section of the parameters names. It has a function `sink_for`, which describes it to
the node, and a function `open_output`, which opens it in its process. The node's side is `node/outputs.py`, that of the
process `node/output_process.py`. An open output has

- `name`: name of the file, empty if there is none, and `period`: time [s] between two flushes;
- `write(parts)`: takes the parts of answers that came together, at least one, in their order;
- `note(name, values)`: takes a `Note`;
- `flush()`: writes out everything that was taken;
- `news()`: returns messages for the user that are new since the last call, once a second, or raises UsageError if the
  output had to be completed early, and is;
- `finish(ending)`: completes the output; `ending` is None if the node is gone or the output has to end early.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from ..model.knee import KneeModel

STARTING, OPEN, REFUSED, FAILED, ENDED = "starting", "open", "refused", "failed", "ended"
"""States of an output: not known yet, open, could not be opened or had to end early, has failed, is complete"""

PROVENANCE = "knee_contact"
"""Name of the metadata record that describes how contacts were computed (`bags/provenance.py`)"""
TICK = "tick"
"""Key in the metadata records of changes of a running node for the number of ticks before"""
LOAD_PROVENANCE = "knee_load"
"""Name of that record for estimated joint reactions; the other name would let them be computed again as contacts"""


RESET = "reset"
"""Name of the metadata record of a reset"""
WAITING = "waiting"
"""Key in this record for the number of angles that had come and belong to later answers"""
ANSWERS_FLAGGED = "answers_flagged"
"""Name of the metadata record of bits of `Status` that all later answers have, until the next such record"""
STATUS = "status"
"""Key in this record for the bits, as a number"""


class RunState(NamedTuple):
    """State of a run between two ticks; it is written to a recording as JSON."""

    stamp: int | None
    """Stamp of the last tick [ns]; None after a reset"""
    angles: Sequence[Sequence[Any]]
    """Angles that the last tick has used, and the next one may: stamp, angle, height and delay of an `AngleSample`"""
    numbers: Sequence[Any]
    """`Stream.state` of each compartment, whose method `tolist` gives the numbers"""


class RecordedKnee(NamedTuple):
    """A knee's data for outputs."""

    parameters: Any
    """Parameters of the node, with a section for each output"""
    models: Mapping[str, KneeModel]
    """Model of each compartment by the topic of its answers, the medial one first"""
    names: Mapping[str, str]
    """Absolute name under which each topic is recorded"""
    provenance: Mapping[str, str]
    """Content of the metadata record that describes how the answers were computed"""
    provenance_name: str = PROVENANCE
    """Name of that metadata record"""


class Sink(NamedTuple):
    """Description of an output; `sink_for` returns it for a `RecordedKnee`, or None if the parameters request none."""

    title: str
    """Name of the output in /diagnostics"""
    kind: str
    """Word for the output in messages"""
    name: str
    """Intended name of the file, which may turn out to be taken; empty if there is none"""
    module: str
    """Name of the module with the function `open_output`, which returns an open output in the process of the sink"""
    arguments: tuple[Any, ...]
    """Arguments of that function"""
    part: str
    """Attribute of an answer to send: its `row` or its `records`, which are quick to send"""
    gaps_allowed: bool
    """Whether answers beyond the queue are dropped and counted; otherwise the output ends then"""
    niceness: int = 0
    """Niceness of the process, added to the node's"""
    gather: float = 0.01
    """Time [s] for which answers are gathered before they are sent, as a sending costs the node and the output as much
    as many answers"""
    section: str = ""
    """Name of its section of parameters, which the node sets"""
    limits: Any = None
    """That section: its `queue` is the largest number of answers that wait, its `queue_size` their memory [MB]"""
    apart: bool = False
    """Whether its process leaves a processor to the node, which the node sets"""


class Note(NamedTuple):
    """A remark that belongs between two answers, such as a change of parameters."""

    name: str
    """Name of the metadata record"""
    values: dict[str, str]
    """Content of the record"""


class Report(NamedTuple):
    """Report of a process on its output."""

    state: str
    """One of `OPEN`, `REFUSED`, `FAILED` and `ENDED`"""
    written: int
    """Number of answers written"""
    name: str = ""
    """Name of the file once it is open; empty if there is none"""
    reason: str = ""
    """Reason why the output was refused or has failed; a whole sentence if refused"""
    remarks: tuple[str, ...] = ()
    """Further messages for the user"""
