"""Reads and writes the bytes of input messages, one by one and many at once, by one declaration of their fields.

Messages with the same texts and lengths differ in their stamps and numbers only. So a `Layout`, made from the
declaration (`FIELDS`), texts and lengths, knows all offsets: as a `struct` for one message, as a NumPy type for many.
Messages are written as little-endian CDR (XCDR1) with zeros as padding, as `rosbags` does; whatever ROS sends is read.
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
from knee_contact_ros.messages.stamps import NANOSECONDS, check_stamp

Bytes = NDArray[np.uint8]
Stamps = NDArray[np.int64]
Order = Literal["<", ">"]
HEADER = b"\x00\x01\x00\x00"
"""Encapsulation of little-endian CDR without options; alignment counts from its end"""
LITTLE_ENDIAN = HEADER[:2]
BYTE_ORDERS: dict[bytes, Order] = {b"\x00\x01": "<", b"\x00\x00": ">"}
"""Byte order by the first two bytes of the encapsulation. The other two are options, which ROS ignores on reading."""
STAMPS = {kind: struct.Struct(f"{order}4xiI").unpack_from for kind, order in BYTE_ORDERS.items()}
"""Readers of the seconds and nanoseconds of a message's header, by the first two bytes of the encapsulation"""
STAMP_END = 12
"""Offset [B] behind encapsulation and stamp, with which all messages begin"""
MOST_TRAILING = 12
"""Largest surplus [B] of ROS's `serialize_message`, which makes room to align numbers even where none follow"""
LONGEST = 65536
"""Largest message [B] that is read here, so that the remembered layouts stay small"""
MOST_LAYOUTS = 16
"""Largest number of layouts remembered at a time"""
UNKNOWN = (struct.error, ValueError, KeyError)
"""Errors that reading raises if the bytes are no such message"""


class JointState(NamedTuple):
    """Content of a sensor_msgs/msg/JointState."""

    stamp: int
    """Stamp [ns]"""
    frame_id: str
    name: tuple[str, ...]
    """Names of the joints"""
    position: tuple[float, ...]
    """Positions [rad] or [m]; empty if they are not given"""
    velocity: tuple[float, ...]
    """Velocities [rad/s] or [m/s]; empty if they are not given"""
    effort: tuple[float, ...]
    """Efforts [N m] or [N]; empty if they are not given"""


class WrenchStamped(NamedTuple):
    """Content of a geometry_msgs/msg/WrenchStamped."""

    stamp: int
    """Stamp [ns]"""
    frame_id: str
    force: tuple[float, float, float]
    """Force x, y, z [N]"""
    torque: tuple[float, float, float]
    """Torque x, y, z [N m]"""


TEXT, TEXTS, NUMBERS, VECTOR = "a text", "a sequence of texts", "a sequence of numbers", "three numbers"
FIELDS: dict[type, dict[str, str]] = {
    JointState: {"frame_id": TEXT, "name": TEXTS, "position": NUMBERS, "velocity": NUMBERS, "effort": NUMBERS},
    WrenchStamped: {"frame_id": TEXT, "force": VECTOR, "torque": VECTOR},
}
"""Fields behind the stamp by name, and their kinds, for each type of message"""
Content = TypeVar("Content", JointState, WrenchStamped)
Shape = tuple[Any, ...]
"""Shape of a message: for each field its text or texts, or the number of its numbers"""


class Layout:
    """Layout of messages of one shape.

    The parts of a message are the first half of the encapsulation, seconds, nanoseconds, and then constants, which the
    shape fixes (`known`), and numbers; between them is padding.
    """

    def __init__(self, kind: type, shape: Shape, order: Order = "<", trailing: int = 0) -> None:
        """Lay out a message of a kind and shape in a byte order, followed by `trailing` bytes."""
        self.written = self
        """Layout in which such messages are written"""
        self.known: dict[int, bytes] = {}
        """Bytes of the constant parts, by the number of the part"""
        self._form, self._end, self._parts = [f"{order}2s2xiI"], STAMP_END, 3
        self.texts: list[Any] = []
        """Values of the fields that are text or texts, which come before the fields of numbers"""
        self._slots: list[slice] = []  # the parts of each field of numbers
        self._order, self._types = order, {"seconds": ("i4", 4), "nanoseconds": ("u4", 8)}
        for (name, form), given in zip(FIELDS[kind].items(), shape, strict=True):
            if form in (NUMBERS, VECTOR):
                self._slots.append(self._numbers(name, given, counted=form == NUMBERS))
            else:
                self._texts(given if form == TEXTS else [given], counted=form == TEXTS)
                self.texts.append(given)
        self.length = self._end
        """Length [B] of a message without trailing bytes"""
        self.numbers_in: Callable[[tuple[Any, ...]], tuple[tuple[float, ...], ...]] = itemgetter(*self._slots)
        """Takes the numbers of each field out of the parts of a message"""
        self._pick = itemgetter(0, *self.known)
        self._fixed = (b"\x00\x01" if order == "<" else b"\x00\x00", *self.known.values())
        packing = struct.Struct("".join(self._form) + f"{trailing}x")
        self.unpack: Callable[[bytes], tuple[Any, ...]] = packing.unpack
        """Splits the bytes of a message into its parts; padding, in which ROS leaves old memory, is skipped"""
        self.pack = packing.pack
        """Joins parts to the bytes of a message; padding becomes zeros"""

    @property
    def numbers(self) -> np.dtype[Any]:
        """NumPy type of a written message: `seconds`, `nanoseconds`, and its numbers by the names of the fields."""
        formats, offsets = zip(*self._types.values(), strict=True)
        names = list(self._types)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.length})

    def fits(self, parts: tuple[Any, ...]) -> bool:
        """Whether the parts of a message, from `unpack`, have this shape."""
        return bool(self._pick(parts) == self._fixed)

    def parts(self, content: JointState | WrenchStamped) -> list[Any]:
        """Parts, for `pack`, of a content of this shape."""
        parts: list[Any] = [HEADER[:2], *divmod(content.stamp, NANOSECONDS), *[None] * (self._parts - 3)]
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
    """Stamps [ns], shape (n,)"""
    numbers: NDArray[Any]
    """Stamps and numbers with the fields of `Layout.numbers`, shape (n,)"""
    data: Bytes
    """Bytes of the messages as they are written, shape (n, length)"""


class Coder(Generic[Content]):
    """Reader and writer for one type of message; remembers the last layouts, by the length of the bytes."""

    def __init__(self, kind: type[Content]) -> None:
        self._kind: Any = kind
        self._layouts: dict[int, Layout] = {}

    def decode(self, data: bytes | bytearray | memoryview) -> tuple[Content, bytes] | None:
        """Content of a message, and the bytes to record; None if ROS's own deserializer has to read it."""
        try:
            received = data if type(data) is bytes else bytes(data)
            layout = self._layouts.get(len(received))
            parts = layout.unpack(received) if layout else ()
            if layout is None or not layout.fits(parts):
                layout = self._read(received)
                parts = layout.unpack(received)
            content: Content = self._kind(parts[1] * NANOSECONDS + parts[2], *layout.texts, *layout.numbers_in(parts))
            if parts[0] == LITTLE_ENDIAN and parts[2] < NANOSECONDS:
                return content, layout.written.pack(*parts)
            return content, layout.written.pack(*layout.written.parts(content))
        except UNKNOWN:
            return None

    def encode(self, content: Content) -> bytes:
        """Bytes of a message with this content.

        Raises:
            ValueError: the stamp is beyond what ROS can hold.
        """
        check_stamp(content.stamp)
        layout = _written_layout(self._kind, shape_of(content))
        return layout.pack(*layout.parts(content))

    def decode_all(self, messages: Column) -> Block | None:
        """Contents of many messages, at least one; None if their shapes differ, or `decode` cannot read one of them."""
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
        for index in np.flatnonzero((rest != rest[0]).any(axis=1)).tolist():  # as a rule old memory in the padding
            other = self.decode(messages[index])
            if other is None or shape_of(other[0]) != shape:
                return None
        rows, data = filled(first[1], kind, len(messages))
        parts = matrix.reshape(-1).view(kind)
        for name in kind.names or ():
            rows[name] = parts[name]
        stamps = parts["seconds"].astype(np.int64) * NANOSECONDS + parts["nanoseconds"]
        rows["seconds"], rows["nanoseconds"] = np.divmod(stamps, NANOSECONDS)
        return Block(shape, stamps, rows, data)

    def _read(self, data: bytes) -> Layout:
        """Find the layout of a message, and remember it; raises one of `UNKNOWN`."""
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
    """Single pass through the bytes of a message; raises one of `UNKNOWN`."""

    def __init__(self, data: bytes, order: Order) -> None:
        self._data, self._order, self._at = data, order, STAMP_END

    def shape(self, fields: dict[str, str]) -> tuple[Shape, int]:
        """Shape of the message, and the offset [B] of its end."""
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
    """Shape of a message with this content."""
    forms = FIELDS[type(content)].values()
    pairs = zip(forms, content[1:], strict=True)
    return tuple([value if form in (TEXT, TEXTS) else len(value) for form, value in pairs])


@lru_cache(maxsize=MOST_LAYOUTS)
def _written_layout(kind: type, shape: Shape) -> Layout:
    """Layout in which messages of a shape are written."""
    return Layout(kind, shape)


def filled(template: bytes, kind: np.dtype[Any], number: int) -> tuple[NDArray[Any], Bytes]:
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


def stamp_in(data: bytes) -> int:
    """Stamp [ns] of a message that begins with a header.

    Raises:
        ValueError: the bytes are too short, or no plain CDR.
    """
    stamp = STAMPS.get(data[:2])
    if stamp is None or len(data) < STAMP_END:
        raise ValueError("no stamp in these bytes")
    seconds, nanoseconds = stamp(data)
    return int(seconds * NANOSECONDS + nanoseconds)


JOINT_STATE, WRENCH = Coder(JointState), Coder(WrenchStamped)
encode_joint_state = JOINT_STATE.encode
encode_wrench_stamped = WRENCH.encode


def decode_joint_state(data: bytes | bytearray | memoryview) -> JointState | None:
    """Content of a JointState; None if ROS's own deserializer has to read the bytes."""
    decoded = JOINT_STATE.decode(data)
    return decoded and decoded[0]


def decode_wrench_stamped(data: bytes | bytearray | memoryview) -> WrenchStamped | None:
    """Content of a WrenchStamped; None if ROS's own deserializer has to read the bytes."""
    decoded = WRENCH.decode(data)
    return decoded and decoded[0]
