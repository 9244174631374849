"""Writes markers as a visualization_msgs/msg/MarkerArray, for RViz and other viewers."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.streams.messages import HEADER
from knee_contact_ros.streams.topics import NANOSECONDS, check_stamp

LIFETIME = 1
"""Time [s] for which a viewer shows a marker that is not sent again"""
Colour = tuple[float, float, float]
"""Red, green and blue, from 0 to 1"""


class Shape(IntEnum):
    """Shape of a marker; the values are those of the message."""

    ARROW = 0
    SPHERE = 2
    LINE_STRIP = 4


class Action(IntEnum):
    """Action of a marker; the values are those of the message."""

    ADD = 0
    DELETE = 2


class Marker(NamedTuple):
    """Constant properties of a marker; its name is unique."""

    name: str
    """Namespace of the marker"""
    shape: Shape
    scale: tuple[float, float, float]
    """Sizes [m]: width of a line; diameters of a sphere; diameters of an arrow's shaft and head, and head length"""
    colour: Colour
    points: NDArray[np.float64] = np.empty((0, 2))
    """Points [m] of a line or an arrow in the marker's own frame, shape (n, 2)"""


class _Places(NamedTuple):
    """Offsets [B] of the parts of a marker in the message."""

    stamp: int
    action: int
    pose: int
    colour: int
    points: int


STAMP = struct.Struct("<iI")
KIND = struct.Struct("<2i")
"""Number and shape of a marker, which precede its action"""
ACTION = struct.Struct("<i")
POSE, SCALE, COLOUR, REST = struct.Struct("<7d"), struct.Struct("<3d"), struct.Struct("<4f"), struct.Struct("<iI?3xI")
"""Parts that begin at a multiple of 8 B; REST is lifetime, whether locked to its frame, number of points"""
POINT = struct.Struct("<3d")
NONE, EMPTY = struct.pack("<I", 0), struct.pack("<I4x", 1)
"""An empty sequence; an empty text, which ends with a 0"""
NOTHING_MORE = NONE + EMPTY + bytes(8) + 2 * EMPTY + 2 * NONE + 3 * EMPTY + NONE + bytes(1)
"""Unused fields: colours of the points; texture (name, stamp, frame, format, data, coordinates); text; mesh (name,
file, data, materials)"""


class MarkerMessage:
    """Message that is laid out once, and whose moving parts are overwritten. Shapes lie in planes of constant z.

    The markers are locked to their frame: a viewer draws them where the frame is now, not where it was at the stamp.
    """

    def __init__(self, frame_id: str, markers: Sequence[Marker]) -> None:
        """Lay out a message with stamp 0 and with each marker's own frame at the origin."""
        self.frame_id = frame_id
        self._data = bytearray(HEADER + struct.pack("<I", len(markers)))
        self._places = [self._lay_out(marker) for marker in markers]

    def set_stamp(self, stamp: int) -> None:
        """Give all markers a stamp [ns].

        Raises:
            ValueError: the stamp is beyond what ROS can hold.
        """
        check_stamp(stamp)
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        for places in self._places:
            STAMP.pack_into(self._data, places.stamp, seconds, nanoseconds)

    def move(self, number: int, x: float, y: float, turn: float, z: float = 0.0) -> None:
        """Move a marker's own frame to x, y, z [m], turned about z by an angle [rad] from x to y."""
        half = 0.5 * turn
        POSE.pack_into(self._data, self._places[number].pose, x, y, z, 0.0, 0.0, math.sin(half), math.cos(half))

    def paint(self, number: int, colour: Colour) -> None:
        """Change the colour of a marker."""
        COLOUR.pack_into(self._data, self._places[number].colour, *colour, 1.0)

    def place(self, number: int, *points: tuple[float, float, float]) -> None:
        """Change the first points [m] of a marker; there may not be more than it has."""
        begin = self._places[number].points
        for point in points:
            POINT.pack_into(self._data, begin, *point)
            begin += POINT.size

    def show(self, number: int, shown: bool) -> None:
        """Have a viewer show a marker, or hide it."""
        ACTION.pack_into(self._data, self._places[number].action, Action.ADD if shown else Action.DELETE)

    def tobytes(self) -> bytes:
        """Bytes of the message."""
        return bytes(self._data)

    def _lay_out(self, marker: Marker) -> _Places:
        points = np.column_stack([marker.points, np.zeros(len(marker.points))])
        stamp = self._add(STAMP.pack(0, 0), 4)
        self._add(_text(self.frame_id), 4)
        self._add(_text(marker.name), 4)
        self._add(KIND.pack(0, marker.shape), 4)
        action = self._add(ACTION.pack(Action.ADD), 4)
        pose = self._add(POSE.pack(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), 8)
        self._add(SCALE.pack(*marker.scale), 8)
        colour = self._add(COLOUR.pack(*marker.colour, 1.0), 4)
        self._add(REST.pack(LIFETIME, 0, True, len(points)), 4)
        place = self._add(points.astype("<f8").tobytes(), 8 if len(points) else 4)  # without points there is no padding
        self._add(NOTHING_MORE, 4)
        return _Places(stamp, action, pose, colour, place)

    def _add(self, part: bytes, size: int) -> int:
        """Append a part that begins at a multiple of a size [B]; return its offset."""
        self._data += bytes((len(HEADER) - len(self._data)) % size)
        begin = len(self._data)
        self._data += part
        return begin


def _text(text: str) -> bytes:
    encoded = text.encode() + b"\x00"
    return struct.pack("<I", len(encoded)) + encoded
