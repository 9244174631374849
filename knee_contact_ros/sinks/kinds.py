"""The sinks of the node: an MCAP recording and a Rerun recording, each written by a process of its own."""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path

from knee_contact_ros.bags.writer import Settings
from knee_contact_ros.sinks.process import Listeners, Queue, SinkOptions, SinkProcess
from knee_contact_ros.sinks.protocol import Job
from knee_contact_ros.view.outlines import KneeOutlines, Serving

VIEWERS_NICENESS = 10
"""A viewer may wait for all others. A recorder may not: what it has not written yet is lost with the node."""


def recorder(
    path: Path,
    provenance: Mapping[str, str],
    names: Mapping[str, str],
    settings: Settings,
    queue: Queue,
    tell: Listeners,
    awaited: bool = False,
    name: Path | None = None,
) -> SinkProcess:
    """A process that records to MCAP, as `name` until it says otherwise.

    See `answer_recorder.open_output` and `SinkProcess`.
    """
    job = Job("knee_contact_ros.bags.answer_recorder", (path, dict(provenance), dict(names), settings))
    handling = SinkOptions(attrgetter("records"), queue, "record", gaps_allowed=False)
    return SinkProcess("recording", str(name or path), job, handling, tell, awaited)


def viewer(
    path: Path | None, serving: Serving, drawing: KneeOutlines, queue: Queue, tell: Listeners, awaited: bool = False
) -> SinkProcess:
    """A process that writes a Rerun file or, without a `path`, serves; see `view.output.open_output`, `SinkProcess`."""
    job = Job("knee_contact_ros.view.output", (path, serving, drawing))
    handling = SinkOptions(attrgetter("row"), queue, "rerun", gaps_allowed=True, niceness=VIEWERS_NICENESS)
    kind = "Rerun recording" if path else f"Rerun scene on port {serving.port}"
    return SinkProcess(kind, str(path or ""), job, handling, tell, awaited)
