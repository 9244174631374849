"""The bytes of our two input messages to plain tuples: CDR as DDS carries it (XCDR1, either byte order), without ROS.

What these functions do not know for certain they leave to ROS's own deserializer: they return None.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from operator import itemgetter
from typing import Any, Generic, NamedTuple, TypeVar

SECOND = 1_000_000_000
"""[ns]"""

_ENCAPSULATION = 4
"""Length of the header [B]; alignment counts from behind it"""
_BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}
"""By the first two bytes of the header. The other two are options, which ROS ignores on reading."""
MOST_TRAILING = 12
"""Surplus [B] of ROS's `serialize_message` at most: it makes room to align numbers even where none follow"""
_LONGEST = 65536
"""Messages longer than this [B] are not read here, so that what is remembered of them stays small"""
_MOST_LAYOUTS = 16
"""Layouts remembered at a time"""
_UNKNOWN = (struct.error, ValueError, KeyError)
"""What reading raises when the bytes are not such a message"""

T = TypeVar("T")


class JointState(NamedTuple):
    """The content of a sensor_msgs/msg/JointState."""

    stamp: int
    """[ns]"""
    frame_id: str
    name: tuple[str, ...]
    position: tuple[float, ...]
    """[rad] or [m]"""
    velocity: tuple[float, ...]
    """[rad/s] or [m/s]"""
    effort: tuple[float, ...]
    """[N m] or [N]"""


class WrenchStamped(NamedTuple):
    """The content of a geometry_msgs/msg/WrenchStamped."""

    stamp: int
    """[ns]"""
    frame_id: str
    force: tuple[float, float, float]
    """[N]"""
    torque: tuple[float, float, float]
    """[N m]"""


class _Layout(NamedTuple, Generic[T]):
    """All but the stamp and the numbers of a message: as a rule the next one has it in common."""

    unpack: Callable[[bytes], tuple[Any, ...]]
    """Every field of the bytes but padding, where ROS leaves what was in its memory"""
    pick: Callable[[tuple[Any, ...]], Any]
    """Those of the fields that must equal `known`"""
    known: Any
    """Representation, texts as they lie in the bytes, and lengths of sequences"""
    build: Callable[[tuple[Any, ...]], T]
    """The message of the fields"""


class _Decoder(Generic[T]):
    """Decodes one type of message; remembers the last layouts, by the length of the bytes."""

    def __init__(self, read: Callable[[bytes], _Layout[T]]) -> None:
        self._read = read
        self._layouts: dict[int, _Layout[T]] = {}

    def decode(self, data: bytes | bytearray | memoryview) -> T | None:
        """The message in the bytes, or None if they are not known for certain to be one."""
        try:
            content = data if type(data) is bytes else bytes(data)
            layout = self._layouts.get(len(content))
            if layout is not None:
                fields = layout.unpack(content)
                if layout.pick(fields) == layout.known:
                    return layout.build(fields)
            layout = self._read(content)
        except _UNKNOWN:
            return None
        if len(self._layouts) >= _MOST_LAYOUTS:
            self._layouts.clear()
        self._layouts[len(content)] = layout
        return layout.build(layout.unpack(content))


class _Walk:
    """Goes through the bytes of a message once and keeps the format of what it met; raises one of `_UNKNOWN`."""

    def __init__(self, data: bytes) -> None:
        if len(data) > _LONGEST:
            raise ValueError("too long")
        self._data = data
        self._order = _BYTE_ORDERS[data[:2]]
        self._format = [f"{self._order}2s2xiI"]
        self._at = _ENCAPSULATION + 8
        self.fields = 3

    def length(self) -> int:
        """Length of a sequence."""
        value = self._uint32()
        self._add("I", 4, 1)
        return value

    def text(self) -> str:
        """A string; the field is its length and its bytes in one."""
        length = self._uint32()
        text = self._data[self._at + 4 : self._at + 4 + length]
        if text.index(0) != length - 1:
            raise ValueError("no text, or not all of it")
        self._add(f"{4 + length}s", 4 + length, 1)
        return text[:-1].decode()

    def doubles(self, number: int) -> None:
        """Numbers, one field each; without any there is no padding either."""
        if number:
            self._align(8)
            self._add(f"{number}d", 8 * number, number)

    def numbers(self) -> int:
        """A sequence of numbers; returns the index of the field behind its length."""
        number = self.length()
        start = self.fields
        self.doubles(number)
        return start

    def unpack(self) -> Callable[[bytes], tuple[Any, ...]]:
        """Reads bytes like these into fields: representation, seconds, nanoseconds and what was met."""
        trailing = len(self._data) - self._at
        if not 0 <= trailing <= MOST_TRAILING:
            raise ValueError("truncated, or something behind the message")
        return struct.Struct("".join(self._format) + f"{trailing}x").unpack

    def _uint32(self) -> int:
        self._align(4)
        return int(struct.unpack_from(f"{self._order}I", self._data, self._at)[0])

    def _align(self, size: int) -> None:
        padding = (_ENCAPSULATION - self._at) % size
        self._add(f"{padding}x", padding, 0)

    def _add(self, form: str, size: int, fields: int) -> None:
        self._format.append(form)
        self._at += size
        self.fields += fields


def _joint_state_layout(data: bytes) -> _Layout[JointState]:
    """Layout of a JointState; raises one of `_UNKNOWN`."""
    walk = _Walk(data)
    frame_id = walk.text()
    name = tuple([walk.text() for _ in range(walk.length())])
    position, velocity, effort = walk.numbers(), walk.numbers(), walk.numbers()

    def build(fields: tuple[Any, ...]) -> JointState:
        return JointState(
            fields[1] * SECOND + fields[2],
            frame_id,
            name,
            fields[position : velocity - 1],
            fields[velocity : effort - 1],
            fields[effort:],
        )

    unpack, pick = walk.unpack(), itemgetter(0, slice(3, position), velocity - 1, effort - 1)
    return _Layout(unpack, pick, pick(unpack(data)), build)


def _wrench_layout(data: bytes) -> _Layout[WrenchStamped]:
    """Layout of a WrenchStamped; raises one of `_UNKNOWN`."""
    walk = _Walk(data)
    frame_id = walk.text()
    walk.doubles(6)

    def build(fields: tuple[Any, ...]) -> WrenchStamped:
        return WrenchStamped(fields[1] * SECOND + fields[2], frame_id, fields[4:7], fields[7:10])

    unpack, pick = walk.unpack(), itemgetter(0, 3)
    return _Layout(unpack, pick, pick(unpack(data)), build)


_joint_states = _Decoder(_joint_state_layout)
_wrenches = _Decoder(_wrench_layout)


def stamp_in(data: bytes) -> int:
    """Stamp [ns] of a message that begins with a header.

    Raises:
        ValueError: the bytes are too short, or no plain CDR.
    """
    order = _BYTE_ORDERS.get(data[:2])
    if order is None or len(data) < _ENCAPSULATION + 8:
        raise ValueError("no stamp in these bytes")
    seconds, nanoseconds = struct.unpack_from(f"{order}iI", data, _ENCAPSULATION)
    return int(seconds * SECOND + nanoseconds)


def decode_joint_state(data: bytes | bytearray | memoryview) -> JointState | None:
    """The JointState in these bytes; None if ROS's own deserializer should look at them."""
    return _joint_states.decode(data)


def decode_wrench_stamped(data: bytes | bytearray | memoryview) -> WrenchStamped | None:
    """The WrenchStamped in these bytes; None if ROS's own deserializer should look at them."""
    return _wrenches.decode(data)
