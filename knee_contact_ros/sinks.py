"""The sinks of the node: an MCAP recording and a Rerun recording, each written by a process of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from knee_contact_ros.answer import Answer
from knee_contact_ros.apart import Handling, Job, SinkProcess, Tell
from knee_contact_ros.drawing import Drawing, Serving, shown_row
from knee_contact_ros.record import Settings

MOST_UNRECORDED = 500_000
"""Answers that may wait to be recorded: minutes, and 1 GB. A recording has no gaps: with more it has failed."""
MOST_UNSHOWN = 20_000
"""Answers that may wait to be shown; more are dropped and counted."""
PATIENCE = 10.0
"""How long [s] nothing may move in a process that shall end; on a busy machine it is the last to get a turn."""


def recorder(
    path: Path,
    provenance: Mapping[str, str],
    names: Mapping[str, str],
    settings: Settings,
    tell: Tell,
    awaited: bool = False,
) -> SinkProcess:
    """A process that records to MCAP; see `record_answers.open_output` and `SinkProcess`."""
    job = Job("knee_contact_ros.record_answers", (path, dict(provenance), dict(names), settings))
    handling = Handling(recorded_row, MOST_UNRECORDED, gaps_allowed=False, patience=PATIENCE)
    return SinkProcess(f"recording {path}", job, handling, tell, awaited)


def viewer(path: Path | None, serving: Serving, drawing: Drawing, tell: Tell, awaited: bool = False) -> SinkProcess:
    """A process that writes a Rerun file or, without a `path`, serves; see `view.output.open_output`, `SinkProcess`."""
    job = Job("knee_contact_ros.view.output", (path, serving, drawing))
    handling = Handling(shown_row, MOST_UNSHOWN, gaps_allowed=True, patience=PATIENCE)
    label = f"Rerun recording {path}" if path else f"Rerun scene on port {serving.port}"
    return SinkProcess(label, job, handling, tell, awaited)


def recorded_row(answer: Answer) -> tuple[Any, ...]:
    """What is recorded of an answer, in plain tuples: named ones take five times as long to send."""
    inputs = tuple([(topic, stamp, tuple(message)) for topic, stamp, message in answer.inputs])
    return answer.stamp, inputs, answer.message, answer.wrench
