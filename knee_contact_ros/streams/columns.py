"""Many messages and samples at once, as arrays: the same numbers and bytes as one by one.

Recorded answers are read by the message definition in the recording. So a recording stays readable when the message
gets more fields: numbers that it lacks become NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import MessageDefinition, Nodetype

from ..model.types import (
    FIELDS,
    FLAT,
    MESSAGE_BYTES,
    MESSAGE_FIELDS,
    ROW,
    WRENCH_BYTES,
    Bytes,
    Rows,
    Stamps,
    unknown_answers,
)
from .messages import (
    BYTE_ORDERS,
    HEADER,
    LARGEST_MESSAGE,
    MOST_TRAILING,
    STAMP_END,
    Coder,
    Order,
    Shape,
    header,
    shape_of,
    written_layout,
)
from .topics import KNEE_CONTACT, MESSAGE_TYPES, NANOSECONDS, types_in

Places = NDArray[np.int64]
"""Offsets [B] in a piece of memory, shape (n,)"""
MOST_ELSE = 4
"""Largest memory that is kept or copied for messages, as a multiple of their size"""


@dataclass(frozen=True)
class Column:
    """Sequence of messages in one piece of memory."""

    data: bytes
    """The memory"""
    begins: Places
    """Offsets at which the messages begin"""
    ends: Places
    """Offsets of the messages' ends"""

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> Column:
        """Column of messages that are separate objects."""
        lengths = np.fromiter(map(len, messages), np.int64, len(messages))
        ends = np.cumsum(lengths)
        return cls(b"".join(messages), ends - lengths, ends)

    @classmethod
    def together(cls, columns: Sequence[Column]) -> Column:
        """Concatenation of columns."""
        before = np.cumsum([0, *(len(column.data) for column in columns)]).tolist()
        return cls(
            b"".join([column.data for column in columns]),
            np.concatenate(
                [column.begins + size for column, size in zip(columns, before, strict=False)]
            ),
            np.concatenate(
                [column.ends + size for column, size in zip(columns, before, strict=False)]
            ),
        )

    def __len__(self) -> int:
        """Number of messages."""
        return len(self.begins)

    def __getitem__(self, index: int) -> bytes:
        """Message at an index."""
        return self.data[self.begins[index] : self.ends[index]]

    def __iter__(self) -> Iterator[bytes]:
        """Iterate over the messages."""
        return map(self.data.__getitem__, map(slice, self.begins.tolist(), self.ends.tolist()))

    def part(self, chosen: Any) -> Column:
        """Selection of messages, by a slice, their indices or a mask; it shares the memory."""
        return Column(self.data, self.begins[chosen], self.ends[chosen])

    def trimmed(self) -> Column:
        """Same messages in memory with little else."""
        if not len(self):
            return Column(b"", self.begins, self.ends)
        first, last = int(self.begins.min()), int(self.ends.max())
        if last - first > MOST_ELSE * int((self.ends - self.begins).sum()):
            return Column.of(list(self))
        if last - first == len(self.data):
            return self
        return Column(self.data[first:last], self.begins - first, self.ends - first)

    def rows(self, length: int) -> NDArray[np.uint8]:
        """First `length` bytes of each message, shape (n, length); no message may be shorter."""
        kind = np.dtype(f"V{length}")
        windows = np.ndarray(max(len(self.data) - length + 1, 0), kind, self.data, strides=(1,))
        return windows[self.begins].view(np.uint8).reshape(len(self), length)


class Block(NamedTuple):
    """Many messages of one shape."""

    shape: Shape
    stamps: Stamps
    """Stamps [ns], shape (n,)"""
    numbers: NDArray[Any]
    """Stamps and numbers with the fields of `Layout.numbers`, shape (n,)"""
    data: Bytes
    """Bytes of the messages as they are written, shape (n, length)"""


def decode_all(coder: Coder[Any], messages: Column) -> Block | None:
    """Contents of many messages, at least one; None if their shapes differ, or `decode` cannot read one of them."""
    first = coder.decode_message(messages[0])
    if first is None:
        return None
    shape = shape_of(first[0])
    layout = written_layout(coder.kind, shape)
    lengths = messages.ends - messages.begins
    most = min(layout.length + MOST_TRAILING, LARGEST_MESSAGE)
    if not layout.length <= lengths.min() <= lengths.max() <= most:
        return None
    matrix = messages.rows(layout.length)
    if (matrix[:, :2] != list(HEADER[:2])).any():
        return None
    kind = layout.numbers
    if (matrix.reshape(-1).view(kind)["nanoseconds"] >= NANOSECONDS).any():
        return None
    rest = matrix[:, ~_covered(kind)]
    for index in np.flatnonzero(
        (rest != rest[0]).any(axis=1)
    ).tolist():  # as a rule old memory in the padding
        other = coder.decode_message(messages[index])
        if other is None or shape_of(other[0]) != shape:
            return None
    rows, data = repeated_template(first[1], kind, len(messages))
    parts = matrix.reshape(-1).view(kind)
    for name in kind.names or ():
        rows[name] = parts[name]
    stamps = parts["seconds"].astype(np.int64) * NANOSECONDS + parts["nanoseconds"]
    rows["seconds"], rows["nanoseconds"] = np.divmod(stamps, NANOSECONDS)
    return Block(shape, stamps, rows, data)


def repeated_template(
    template: bytes, kind: np.dtype[Any], number: int
) -> tuple[NDArray[Any], Bytes]:
    """Copies of a message as rows of a NumPy type, shape (number,), and as bytes, shape (number, length).

    Both share their memory.
    """
    data = np.tile(np.frombuffer(template, dtype=np.uint8), (number, 1))
    return data.reshape(-1).view(kind), data


def _covered(kind: np.dtype[Any]) -> NDArray[np.bool_]:
    """Mask of the bytes of a message that belong to the fields of a NumPy type."""
    mask = np.zeros(kind.itemsize, dtype=bool)
    for field, offset in (entry[:2] for entry in (kind.fields or {}).values()):
        mask[offset : offset + field.itemsize] = True
    return mask


def encode_answers(frame_id: str, stamps: Stamps, rows: Rows) -> Bytes:
    """Bytes of the `KneeContact` messages of many answers, shape (n, length), as `encode_answer` writes them."""
    return _headed(frame_id, stamps, rows, MESSAGE_BYTES)


def encode_answer_wrenches(frame_id: str, stamps: Stamps, rows: Rows) -> Bytes:
    """Bytes of the `WrenchStamped` messages of many answers, shape (n, length); see `encode_answer_wrench`."""
    return _headed(frame_id, stamps, rows, WRENCH_BYTES)


def _headed(frame_id: str, stamps: Stamps, rows: Rows, part: slice) -> Bytes:
    before = header(0, frame_id)
    length = len(before) + part.stop - part.start
    times = np.dtype(
        {"names": ["s", "ns"], "formats": ["<i4", "<u4"], "offsets": [4, 8], "itemsize": length}
    )
    messages, data = repeated_template(before + bytes(length - len(before)), times, len(stamps))
    messages["s"], messages["ns"] = np.divmod(stamps, NANOSECONDS)
    data[:, len(before) :] = rows.view(np.uint8).reshape(len(rows), ROW.itemsize)[:, part]
    return data


TYPE = MESSAGE_TYPES[KNEE_CONTACT]
ADDED = frozenset(name for name, field in FIELDS.items() if field.added)
"""Names of the numbers that were added to the message later"""
FIXED = (
    "float64",
    "float32",
    "int64",
    "uint64",
    "int32",
    "uint32",
    "int16",
    "uint16",
    "int8",
    "uint8",
)
"""Types of numbers that are read, named as in NumPy"""
BYTES = ("bool", "byte", "char")
"""Further types of one byte, which are read as `uint8`"""
FRAME_END = STAMP_END + 4
"""Offset [B] of the text of the frame, behind its length"""
NO_MESSAGE = "a message is not CDR, or it is cut off"


Place = tuple[str, str]
"""A number among the fields of a message: its name (`contact_point_x` for x of `contact_point`) and type, of `FIXED`"""


def decode_answers(messages: Column, message_definition: MessageDefinition) -> Rows:
    """Read rows from `KneeContact` messages, shape (n,), with their stamps; numbers that are missing become NaN.

    `message_definition` is the one in the recording; `NO_DEFINITION` stands for this package's.

    Raises:
        ValueError: the definition lacks a number, or a message does not fit it.
    """
    places, whole = places_of(message_definition)
    answers = unknown_answers(len(messages))
    numbers = answers.view(FLAT)
    if len(messages) and (messages.ends - messages.begins).min() < FRAME_END:
        raise ValueError(NO_MESSAGE)
    heads = messages.rows(FRAME_END)[:, [0, 1, *range(STAMP_END, FRAME_END)]]
    _, examples, kinds = np.unique(heads, axis=0, return_index=True, return_inverse=True)
    for number, example in enumerate(examples.tolist()):
        alike = np.flatnonzero(kinds.ravel() == number)
        layout, block = layout_of(places, *_kind(messages[example])), messages.part(alike)
        surplus = block.ends - block.begins - layout.itemsize
        if surplus.min() < 0 or (whole and surplus.max() > MOST_TRAILING):
            raise ValueError("a message is longer or shorter than its definition says")
        rows = block.rows(layout.itemsize).view(layout)[:, 0]
        with np.errstate(invalid="ignore"):  # a foreign definition may have other types
            for name in set(MESSAGE_FIELDS) & set(layout.names or ()):
                numbers[name][alike] = rows[name]
        numbers["stamp"][alike] = (
            rows["seconds"].astype(np.int64) * NANOSECONDS + rows["nanoseconds"]
        )
    return answers


@lru_cache(maxsize=16)
def places_of(message_definition: MessageDefinition) -> tuple[tuple[Place, ...], bool]:
    """Numbers after the header, in order, up to a field of variable size; and whether there is no such field.

    Raises:
        ValueError: the definition lacks a number that the message has always had.
    """
    types, places, whole = types_in(message_definition, TYPE), list[Place](), True
    fields = types[TYPE][1]
    if not fields or fields[0][1] != (Nodetype.NAME, "std_msgs/msg/Header"):
        raise ValueError(f"{TYPE} does not begin with a header")
    for place in _flat(types, fields[1:], ""):
        if place is None:
            whole = False
            break
        places.append(place)
    missing = set(MESSAGE_FIELDS) - ADDED - {name for name, _ in places}
    if missing:
        raise ValueError(f"{TYPE} has no {', '.join(sorted(missing))}")
    return tuple(places), whole


@lru_cache(maxsize=64)
def layout_of(places: tuple[Place, ...], order: Order, frame_length: int) -> np.dtype[Any]:
    """NumPy type of messages with a byte order (`<` or `>`) and a length of the frame [B].

    Its fields are the stamp (`seconds`, `nanoseconds`) and the numbers; trailing bytes are not part of it.
    """
    fields = {"seconds": (np.dtype(f"{order}i4"), 4), "nanoseconds": (np.dtype(f"{order}u4"), 8)}
    at = FRAME_END + frame_length
    for name, kind in places:
        number = np.dtype(kind).newbyteorder(order)
        at += (4 - at) % number.itemsize  # alignment counts from behind the encapsulation
        fields[name] = (number, at)
        at += number.itemsize
    formats, offsets = zip(*fields.values(), strict=True)
    return np.dtype(
        {"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": at}
    )


def _flat(types: Any, fields: Any, before: str) -> Iterator[Place | None]:
    """Numbers in fields, whose names begin with `before`; None stands for a field of variable size."""
    for name, (kind, detail) in fields:
        if kind is Nodetype.NAME and detail in types:
            yield from _flat(types, types[detail][1], f"{before}{name}_")
        elif kind is Nodetype.BASE and detail[0] in (*FIXED, *BYTES):
            yield before + name, detail[0] if detail[0] in FIXED else "uint8"
        else:
            yield None


def _kind(message: bytes) -> tuple[Order, int]:
    """Byte order and length of the frame [B] of a message."""
    order = BYTE_ORDERS.get(message[:2])
    frame_length = int.from_bytes(message[12:FRAME_END], "little" if order == "<" else "big")
    if order is None or len(message) < FRAME_END + frame_length:
        raise ValueError(NO_MESSAGE)
    return order, frame_length
