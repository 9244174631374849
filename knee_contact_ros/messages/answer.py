"""What a tick leaves behind: a row of numbers, and the messages that led to it and that tell of it, as bytes.

A recorder's process takes these and needs no more, so nothing is imported here.
"""

from __future__ import annotations

from typing import NamedTuple

Record = tuple[str, int, bytes]
"""A message as it is recorded: topic, stamp [ns] and CDR"""


class Answer(NamedTuple):
    """One tick."""

    row: bytes
    """Of `ROW`, one for each compartment, the medial one first"""
    records: tuple[Record, ...]
    """The angles up to its stamp, the load, the answer, its wrench"""
    size: int
    """[B] of these messages"""


class Ending(NamedTuple):
    """What is left to say when a stream ends."""

    inputs: tuple[Record, ...]
    """Those that belong to no answer"""
    refused: dict[str, int]
    """Refused samples by reason"""
