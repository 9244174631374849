"""Where the numbers of an answer lie among the bytes of its message, by the definition that the message came with.

A recording carries its definitions, so it stays readable when the message gets more fields: numbers that it does not
have are not a number.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from knee_contact_ros.core.types import FLAT, TOLD, Rows, untold
from knee_contact_ros.messages.cdr import BYTE_ORDERS, MOST_TRAILING, SECOND, STAMP_END, Order
from knee_contact_ros.messages.ros_types import definition
from knee_contact_ros.messages.topics import KNEE_CONTACT, MESSAGE_TYPES

TYPE = MESSAGE_TYPES[KNEE_CONTACT]
ADDED = frozenset({"sliding_velocity", "force_error_estimate"})
"""Numbers that the message got later than the others"""
FIXED = ("float64", "float32", "int64", "uint64", "int32", "uint32", "int16", "uint16", "int8", "uint8")
"""Kinds of numbers, named as by NumPy"""
BYTES = ("bool", "byte", "char")
"""More of them, which are a `uint8` here"""
FRAME_END = STAMP_END + 4
"""Where the frame's text begins: behind its length"""


PRESENT = MessageDefinition(MessageDefinitionFormat.NONE, "")
"""Stands for the definition that this package writes"""


class Place(NamedTuple):
    """Where a number lies."""

    name: str
    """`contact_point_x` for x of the field `contact_point`"""
    kind: str
    """One of `FIXED`"""


class Layout(NamedTuple):
    """Where the fields lie in messages that share byte order and length of the frame."""

    numbers: np.dtype[Any]
    """Stamp (`seconds`, `nanoseconds`) and numbers under their names"""
    length: int
    """[B] of a message without what may trail it"""
    whole: bool
    """False if fields of no fixed size follow, which are not read"""


def decode_answers(messages: Sequence[bytes], described: MessageDefinition) -> Rows:
    """Rows of `KneeContact` messages, shape (n,): with their stamps, and not a number where the message tells nothing.

    `described` is the definition that they came with; `PRESENT` is that of this package.

    Raises:
        ValueError: it lacks a number, or a message does not fit it.
    """
    places, whole = places_of(described)
    answers = untold(len(messages))
    numbers = answers.view(FLAT)
    for begin, end in _alike(messages):
        block = messages[begin:end]
        layout = layout_of(places, whole, *_kind(block[0]))
        _check_lengths(block, layout)
        rows = np.frombuffer(b"".join(message[: layout.length] for message in block), dtype=layout.numbers)
        with np.errstate(invalid="ignore"):  # a definition of a stranger's may have other types
            for name in set(TOLD) & set(layout.numbers.names or ()):
                numbers[name][begin:end] = rows[name]
        numbers["stamp"][begin:end] = rows["seconds"].astype(np.int64) * SECOND + rows["nanoseconds"]
    return answers


@lru_cache(maxsize=16)
def places_of(described: MessageDefinition) -> tuple[tuple[Place, ...], bool]:
    """The numbers behind the header in their order up to a field of no fixed size, and whether there is none.

    Raises:
        ValueError: it lacks a number that the message always had.
    """
    if described.format is MessageDefinitionFormat.IDL:
        types = get_types_from_idl(described.data)
    else:
        types = get_types_from_msg(described.data or definition(TYPE).decode(), TYPE)
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
def layout_of(places: tuple[Place, ...], whole: bool, order: Order, frame_length: int) -> Layout:
    """The layout of messages with a byte order (`<` or `>`) whose frame takes so many bytes."""
    fields = {"seconds": (np.dtype(f"{order}i4"), 4), "nanoseconds": (np.dtype(f"{order}u4"), 8)}
    at = FRAME_END + frame_length
    for name, kind in places:
        number = np.dtype(kind).newbyteorder(order)
        at += (4 - at) % number.itemsize  # alignment counts from behind the encapsulation
        fields[name] = (number, at)
        at += number.itemsize
    formats, offsets = zip(*fields.values(), strict=True)
    numbers = np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": at})
    return Layout(numbers, at, whole)


def _flat(types: Any, fields: Any, before: str) -> Iterator[Place | None]:
    """Places of fields; None stands for one of no fixed size."""
    for name, (kind, detail) in fields:
        if kind is Nodetype.NAME and detail in types:
            yield from _flat(types, types[detail][1], f"{before}{name}_")
        elif kind is Nodetype.BASE and detail[0] in (*FIXED, *BYTES):
            yield Place(before + name, detail[0] if detail[0] in FIXED else "uint8")
        else:
            yield None


def _kind(message: bytes) -> tuple[Order, int]:
    """Byte order and length of the frame."""
    order = BYTE_ORDERS.get(message[:2])
    frame_length = int.from_bytes(message[12:FRAME_END], "little" if order == "<" else "big")
    if order is None or len(message) < FRAME_END + frame_length:
        raise ValueError("a message is no CDR, or cut off")
    return order, frame_length


def _alike(messages: Sequence[bytes]) -> Iterator[tuple[int, int]]:
    """Begin and end of the stretches that share byte order and length of the frame."""
    begin = 0
    for _, stretch in groupby(message[:2] + message[12:FRAME_END] for message in messages):
        end = begin + sum(1 for _ in stretch)
        yield begin, end
        begin = end


def _check_lengths(messages: Sequence[bytes], layout: Layout) -> None:
    lengths = set(map(len, messages))
    if min(lengths) < layout.length or (layout.whole and max(lengths) > layout.length + MOST_TRAILING):
        raise ValueError("a message is longer or shorter than its definition says")
