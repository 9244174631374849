"""Results of a tick for the outputs: a row of numbers, and the bytes of its input and output messages.

The process of a recorder works with these alone, so nothing is imported here.
"""

from __future__ import annotations

from typing import NamedTuple

Record = tuple[str, int, bytes]
"""Message as it is recorded: topic, stamp [ns] and CDR bytes"""


class Answer(NamedTuple):
    """Results of one tick."""

    row: bytes
    """Bytes of a `ROW` for each compartment, the medial one first"""
    records: tuple[Record, ...]
    """Messages of the tick: the angles up to its stamp, the load, the answers, the wrench"""
    size: int
    """Size [B] of these messages"""


class Ending(NamedTuple):
    """End of a stream of answers."""

    inputs: tuple[Record, ...]
    """Input messages that belong to no answer"""
    refused: dict[str, int]
    """Number of refused samples by reason"""
