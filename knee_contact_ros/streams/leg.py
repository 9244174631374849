"""The leg for viewers, as recordings hold it: its description (URDF), and where the thigh is (tf2).

The shank stands in the frame of the forces, the tibia frame, and the thigh where the answers have the femur. So Rerun,
RViz and Foxglove draw and move the leg of a recording without anything else.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import lru_cache
from struct import Struct
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import ROW, Rows, reader
from knee_contact_ros.streams.messages import HEADER, Bytes, Stamps
from knee_contact_ros.streams.topics import LEG_URDF, NANOSECONDS, ROBOT_DESCRIPTION, SHANK, TF, Record
from knee_contact_ros.system.files import share_folder

MOVED, DESCRIBED = NANOSECONDS // 50, 10 * NANOSECONDS
"""Periods [ns]: at the first tick of one the thigh is placed, and the leg described again, for snapshots and splits"""
QUOTE = {'"': "&quot;"}
SHOWN = reader("flexion_angle", "femoral_height", "femoral_x")
"""Reader of the fields of an answer's row that the pose of the thigh follows from"""


class Leg:
    """Makes the messages about the leg, tick by tick or for many; they depend on stamps and answers alone."""

    def __init__(self) -> None:
        """Begin without ticks; the leg's file is read here, and at no tick."""
        self._last = -1
        _urdf()

    def records(self, stamp: int, frame_id: str, row: bytes) -> list[Record]:
        """Messages of a tick at a stamp [ns], of whose answer the bytes of the `row` are given."""
        before, self._last = self._last, stamp
        records: list[Record] = []
        if stamp // DESCRIBED != before // DESCRIBED:
            records.append((ROBOT_DESCRIPTION, stamp, description(frame_id)))
        if stamp // MOVED != before // MOVED:
            records.append((TF, stamp, pose(stamp, frame_id, row)))
        return records

    def messages(self, stamps: Stamps, frame_id: str, rows: Rows) -> Iterator[tuple[str, NDArray[np.intp], Bytes]]:
        """Yield the topics of many ticks, shape (n,), with the numbers of the ticks and the messages of `records`."""
        before = np.append(self._last, stamps[:-1])
        self._last = int(stamps[-1])
        described, moved = (np.flatnonzero(stamps // each != before // each) for each in (DESCRIBED, MOVED))
        texts = [description(frame_id)] * len(described)
        poses = [pose(int(stamps[i]), frame_id, rows[i : i + 1].tobytes()) for i in moved]
        for topic, ticks, data in ((ROBOT_DESCRIPTION, described, texts), (TF, moved, poses)):
            yield topic, ticks, np.array([np.frombuffer(one, np.uint8) for one in data])


@lru_cache(maxsize=1)
def _urdf() -> str:
    return (share_folder() / LEG_URDF).read_text(encoding="utf-8")


@lru_cache(maxsize=4)
def description(frame_id: str) -> bytes:
    """Bytes of a std_msgs/String with the URDF of a leg whose shank is `frame_id`, or `shank` if that is empty."""
    text = _urdf().replace(f'"{SHANK}', f'"{escape(frame_id or SHANK, QUOTE)}').encode() + b"\0"
    return HEADER + len(text).to_bytes(4, "little") + text


def pose(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of a tf2_msgs/TFMessage with the pose of the thigh in `frame_id` at a stamp [ns]."""
    angle, height, x = SHOWN.unpack(row[: ROW.itemsize])
    pack, parent, child = _packer(frame_id)
    seconds, nanoseconds = divmod(stamp, NANOSECONDS)
    turn = math.sin(0.5 * angle), math.cos(0.5 * angle)
    return pack(
        HEADER, 1, seconds, nanoseconds, len(parent), parent, len(child), child, x, height, 0.0, 0.0, 0.0, *turn
    )


@lru_cache(maxsize=4)
def _packer(frame_id: str) -> tuple[Callable[..., bytes], bytes, bytes]:
    """Packer of a message with one transform, and the names of its frames."""
    frame_id = frame_id or SHANK
    parent, child = f"{frame_id}\0".encode(), f"{frame_id}/thigh\0".encode()
    first = -len(parent) % 4
    second = -(16 + len(parent) + first + 4 + len(child)) % 8
    return Struct(f"<4sIiII{len(parent)}s{first}xI{len(child)}s{second}x7d").pack, parent, child
