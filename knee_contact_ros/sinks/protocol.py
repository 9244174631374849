"""What the node and the process of an output tell each other, beside answers; see `process.py` and `worker.py`."""

from __future__ import annotations

from typing import Any, NamedTuple

OPEN, REFUSED, FAILED, ENDED, DONE = "open", "refused", "failed", "ended", "done"
"""States of a child: its output is open, could not be opened, stopped, is complete sooner than it was to be, is
complete"""


class Job(NamedTuple):
    """What a child is for."""

    module: str
    """It has a function `open_output` that gives an `worker.Output`"""
    arguments: tuple[Any, ...]
    """Of that function"""


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
