"""Many messages at once: bytes of one layout to columns of numbers, and columns to bytes.

A recorder writes thousands of messages that differ in stamp and numbers only. Where that is so, what takes microseconds
per message takes nanoseconds; where it is not, these functions return None and the messages go one by one
(`cdr_in`, `cdr_out`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.ticks import ANSWER, PLACING
from knee_contact_ros.core.types import COLUMN
from knee_contact_ros.messages.answer_layout import PRESENT, layout_of, places_of
from knee_contact_ros.messages.cdr_in import (
    MOST_TRAILING,
    SECOND,
    JointState,
    WrenchStamped,
    decode_joint_state,
    decode_wrench_stamped,
)
from knee_contact_ros.messages.cdr_out import encode_joint_state, encode_numbers, encode_wrench_stamped

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
LITTLE_ENDIAN = (0, 1)
"""First bytes of the header"""
STAMP = {"seconds": ("<i4", 4), "nanoseconds": ("<u4", 8)}
"""Type and offset of the fields that all messages begin with"""
T = TypeVar("T", JointState, WrenchStamped)


class JointStates(NamedTuple):
    """Messages that share texts and lengths."""

    first: JointState
    """One of them"""
    stamps: Stamps
    """[ns], shape (n,)"""
    position: Floats
    """Shape (n, joints), as the next two; (n, 0) if there are none"""
    velocity: Floats
    effort: Floats


class Wrenches(NamedTuple):
    """Messages that share the frame."""

    first: WrenchStamped
    """One of them"""
    stamps: Stamps
    """[ns], shape (n,)"""
    numbers: Floats
    """Force [N] and torque [N m], shape (n, 6)"""


def decode_joint_states(messages: Sequence[bytes]) -> JointStates | None:
    """Columns of messages; None if they have not all the same layout, or if `decode_joint_state` knows one not."""
    found = _decode(messages, decode_joint_state, _same_joints, _joint_state_layout, encode_joint_state)
    if found is None:
        return None
    first, stamps, rows = found
    none = np.zeros((len(rows), 0))
    columns = (rows[name] if name in (rows.dtype.names or ()) else none for name in ("position", "velocity", "effort"))
    return JointStates(first, stamps, *columns)


def decode_wrenches(messages: Sequence[bytes]) -> Wrenches | None:
    """Columns of messages, likewise."""
    found = _decode(messages, decode_wrench_stamped, _same_frame, _wrench_layout, encode_wrench_stamped)
    return found and Wrenches(found[0], found[1], found[2]["numbers"])


def chosen(messages: JointStates, which: NDArray[np.bool_]) -> JointStates:
    """Some of the messages."""
    first, stamps, position, velocity, effort = messages
    return JointStates(first, stamps[which], position[which], velocity[which], effort[which])


def encode_joint_states(messages: JointStates) -> Bytes:
    """Bytes of messages, shape (n, length): row by row those of `encode_joint_state`."""
    rows, matrix = _rows(encode_joint_state(messages.first), _joint_state_layout(messages.first), messages.stamps)
    for name in set(rows.dtype.names or ()) - set(STAMP):
        rows[name] = getattr(messages, name)
    return matrix


def encode_wrenches(frame_id: str, stamps: Stamps, numbers: Floats) -> Bytes:
    """Bytes of messages with numbers as in `Wrenches`, likewise."""
    message = WrenchStamped(0, frame_id, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    rows, matrix = _rows(encode_wrench_stamped(message), _wrench_layout(message), stamps)
    rows["numbers"] = numbers
    return matrix


def encode_contacts(frame_id: str, stamps: Stamps, answers: Floats, status: NDArray[np.int64]) -> Bytes:
    """Bytes of `KneeContact` messages: row by row those of `encode_numbers`; `answers` has shape (n, `ANSWER`)."""
    layout = layout_of(*places_of(PRESENT), "<", len(frame_id.encode()) + 1)
    rows, matrix = _filled(encode_numbers(0, frame_id, [0.0] * ANSWER, 0), layout.numbers, stamps)
    for name, column in COLUMN.items():
        rows[name] = answers[:, column]
    rows["status"] |= status.astype(np.uint8)
    return matrix


def encode_contact_wrenches(frame_id: str, stamps: Stamps, answers: Floats) -> Bytes:
    """Bytes of the wrenches that go with answers: row by row those of `encode_contact_wrench`."""
    force, x, y = (answers[:, COLUMN[name]] for name in ("contact_force", "contact_point_x", "contact_point_y"))
    _, normal_x, normal_y = answers[:, PLACING].T
    numbers = np.zeros((len(answers), 6))
    numbers[:, 0], numbers[:, 1] = -force * normal_x, -force * normal_y
    numbers[:, 5] = x * numbers[:, 1] - y * numbers[:, 0]
    return encode_wrenches(frame_id, stamps, numbers)


Layout = dict[str, tuple[str, int]]
"""Type and offset of every field that differs from message to message"""


def _joint_state_layout(message: JointState) -> Layout:
    layout = dict(STAMP)
    at = len(encode_joint_state(message._replace(position=(), velocity=(), effort=()))) - 12  # behind the texts
    for name in ("position", "velocity", "effort"):
        number = len(getattr(message, name))
        at += 4
        if number:
            at += -(at - 4) % 8
            layout[name] = (f"({number},)<f8", at)
        at += 8 * number
    return layout


def _wrench_layout(message: WrenchStamped) -> Layout:
    return STAMP | {"numbers": ("(6,)<f8", len(encode_wrench_stamped(message)) - 48)}


def _same_joints(one: JointState, other: JointState) -> bool:
    return one[1:3] == other[1:3] and all(len(a) == len(b) for a, b in zip(one[3:], other[3:], strict=True))


def _same_frame(one: WrenchStamped, other: WrenchStamped) -> bool:
    return one.frame_id == other.frame_id


def _decode(
    messages: Sequence[bytes],
    decode: Callable[[bytes], T | None],
    same: Callable[[T, T], bool],
    layout_of: Callable[[T], Layout],
    encode: Callable[[T], bytes],
) -> tuple[T, Stamps, NDArray[Any]] | None:
    """First message, stamps and all rows as a structured array."""
    first = decode(messages[0])
    if first is None:
        return None
    length = len(encode(first))
    lengths = set(map(len, messages))
    if not length <= min(lengths) <= max(lengths) <= length + MOST_TRAILING:
        return None
    content = messages if lengths == {length} else [message[:length] for message in messages]
    matrix = np.frombuffer(b"".join(content), dtype=np.uint8).reshape(len(messages), length)
    if (matrix[:, :2] != LITTLE_ENDIAN).any():
        return None
    fields = _dtype(layout_of(first), length)
    rows = matrix.reshape(-1).view(fields)
    rest = matrix[:, ~_varying(fields)]
    for index in np.flatnonzero(
        (rest != rest[0]).any(axis=1)
    ).tolist():  # leftovers of memory between the fields, as a rule
        other = decode(messages[index])
        if other is None or not same(first, other):
            return None
    stamps = rows["seconds"].astype(np.int64) * SECOND + rows["nanoseconds"]
    return first, stamps, rows


def _rows(template: bytes, layout: Layout, stamps: Stamps) -> tuple[NDArray[Any], Bytes]:
    """Copies of a message under stamps, as a structured array and as bytes."""
    return _filled(template, _dtype(layout, len(template)), stamps)


def _filled(template: bytes, fields: np.dtype[Any], stamps: Stamps) -> tuple[NDArray[Any], Bytes]:
    """Rows of a type, as many as stamps, each filled with a template and its stamp."""
    matrix = np.tile(np.frombuffer(template, dtype=np.uint8), (len(stamps), 1))
    rows = matrix.reshape(-1).view(fields)
    rows["seconds"], rows["nanoseconds"] = np.divmod(stamps, SECOND)
    return rows, matrix


def _dtype(layout: Layout, length: int) -> np.dtype[Any]:
    formats, offsets = zip(*layout.values(), strict=True)
    return np.dtype({"names": list(layout), "formats": formats, "offsets": offsets, "itemsize": length})


def _varying(fields: np.dtype[Any]) -> NDArray[np.bool_]:
    """Which bytes of a message belong to its fields."""
    mask = np.zeros(fields.itemsize, dtype=bool)
    for dtype, offset in (entry[:2] for entry in (fields.fields or {}).values()):
        mask[offset : offset + dtype.itemsize] = True
    return mask
