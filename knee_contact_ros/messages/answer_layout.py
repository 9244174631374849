"""Reads recorded answers by the message definition that the recording holds.

So a recording stays readable when the message gets more fields: numbers that it does not have become NaN.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from knee_contact_ros.messages.cdr import BYTE_ORDERS, MOST_TRAILING, STAMP_END, Order
from knee_contact_ros.messages.ros_types import definition
from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.messages.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.model.types import FLAT, TOLD, Rows, untold

TYPE = MESSAGE_TYPES[KNEE_CONTACT]
ADDED = frozenset({"sliding_velocity", "force_error_estimate"})
"""Names of the numbers that were added to the message later"""
FIXED = ("float64", "float32", "int64", "uint64", "int32", "uint32", "int16", "uint16", "int8", "uint8")
"""Types of numbers that are read, named as in NumPy"""
BYTES = ("bool", "byte", "char")
"""Further types of one byte, which are read as `uint8`"""
FRAME_END = STAMP_END + 4
"""Offset [B] of the text of the frame, behind its length"""


PRESENT = MessageDefinition(MessageDefinitionFormat.NONE, "")
"""Placeholder for the definition that this package writes"""


class Place(NamedTuple):
    """A number among the fields of a message."""

    name: str
    """Name of the number: `contact_point_x` for x of the field `contact_point`"""
    kind: str
    """Type of the number, one of `FIXED`"""


def decode_answers(messages: Sequence[bytes], message_definition: MessageDefinition) -> Rows:
    """Read rows from `KneeContact` messages, shape (n,), with their stamps; numbers that are missing become NaN.

    `message_definition` is the message definition that the recording holds; `PRESENT` stands for that of this package.

    Raises:
        ValueError: the definition lacks a number, or a message does not fit it.
    """
    places, whole = places_of(message_definition)
    answers = untold(len(messages))
    numbers = answers.view(FLAT)
    for begin, end in _alike(messages):
        block = messages[begin:end]
        layout = layout_of(places, *_kind(block[0]))
        length, lengths = layout.itemsize, set(map(len, block))
        if min(lengths) < length or (whole and max(lengths) > length + MOST_TRAILING):
            raise ValueError("a message is longer or shorter than its definition says")
        rows = np.frombuffer(b"".join(message[:length] for message in block), dtype=layout)
        with np.errstate(invalid="ignore"):  # a foreign definition may have other types
            for name in set(TOLD) & set(layout.names or ()):
                numbers[name][begin:end] = rows[name]
        numbers["stamp"][begin:end] = rows["seconds"].astype(np.int64) * NANOSECONDS + rows["nanoseconds"]
    return answers


@lru_cache(maxsize=16)
def places_of(message_definition: MessageDefinition) -> tuple[tuple[Place, ...], bool]:
    """Numbers behind the header, in order, up to a field of variable size; and whether there is no such field.

    Raises:
        ValueError: the definition lacks a number that the message has always had.
    """
    if message_definition.format is MessageDefinitionFormat.IDL:
        types = get_types_from_idl(message_definition.data)
    else:
        types = get_types_from_msg(message_definition.data or definition(TYPE).decode(), TYPE)
    places, whole = [], True
    fields = types[TYPE][1]
    if not fields or fields[0][1] != (Nodetype.NAME, "std_msgs/msg/Header"):
        raise ValueError(f"{TYPE} does not begin with a header")
    for place in _flat(types, fields[1:], ""):
        if place is None:
            whole = False
            break
        places.append(place)
    missing = set(TOLD) - ADDED - {place.name for place in places}
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
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": at})


def _flat(types: Any, fields: Any, before: str) -> Iterator[Place | None]:
    """Numbers in fields, whose names begin with `before`; None stands for a field of variable size."""
    for name, (kind, detail) in fields:
        if kind is Nodetype.NAME and detail in types:
            yield from _flat(types, types[detail][1], f"{before}{name}_")
        elif kind is Nodetype.BASE and detail[0] in (*FIXED, *BYTES):
            yield Place(before + name, detail[0] if detail[0] in FIXED else "uint8")
        else:
            yield None


def _kind(message: bytes) -> tuple[Order, int]:
    """Byte order and length of the frame [B] of a message."""
    order = BYTE_ORDERS.get(message[:2])
    frame_length = int.from_bytes(message[12:FRAME_END], "little" if order == "<" else "big")
    if order is None or len(message) < FRAME_END + frame_length:
        raise ValueError("a message is no CDR, or cut off")
    return order, frame_length


def _alike(messages: Sequence[bytes]) -> Iterator[tuple[int, int]]:
    """Begin and end of the runs of messages that share byte order and length of the frame."""
    begin = 0
    for _, stretch in groupby(message[:2] + message[12:FRAME_END] for message in messages):
        end = begin + sum(1 for _ in stretch)
        yield begin, end
        begin = end
