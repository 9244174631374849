"""What a tick leaves behind: the answer, with the messages that led to it."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.types import Contact
from knee_contact_ros.messages.cdr_in import JointState, WrenchStamped

Input = tuple[str, int, JointState | WrenchStamped]
"""Topic, stamp [ns] and content of an input message"""


class Answer(NamedTuple):
    """One tick, with the messages that led to it."""

    stamp: int
    """[ns]"""
    frame_id: str
    """The tibia frame"""
    contact: Contact
    femoral_x: float
    """[m] of the femoral reference point along the tibia's x axis"""
    normal: tuple[float, float]
    """Of the tibial surface at the contact point, from tibia to femur (x, y)"""
    inputs: tuple[Input, ...]
    """The angles up to this stamp, then the load"""
    message: bytes
    """The answer as a `KneeContact`, as it is published and recorded"""
    wrench: bytes
    """The contact force on the tibia as a `WrenchStamped`, likewise"""
    latency: float = math.nan
    """[s] from the load's arrival to the answer's publication; not a number offline"""


class Ending(NamedTuple):
    """What is left to say when a stream ends."""

    inputs: tuple[Input, ...]
    """Those that belong to no answer"""
    refused: dict[str, int]
    """Refused samples by reason"""
