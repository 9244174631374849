"""Input messages: bytes to content and back, one by one and many at once, by one declaration of their fields.

What a message's texts and lengths do not fix are its stamp and its numbers. So a `Layout`, made from the declaration
(`FIELDS`), texts and lengths, knows where everything lies: as a `struct` for one message, as a NumPy type for many.
Written are little-endian CDR (XCDR1) and zeros as padding, as `rosbags` writes; read is what ROS may send.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.column import Column

Bytes = NDArray[np.uint8]
Stamps = NDArray[np.int64]
Order = Literal["<", ">"]
SECOND = 1_000_000_000
"""[ns]"""
HEADER = b"\x00\x01\x00\x00"
"""Little-endian CDR, no options; alignment counts from behind it"""
LITTLE_ENDIAN = HEADER[:2]
BYTE_ORDERS: dict[bytes, Order] = {b"\x00\x01": "<", b"\x00\x00": ">"}
"""By the first two bytes of the header. The other two are options, which ROS ignores on reading."""
STAMPS = {kind: struct.Struct(f"{order}4xiI").unpack_from for kind, order in BYTE_ORDERS.items()}
"""Likewise: what takes seconds and nanoseconds out of a message that begins with a header"""
STAMP_END = 12
"""Behind header and stamp, which all messages begin with [B]"""
MOST_TRAILING = 12
"""Surplus [B] of ROS's `serialize_message` at most: it makes room to align numbers even where none follow"""
LONGEST = 65536
"""Messages longer than this [B] are not read here, so that what is remembered of them stays small"""
MOST_LAYOUTS = 16
"""Layouts remembered at a time"""
UNKNOWN = (struct.error, ValueError, KeyError)
"""What reading raises when the bytes are not such a message"""


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


TEXT, TEXTS, NUMBERS, VECTOR = "a text", "a sequence of texts", "a sequence of numbers", "three numbers"
FIELDS: dict[type, dict[str, str]] = {
    JointState: {"frame_id": TEXT, "name": TEXTS, "position": NUMBERS, "velocity": NUMBERS, "effort": NUMBERS},
    WrenchStamped: {"frame_id": TEXT, "force": VECTOR, "torque": VECTOR},
}
"""What follows the stamp"""
Content = TypeVar("Content", JointState, WrenchStamped)
Shape = tuple[Any, ...]
"""For each field its text or texts, or how many numbers it has"""


class Layout:
    """Where everything lies in messages of one shape.

    A message consists of the header's first half, seconds, nanoseconds, and then of what its shape fixes (`known`) and
    of numbers; between them is padding.
    """

    def __init__(self, kind: type, shape: Shape, order: Order = "<", trailing: int = 0) -> None:
        """Lay a message out; `trailing` [B] follow it."""
        self.written = self
        """The layout in which such messages are written"""
        self.known: dict[int, bytes] = {}
        """By the number of the part"""
        self._form, self._end, self._parts = [f"{order}2s2xiI"], STAMP_END, 3
        self.texts: list[Any] = []
        """Of the fields that are text or texts, which come before the others"""
        self._slots: list[slice] = []  # for each of those others the parts that are its numbers
        self._order, self._types = order, {"seconds": ("i4", 4), "nanoseconds": ("u4", 8)}
        for (name, form), given in zip(FIELDS[kind].items(), shape, strict=True):
            if form in (NUMBERS, VECTOR):
                self._slots.append(self._numbers(name, given, counted=form == NUMBERS))
            else:
                self._texts(given if form == TEXTS else [given], counted=form == TEXTS)
                self.texts.append(given)
        self.length = self._end
        """[B] of a message without what may trail it"""
        self.numbers_in: Callable[[tuple[Any, ...]], tuple[tuple[float, ...], ...]] = itemgetter(*self._slots)
        """For each field of numbers its own, of parts of a message"""
        self._pick = itemgetter(0, *self.known)
        self._fixed = (b"\x00\x01" if order == "<" else b"\x00\x00", *self.known.values())
        packing = struct.Struct("".join(self._form) + f"{trailing}x")
        self.unpack: Callable[[bytes], tuple[Any, ...]] = packing.unpack
        """Every part of the bytes; padding, where ROS leaves what was in its memory, is passed over"""
        self.pack = packing.pack
        """The other way; padding becomes zeros"""

    @property
    def numbers(self) -> np.dtype[Any]:
        """The type of a message that is written: `seconds`, `nanoseconds`, and its numbers by the names of fields."""
        formats, offsets = zip(*self._types.values(), strict=True)
        names = list(self._types)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.length})

    def fits(self, parts: tuple[Any, ...]) -> bool:
        """Whether parts of a message, `unpack`ed, have the shape."""
        return bool(self._pick(parts) == self._fixed)

    def parts(self, content: JointState | WrenchStamped) -> list[Any]:
        """What to `pack` for a content of this shape."""
        parts: list[Any] = [HEADER[:2], *divmod(content.stamp, SECOND), *[None] * (self._parts - 3)]
        for number, known in self.known.items():
            parts[number] = known
        numbers: Sequence[Any] = content[1 + len(self.texts) :]
        for slot, value in zip(self._slots, numbers, strict=True):
            parts[slot] = value
        return parts

    def _numbers(self, name: str, count: int, counted: bool) -> slice:
        if counted:
            self._constant(struct.pack(f"{self._order}I", count))
        begin = self._parts
        if count:  # without any there is no padding either
            self._align(8)
            self._types[name] = (f"({count},)f8", self._end)
            self._form.append(f"{count}d")
            self._end += 8 * count
            self._parts += count
        return slice(begin, self._parts)

    def _texts(self, texts: Sequence[str], counted: bool) -> None:
        if counted:
            self._constant(struct.pack(f"{self._order}I", len(texts)))
        for text in texts:
            encoded = text.encode()
            self._constant(struct.pack(f"{self._order}I{len(encoded)}sx", len(encoded) + 1, encoded))

    def _constant(self, content: bytes) -> None:
        self._align(4)
        self._form.append(f"{len(content)}s")
        self.known[self._parts] = content
        self._parts += 1
        self._end += len(content)

    def _align(self, size: int) -> None:
        padding = (len(HEADER) - self._end) % size
        self._form.append(f"{padding}x")
        self._end += padding


class Block(NamedTuple):
    """Many messages of one shape."""

    shape: Shape
    stamps: Stamps
    """[ns], shape (n,)"""
    numbers: NDArray[Any]
    """As `Layout.numbers`, shape (n,)"""
    data: Bytes
    """The same as bytes, as they are written, shape (n, length)"""


class Coder(Generic[Content]):
    """Bytes to content and back, for one type of message; remembers the last layouts, by the length of the bytes."""

    def __init__(self, kind: type[Content]) -> None:
        self._kind: Any = kind
        self._layouts: dict[int, Layout] = {}

    def decode(self, data: bytes | bytearray | memoryview) -> tuple[Content, bytes] | None:
        """The content of a message, and the bytes that we write of it; None: ROS's deserializer should look at it."""
        try:
            received = data if type(data) is bytes else bytes(data)
            layout = self._layouts.get(len(received))
            parts = layout.unpack(received) if layout else ()
            if layout is None or not layout.fits(parts):
                layout = self._read(received)
                parts = layout.unpack(received)
            content: Content = self._kind(parts[1] * SECOND + parts[2], *layout.texts, *layout.numbers_in(parts))
            if parts[0] == LITTLE_ENDIAN and parts[2] < SECOND:
                return content, layout.written.pack(*parts)
            return content, layout.written.pack(*layout.written.parts(content))
        except UNKNOWN:
            return None

    def encode(self, content: Content) -> bytes:
        """The bytes of a message.

        Raises:
            ValueError: the stamp is beyond what ROS can hold.
        """
        check_stamp(content.stamp)
        layout = _written_layout(self._kind, shape_of(content))
        return layout.pack(*layout.parts(content))

    def decode_all(self, messages: Column) -> Block | None:
        """Many messages, at least one; None if they have not all the same shape, or if `decode` knows one not."""
        first = self.decode(messages[0])
        if first is None:
            return None
        shape = shape_of(first[0])
        layout = _written_layout(self._kind, shape)
        lengths = messages.ends - messages.begins
        if not layout.length <= lengths.min() <= lengths.max() <= layout.length + MOST_TRAILING:
            return None
        matrix = messages.rows(layout.length)
        if (matrix[:, :2] != list(HEADER[:2])).any():
            return None
        kind = layout.numbers
        rest = matrix[:, ~_covered(kind)]
        for index in np.flatnonzero((rest != rest[0]).any(axis=1)).tolist():  # leftovers of memory, as a rule
            other = self.decode(messages[index])
            if other is None or shape_of(other[0]) != shape:
                return None
        rows, data = filled(first[1], kind, len(messages))
        parts = matrix.reshape(-1).view(kind)
        for name in kind.names or ():
            rows[name] = parts[name]
        stamps = parts["seconds"].astype(np.int64) * SECOND + parts["nanoseconds"]
        rows["seconds"], rows["nanoseconds"] = np.divmod(stamps, SECOND)
        return Block(shape, stamps, rows, data)

    def _read(self, data: bytes) -> Layout:
        """The layout of a message, remembered; raises one of `UNKNOWN`."""
        if len(data) > LONGEST:
            raise ValueError("too long")
        order = BYTE_ORDERS[data[:2]]
        shape, end = _Walk(data, order).shape(FIELDS[self._kind])
        if not 0 <= len(data) - end <= MOST_TRAILING:
            raise ValueError("truncated, or something behind the message")
        if len(self._layouts) >= MOST_LAYOUTS:
            self._layouts.clear()
        self._layouts[len(data)] = layout = Layout(self._kind, shape, order, len(data) - end)
        layout.written = _written_layout(self._kind, shape)
        return layout


class _Walk:
    """Goes through the bytes of a message once; raises one of `UNKNOWN`."""

    def __init__(self, data: bytes, order: Order) -> None:
        self._data, self._order, self._at = data, order, STAMP_END

    def shape(self, fields: dict[str, str]) -> tuple[Shape, int]:
        """The message's shape, and where it ends."""
        return tuple([self._field(form) for form in fields.values()]), self._at

    def _field(self, form: str) -> Any:
        if form == TEXT:
            return self._text()
        if form == TEXTS:
            return tuple([self._text() for _ in range(self._length())])
        count = self._length() if form == NUMBERS else 3
        if count:
            self._at += (len(HEADER) - self._at) % 8 + 8 * count
        return count

    def _length(self) -> int:
        self._at += (len(HEADER) - self._at) % 4
        (length,) = struct.unpack_from(f"{self._order}I", self._data, self._at)
        self._at += 4
        return int(length)

    def _text(self) -> str:
        length = self._length()
        text = self._data[self._at : self._at + length]
        if text.index(0) != length - 1:
            raise ValueError("no text, or not all of it")
        self._at += length
        return text[:-1].decode()


def shape_of(content: JointState | WrenchStamped) -> Shape:
    """The shape of a message with this content."""
    forms = FIELDS[type(content)].values()
    pairs = zip(forms, content[1:], strict=True)
    return tuple([value if form in (TEXT, TEXTS) else len(value) for form, value in pairs])


@lru_cache(maxsize=MOST_LAYOUTS)
def _written_layout(kind: type, shape: Shape) -> Layout:
    """The layout in which messages of a shape are written."""
    return Layout(kind, shape)


def filled(template: bytes, kind: np.dtype[Any], number: int) -> tuple[NDArray[Any], Bytes]:
    """Copies of a message as rows of a type and as bytes, shape (number, length): the same memory."""
    data = np.tile(np.frombuffer(template, dtype=np.uint8), (number, 1))
    return data.reshape(-1).view(kind), data


def _covered(kind: np.dtype[Any]) -> NDArray[np.bool_]:
    """Which bytes of a message belong to the fields of a type."""
    mask = np.zeros(kind.itemsize, dtype=bool)
    for field, offset in (entry[:2] for entry in (kind.fields or {}).values()):
        mask[offset : offset + field.itemsize] = True
    return mask


def check_stamp(stamp: int) -> None:
    """Refuse a stamp [ns] that no message can hold.

    Raises:
        ValueError: its seconds are no int32.
    """
    if not -(2**31) <= stamp // SECOND < 2**31:
        raise ValueError(f"stamp {stamp} ns is beyond the int32 seconds of a ROS time")


def stamp_in(data: bytes) -> int:
    """Stamp [ns] of a message that begins with a header.

    Raises:
        ValueError: the bytes are too short, or no plain CDR.
    """
    stamp = STAMPS.get(data[:2])
    if stamp is None or len(data) < STAMP_END:
        raise ValueError("no stamp in these bytes")
    seconds, nanoseconds = stamp(data)
    return int(seconds * SECOND + nanoseconds)


JOINT_STATE, WRENCH = Coder(JointState), Coder(WrenchStamped)
encode_joint_state = JOINT_STATE.encode
encode_wrench_stamped = WRENCH.encode


def decode_joint_state(data: bytes | bytearray | memoryview) -> JointState | None:
    """The JointState in these bytes; None if ROS's own deserializer should look at them."""
    found = JOINT_STATE.decode(data)
    return found and found[0]


def decode_wrench_stamped(data: bytes | bytearray | memoryview) -> WrenchStamped | None:
    """The WrenchStamped in these bytes; None if ROS's own deserializer should look at them."""
    found = WRENCH.decode(data)
    return found and found[0]
