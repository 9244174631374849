"""Conversion of single messages from bytes to contents and back; unusable messages are refused.

Messages with the same texts and lengths differ only in their stamps and numbers. So a `Layout`, made from the
declaration (`LAYOUTS`), texts and lengths, knows all offsets: as a `struct` for one message, as a NumPy type for many
(`columns.py`). Messages are written as little-endian CDR (XCDR1) with zeros as padding, as `rosbags` does; whatever ROS
sends is read. An answer is written as a header and the part of its row that the message consists of.
"""

import math
import struct
from collections.abc import Callable, Collection, Sequence
from functools import cache, lru_cache
from operator import itemgetter
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from ..model.types import MESSAGE_BYTES, WRENCH_BYTES
from ..parameters.sources import DYNAMIC_JOINT_STATE_TYPE, DYNAMIC_JOINT_STATES
from ..system.errors import list_names, printable
from .topics import NANOSECONDS, stamp_to_ns, typestore

Order = Literal["<", ">"]
HEADER = b"\x00\x01\x00\x00"
"""Encapsulation of little-endian CDR without options; alignment counts from its end"""
LITTLE_ENDIAN = HEADER[:2]
BYTE_ORDERS: dict[bytes, Order] = {b"\x00\x01": "<", b"\x00\x00": ">"}
"""Byte order by the first two bytes of the encapsulation. The other two are options, which ROS ignores on reading."""
STAMPS = {kind: struct.Struct(f"{order}4xiI").unpack_from for kind, order in BYTE_ORDERS.items()}
"""Readers of the seconds and nanoseconds of a message's header, by the first two bytes of the encapsulation"""
STAMP_END = 12
"""Offset [B] after encapsulation and stamp, with which all messages begin"""
MOST_TRAILING = 12
"""Largest surplus [B] of ROS's `serialize_message`, which makes room to align numbers even where none follow"""
LARGEST_MESSAGE = 2**18
"""Largest message [B] that is read, in about 2 ms; 1000 joints with names of 40 letters and all numbers have 70 kB"""
LARGEST_REMEMBERED = 65536
"""Largest message [B] whose layout is remembered, so that these stay small"""
MOST_LAYOUTS = 16
"""Largest number of layouts remembered at a time"""
UNKNOWN = (struct.error, ValueError, KeyError)
"""Errors of reading bytes that are not such a message"""


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


ONE_TEXT, TEXTS, NUMBERS, VECTOR = (
    "a text",
    "a sequence of texts",
    "a sequence of numbers",
    "three numbers",
)
LAYOUTS: dict[type, dict[str, str]] = {
    JointState: {
        "frame_id": ONE_TEXT,
        "name": TEXTS,
        "position": NUMBERS,
        "velocity": NUMBERS,
        "effort": NUMBERS,
    },
    WrenchStamped: {"frame_id": ONE_TEXT, "force": VECTOR, "torque": VECTOR},
}
"""Fields after the stamp by name, and their kinds, for each type of message"""
Content = TypeVar("Content", JointState, WrenchStamped)
Shape = tuple[Any, ...]
"""Shape of a message: for each field its text or texts, or the number of its numbers"""


class Layout:
    """Layout of messages of one shape, found in one of them.

    The parts of a message are the first half of the encapsulation, seconds, nanoseconds, and then constants, which all
    messages of the shape have (`known`), and numbers; between them is padding.
    """

    def __init__(self, kind: type, data: bytes) -> None:
        """Find the layout of a message; raises one of `UNKNOWN`."""
        self._data, self._order = data, BYTE_ORDERS[data[:2]]
        self._form, self._end, self._parts = [f"{self._order}2s2xiI"], STAMP_END, 3
        self.known: dict[int, bytes] = {}
        """Bytes of the constant parts, by the number of the part"""
        self.texts: list[Any] = []
        """Values of the fields that are text or texts, which come before the fields of numbers"""
        self._slots: list[slice] = []  # the parts of each field of numbers
        self._types = {"seconds": ("i4", 4), "nanoseconds": ("u4", 8)}
        for name, form in LAYOUTS[kind].items():
            if form == ONE_TEXT:
                self.texts.append(self._text())
            elif form == TEXTS:
                self.texts.append(tuple([self._text() for _ in range(self._count())]))
            else:
                self._slots.append(self._numbers(name, self._count() if form == NUMBERS else 3))
        self.length = self._end
        """Length [B] of a message without trailing bytes"""
        trailing = len(data) - self._end
        if not 0 <= trailing <= MOST_TRAILING:
            raise ValueError("it is truncated, or more bytes follow it")
        self.numbers_in: Callable[[tuple[Any, ...]], tuple[tuple[float, ...], ...]] = itemgetter(
            *self._slots
        )
        """Takes the numbers of each field out of the parts of a message"""
        self.pick = itemgetter(0, *self.known)
        """Takes those parts of a message that all messages of this shape have in common"""
        self.fixed = (data[:2], *self.known.values())
        """Those parts"""
        packing = struct.Struct("".join(self._form) + f"{trailing}x")
        self.unpack: Callable[[bytes], tuple[Any, ...]] = packing.unpack
        """Splits the bytes of a message into its parts; padding, which may contain old memory, is skipped"""
        self.pack = packing.pack
        """Joins parts to the bytes of a message; padding becomes zeros"""
        self.written = self
        """Layout in which such messages are written"""
        self.is_written = False
        """Whether `written` takes the parts of a message unchanged: not with the other byte order, nor with a text that
        is not UTF-8"""

    @property
    def numbers(self) -> np.dtype[Any]:
        """NumPy type of a written message: `seconds`, `nanoseconds`, and its numbers by the names of the fields."""
        formats, offsets = zip(*self._types.values(), strict=True)
        names = list(self._types)
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.length}
        )

    def parts(self, content: JointState | WrenchStamped) -> list[Any]:
        """Parts, for `pack`, of a content of this shape."""
        parts: list[Any] = [
            HEADER[:2],
            *divmod(content.stamp, NANOSECONDS),
            *[None] * (self._parts - 3),
        ]
        for number, known in self.known.items():
            parts[number] = known
        numbers: Sequence[Any] = content[1 + len(self.texts) :]
        for slot, value in zip(self._slots, numbers, strict=True):
            parts[slot] = value
        return parts

    def _text(self) -> str:
        content = self._constant(4 + self._length())[4:]
        if content.index(0) != len(content) - 1:
            raise ValueError("no text, or not all of it")
        return content[:-1].decode(errors="replace")  # as rclpy does

    def _count(self) -> int:
        count = self._length()
        self._constant(4)
        return count

    def _length(self) -> int:
        self._align(4)
        return int(struct.unpack_from(f"{self._order}I", self._data, self._end)[0])

    def _constant(self, length: int) -> bytes:
        content = self._data[self._end : self._end + length]
        self._form.append(f"{length}s")
        self.known[self._parts] = content
        self._parts += 1
        self._end += length
        return content

    def _numbers(self, name: str, count: int) -> slice:
        begin = self._parts
        if count:  # without any there is no padding either
            self._align(8)
            self._types[name] = (f"({count},)f8", self._end)
            self._form.append(f"{count}d")
            self._end += 8 * count
            self._parts += count
        return slice(begin, self._parts)

    def _align(self, size: int) -> None:
        padding = (len(HEADER) - self._end) % size
        self._form.append(f"{padding}x")
        self._end += padding


class Coder(Generic[Content]):
    """Reader and writer for one type of message; remembers the last layouts, by the length of the bytes."""

    def __init__(self, kind: type[Content]) -> None:
        self.kind: Any = kind
        self._layouts: dict[int, Layout] = {}

    def decode_message(self, data: bytes | bytearray | memoryview) -> tuple[Content, bytes] | None:
        """Content of a message, and the bytes to record; None if the bytes are not such a message, or too many."""
        if len(data) > LARGEST_MESSAGE:
            return None
        try:
            received = data if type(data) is bytes else bytes(data)
            layout = self._layouts.get(len(received))
            parts = layout.unpack(received) if layout else ()
            if layout is None or layout.pick(parts) != layout.fixed:
                layout = self._read(received)
                parts = layout.unpack(received)
            if parts[2] >= NANOSECONDS:  # no such time exists, and nobody knows which one is meant
                return None
            content: Content = self.kind(
                parts[1] * NANOSECONDS + parts[2], *layout.texts, *layout.numbers_in(parts)
            )
            if layout.is_written:
                return content, layout.written.pack(*parts)
            return content, layout.written.pack(*layout.written.parts(content))
        except UNKNOWN:
            return None

    def read_message(self, data: bytes, topic: str) -> tuple[Content, bytes]:
        """Content of a message of a topic, and the bytes to record.

        Raises:
            RefusedSampleError: the bytes are not such a message, or too many.
        """
        decoded = self.decode_message(data)
        if decoded is None:
            check_size(data, topic)
            if data.startswith(REFUSED_PREFIX):
                raise RefusedSampleError(*data[len(REFUSED_PREFIX) :].decode().split("\n", 1))
            if len(data) >= STAMP_END and data[:2] in STAMPS:
                check_nanoseconds(STAMPS[data[:2]](data)[1], topic)
            raise RefusedSampleError(
                "undecodable", f"{topic}: {len(data)} bytes are not a message of its type"
            )
        return decoded

    def encode_message(self, content: Content) -> bytes:
        """Bytes of a message with this content.

        Raises:
            ValueError: the stamp is beyond what ROS can hold.
        """
        check_stamp(content.stamp)
        layout = written_layout(self.kind, shape_of(content))
        return layout.pack(*layout.parts(content))

    def _read(self, data: bytes) -> Layout:
        """Find the layout of a message, and remember it; raises one of `UNKNOWN`."""
        layout = Layout(self.kind, data)
        content = self.kind(0, *layout.texts, *layout.numbers_in(layout.unpack(data)))
        is_long = len(data) > LARGEST_REMEMBERED
        layout.written = (
            Layout(self.kind, _plain(content))
            if is_long
            else written_layout(self.kind, shape_of(content))
        )
        layout.is_written = data[:2] == LITTLE_ENDIAN and layout.known == layout.written.known
        if not is_long:
            if len(self._layouts) >= MOST_LAYOUTS:
                self._layouts.clear()
            self._layouts[len(data)] = layout
        return layout


def shape_of(content: JointState | WrenchStamped) -> Shape:
    """Shape of a message with this content."""
    forms = LAYOUTS[type(content)].values()
    pairs = zip(forms, content[1:], strict=True)
    return tuple([value if form in (ONE_TEXT, TEXTS) else len(value) for form, value in pairs])


@lru_cache(maxsize=MOST_LAYOUTS)
def written_layout(kind: Any, shape: Shape) -> Layout:
    """Layout in which messages of a shape are written."""
    forms = LAYOUTS[kind].values()
    values = [
        given if form in (ONE_TEXT, TEXTS) else (0.0,) * given
        for form, given in zip(forms, shape, strict=True)
    ]
    return Layout(kind, _plain(kind(0, *values)))


def _plain(content: JointState | WrenchStamped) -> bytes:
    """Bytes of a message with this content and the stamp 0, written field by field."""
    data = bytearray(HEADER + bytes(STAMP_END - len(HEADER)))

    def put(part: bytes, size: int) -> None:
        data.extend(bytes((len(HEADER) - len(data)) % size) + part)

    values: Sequence[Any] = content[1:]
    for form, value in zip(LAYOUTS[type(content)].values(), values, strict=True):
        if form in (TEXTS, NUMBERS):
            put(struct.pack("<I", len(value)), 4)
        for text in [value] if form == ONE_TEXT else value if form == TEXTS else []:
            encoded = text.encode() + b"\x00"
            put(struct.pack("<I", len(encoded)) + encoded, 4)
        if form in (NUMBERS, VECTOR) and value:
            put(struct.pack(f"<{len(value)}d", *value), 8)
    return bytes(data)


def check_stamp(stamp: int) -> None:
    """Check that a message can hold a stamp [ns].

    Raises:
        ValueError: its seconds are not within int32.
    """
    if not -(2**31) <= stamp // NANOSECONDS < 2**31:
        raise ValueError(f"stamp {stamp} ns is beyond the int32 seconds of a ROS time")


def stamp_in(data: bytes) -> int:
    """Stamp [ns] of a message that begins with a header.

    Raises:
        ValueError: the bytes are too short, or not plain CDR.
    """
    stamp = STAMPS.get(data[:2])
    if stamp is None or len(data) < STAMP_END:
        raise ValueError("no stamp in these bytes")
    seconds, nanoseconds = stamp(data)
    return int(seconds * NANOSECONDS + nanoseconds)


JOINT_STATE, WRENCH = Coder(JointState), Coder(WrenchStamped)
encode_joint_state = JOINT_STATE.encode_message
encode_wrench_stamped = WRENCH.encode_message


def decode_joint_state(data: bytes | bytearray | memoryview) -> JointState | None:
    """Content of a JointState; None if the bytes are not one."""
    decoded = JOINT_STATE.decode_message(data)
    return decoded and decoded[0]


LAST_STAMP = 2**31 * NANOSECONDS - 1
"""Latest stamp [ns] that a ROS message can hold"""


class RefusedSampleError(Exception):
    """An unusable sample; `reason` is the name of its counter, the text says what is wrong."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(printable(text))
        self.reason = reason


REFUSED_PREFIX = b"refused "
"""Beginning of bytes that replace a message which could not be converted; no message begins like this"""


def refusal(refused: RefusedSampleError) -> bytes:
    """Bytes instead of a message that is refused before it is read; `Coder.read_message` raises the error."""
    return REFUSED_PREFIX + f"{refused.reason}\n{refused}".encode()


def check_size(data: bytes, topic: str) -> None:
    """Check that a message of a topic is not so large that reading it would delay the others.

    Raises:
        RefusedSampleError: it is.
    """
    if len(data) > LARGEST_MESSAGE:
        text = (
            f"{topic}: a message of {len(data)} bytes is not read; at most {LARGEST_MESSAGE} are"
        )
        raise RefusedSampleError("too_large", text)


def number_of(message: JointState, joint: str, quantity: str) -> float:
    """Position [rad or m] or effort [N m] of a joint in a JointState.

    Raises:
        RefusedSampleError: the joint is missing, or has no finite value.
    """
    if joint not in message.name:
        known = list_names(message.name)
        raise RefusedSampleError(
            "joint_missing", f"joint_states has no joint {joint!r}; it has {known}"
        )
    index, numbers = (
        message.name.index(joint),
        message.position if quantity == "position" else message.effort,
    )
    if not numbers:
        raise RefusedSampleError(
            "joint_missing", f"joint_states gives no {quantity} for joint {joint!r}"
        )
    if len(numbers) != len(message.name):
        counted = f"{len(message.name)} names and {len(numbers)} values of {quantity}"
        raise RefusedSampleError(
            "lengths_differ",
            f"joint_states has {counted}: it is not clear which value belongs to which joint",
        )
    if not math.isfinite(numbers[index]):
        raise RefusedSampleError(
            "not_finite", f"joint_states: {quantity} of joint {joint!r} is {numbers[index]}"
        )
    return numbers[index]


def checked_stamp(stamp: int, topic: str) -> int:
    """Return a stamp [ns] of a message of a topic, if a recording can hold it.

    Raises:
        RefusedSampleError: the stamp is out of range.
    """
    if not 0 <= stamp <= LAST_STAMP:
        raise RefusedSampleError(
            "bad_stamp", f"{topic}: stamp {stamp} ns is not within 0 and {LAST_STAMP} ns"
        )
    return stamp


def check_nanoseconds(nanoseconds: int, topic: str) -> None:
    """Check the nanoseconds of a stamp in a message of a topic.

    Raises:
        RefusedSampleError: they are a second or more.
    """
    if nanoseconds >= NANOSECONDS:
        raise RefusedSampleError(
            "bad_stamp",
            f"{topic}: stamp.nanosec is {nanoseconds}, and must be below {NANOSECONDS}",
        )


def checked_time(stamp: Any, topic: str) -> int:
    """Stamp [ns] in a message of a topic; raises as `check_nanoseconds`."""
    check_nanoseconds(stamp.nanosec, topic)
    return stamp_to_ns(stamp)


def encode_answer(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of the `KneeContact` message of an answer, with a stamp [ns] that replaces the one in the row.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    return header(stamp, frame_id) + row[MESSAGE_BYTES]


def encode_answer_wrench(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Bytes of the `WrenchStamped` of an answer, the contact force on the tibia; see `encode_answer`."""
    return header(stamp, frame_id) + row[WRENCH_BYTES]


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


POSITION = "position"
"""Name of the interface whose value is an angle [rad] or a height [m]"""
DEFINITIONS = {
    DYNAMIC_JOINT_STATE_TYPE: (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n"
    ),
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
}
"""Message definitions by type, as in control_msgs"""


@cache
def _types() -> Typestore:
    store = typestore()
    for name, definition in DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


def as_joint_state(data: bytes, wanted: Collection[str] = ()) -> bytes:
    """Bytes of a JointState with the joints of a DynamicJointState that have a position.

    Velocities and efforts are left out, as they are not used.

    Raises:
        RefusedSampleError: the bytes are not such a message, the numbers of names and values differ, or one of
            the joints `wanted` has no position.
    """
    try:
        message: Any = _types().deserialize_cdr(data, DYNAMIC_JOINT_STATE_TYPE)
    except Exception as error:  # whatever broken bytes provoke
        raise RefusedSampleError(
            "undecodable", f"{len(data)} bytes are not a {DYNAMIC_JOINT_STATE_TYPE} ({error})"
        ) from None
    positions: dict[str, float] = {}
    joints, each = message.joint_names, message.interface_values
    if len(joints) != len(each):
        text = f"{DYNAMIC_JOINT_STATES} has {len(joints)} joints and values of {len(each)}"
        raise RefusedSampleError("lengths_differ", text)
    for joint, interface in zip(joints, each, strict=True):
        names, values = interface.interface_names, interface.values
        if POSITION in names and len(names) == len(values):
            positions.setdefault(joint, float(values[names.index(POSITION)]))
        elif joint in wanted and POSITION in names:
            text = f"joint {joint!r} has {len(names)} interfaces and {len(values)} values"
            raise RefusedSampleError("lengths_differ", f"{DYNAMIC_JOINT_STATES}: {text}")
        elif joint in wanted:
            text = f"joint {joint!r} has no interface {POSITION}; it has {list_names(names) or 'none'}"
            raise RefusedSampleError("joint_missing", f"{DYNAMIC_JOINT_STATES}: {text}")
    header = message.header
    return encode_joint_state(
        JointState(
            checked_time(header.stamp, DYNAMIC_JOINT_STATES),
            header.frame_id,
            tuple(positions),
            tuple(positions.values()),
            (),
            (),
        )
    )
