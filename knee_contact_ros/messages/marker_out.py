"""Markers to bytes: a visualization_msgs/msg/MarkerArray, which viewers of ROS draw."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.cdr import HEADER, SECOND, check_stamp

LIFETIME = 1
"""How long [s] a viewer shows a marker that does not come again"""
Colour = tuple[float, float, float]
"""RGB, 0 to 1"""


class Shape(IntEnum):
    """What is drawn; the values are those of the message."""

    ARROW = 0
    SPHERE = 2
    LINE_STRIP = 4


class Action(IntEnum):
    """What is done; likewise."""

    ADD = 0
    DELETE = 2


class Pose(NamedTuple):
    """Where a marker's own frame lies in the message's."""

    x: float = 0.0
    """[m]"""
    y: float = 0.0
    """[m]"""
    turn: float = 0.0
    """[rad] about z, from x to y"""


class Marker(NamedTuple):
    """One marker, the only one of its name."""

    name: str
    """Its namespace"""
    shape: Shape
    scale: tuple[float, float, float]
    """[m] as the shape has it: a line's width; diameters; those of an arrow's shaft and head, and its head's length"""
    colour: Colour
    pose: Pose = Pose()
    points: bytes = b""
    """Of a line or an arrow; see `points_of`"""
    action: Action = Action.ADD


KIND = struct.Struct("<3i")
"""Number, shape and action"""
BODY = struct.Struct("<7d3d4fiI?3xI")
"""From a multiple of 8 B on: pose, scale, colour, lifetime, whether locked to its frame, number of points"""
POINT = struct.Struct("<3d")
NONE, EMPTY = struct.pack("<I", 0), struct.pack("<I4x", 1)
"""A sequence without elements; a text without letters, which ends with a 0"""
NOTHING_MORE = NONE + EMPTY + bytes(8) + 2 * EMPTY + 2 * NONE + 3 * EMPTY + NONE + bytes(1)
"""The points' colours; texture: name, stamp, frame, format, data, places; text; mesh: name, file, data, materials"""


def points_of(plane: NDArray[np.float64]) -> bytes:
    """Points of the plane z = 0, shape (n, 2) [m], as a marker takes them."""
    return np.column_stack([plane, np.zeros(len(plane))]).astype("<f8").tobytes()


def encode_markers(stamp: int, frame_id: str, markers: Sequence[Marker]) -> bytes:
    """Bytes of the message; stamp in [ns].

    The markers are locked to their frame: a viewer draws them where it is now, not where it was at the stamp.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    check_stamp(stamp)
    header = struct.pack("<iI", *divmod(stamp, SECOND)) + _text(frame_id)
    data = bytearray(HEADER + struct.pack("<I", len(markers)))
    for marker in markers:
        data += _padding(data, 4) + header
        data += _text(marker.name)
        data += KIND.pack(0, marker.shape, marker.action)
        data += _padding(data, 8)
        data += _body(marker)
        data += marker.points
        data += NOTHING_MORE
    return bytes(data)


def _body(marker: Marker) -> bytes:
    x, y, turn = marker.pose
    half = 0.5 * turn
    return BODY.pack(
        x, y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half), *marker.scale, *marker.colour, 1.0,
        LIFETIME, 0, True, len(marker.points) // POINT.size,
    )  # fmt: skip


def _text(text: str) -> bytes:
    """A text and what makes the next 4 B begin in time."""
    encoded = text.encode()
    return struct.pack("<I", len(encoded) + 1) + encoded + bytes(4 - len(encoded) % 4)


def _padding(data: bytes | bytearray, size: int) -> bytes:
    return bytes((len(HEADER) - len(data)) % size)
