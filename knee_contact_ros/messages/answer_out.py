"""Writes the messages of answers: a header, and the part of a row that the message consists of."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from knee_contact_ros.messages.cdr import HEADER, STAMP_END, Bytes, Stamps, filled
from knee_contact_ros.messages.stamps import NANOSECONDS, check_stamp
from knee_contact_ros.model.types import MESSAGE, ROW, WRENCH, Rows


def encode_answer(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of the `KneeContact` message of an answer, with a stamp [ns] that replaces the one in the row.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    return header(stamp, frame_id) + row[MESSAGE]


def encode_answer_wrench(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of the `WrenchStamped` of an answer, the contact force on the tibia; see `encode_answer`."""
    return header(stamp, frame_id) + row[WRENCH]


def encode_answers(frame_id: str, stamps: Stamps, rows: Rows) -> Bytes:
    """Bytes of the `KneeContact` messages of many answers, shape (n, length), as `encode_answer` writes them."""
    return _headed(frame_id, stamps, rows, MESSAGE)


def encode_answer_wrenches(frame_id: str, stamps: Stamps, rows: Rows) -> Bytes:
    """Bytes of the `WrenchStamped` messages of many answers, shape (n, length); see `encode_answer_wrench`."""
    return _headed(frame_id, stamps, rows, WRENCH)


def _headed(frame_id: str, stamps: Stamps, rows: Rows, part: slice) -> Bytes:
    before = header(0, frame_id)
    length = len(before) + part.stop - part.start
    times = np.dtype({"names": ["s", "ns"], "formats": ["<i4", "<u4"], "offsets": [4, 8], "itemsize": length})
    messages, data = filled(before + bytes(length - len(before)), times, len(stamps))
    messages["s"], messages["ns"] = np.divmod(stamps, NANOSECONDS)
    data[:, len(before) :] = rows.view(np.uint8).reshape(len(rows), ROW.itemsize)[:, part]
    return data


def header(stamp: int, frame_id: str) -> bytes:
    """Encapsulation, stamp [ns] and frame of a message, padded to where numbers of 8 B begin.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    check_stamp(stamp)
    pack, frame = _packer(frame_id)
    return pack(HEADER, *divmod(stamp, NANOSECONDS), len(frame), frame)


@lru_cache(maxsize=16)
def _packer(frame_id: str) -> tuple[Callable[..., bytes], bytes]:
    frame = frame_id.encode() + b"\x00"
    padding = -(STAMP_END - len(HEADER) + 4 + len(frame)) % 8
    return struct.Struct(f"<4siII{len(frame)}s{padding}x").pack, frame
