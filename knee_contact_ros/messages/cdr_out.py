"""Messages to bytes: little-endian CDR (XCDR1) with every padding byte zero, as `rosbags` writes it, without ROS."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache

from knee_contact_ros.core.types import Contact
from knee_contact_ros.messages.cdr_in import SECOND, JointState, WrenchStamped

_HEADER = b"\x00\x01\x00\x00"
"""Little-endian CDR, no options"""
_START = "<4siI"
"""Format of the header and of the stamp, 8 bytes from where alignment counts"""
_Packer = tuple[Callable[..., bytes], bytes]
"""What packs header, seconds, nanoseconds, texts and numbers; and these texts as bytes"""


def encode_joint_state(message: JointState) -> bytes:
    """Bytes of a sensor_msgs/msg/JointState.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    stamp, frame_id, name, position, velocity, effort = message
    positions, velocities, efforts = len(position), len(velocity), len(effort)
    pack, texts = _joint_state_packer(frame_id, name, positions, velocities, efforts)
    seconds, nanoseconds = _time(stamp)
    return pack(_HEADER, seconds, nanoseconds, texts, positions, *position, velocities, *velocity, efforts, *effort)


def encode_wrench_stamped(message: WrenchStamped) -> bytes:
    """Bytes of a geometry_msgs/msg/WrenchStamped.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    pack, frame = _wrench_packer(message.frame_id)
    seconds, nanoseconds = _time(message.stamp)
    return pack(_HEADER, seconds, nanoseconds, frame, *message.force, *message.torque)


def encode_contact(stamp: int, frame_id: str, contact: Contact) -> bytes:
    """Bytes of the `KneeContact` message of an answer; stamp in [ns].

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    pack, frame = _contact_packer(frame_id)
    seconds, nanoseconds = _time(stamp)
    # The message has the fields of the answer in their order.
    return pack(_HEADER, seconds, nanoseconds, frame, *contact[:7], *contact.contact_point, *contact[8:])


def encode_numbers(stamp: int, frame_id: str, numbers: Sequence[float], status: int) -> bytes:
    """Bytes of the `KneeContact` message from the numbers of `Stream.answer`; `status` gives more bits of the status.

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    pack, frame = _contact_packer(frame_id)
    seconds, nanoseconds = _time(stamp)
    (angle, load, force, depth, gap, rate, sliding, x, y, height, cartilage, bone, state, level, missed, error,
     force_error, evaluations, *_) = numbers  # fmt: skip
    return pack(
        _HEADER, seconds, nanoseconds, frame, angle, load, force, depth, gap, rate, sliding, x, y, 0.0, height,
        cartilage, bone, int(state), int(level), int(missed) | status, error, force_error, int(evaluations),
    )  # fmt: skip


def encode_contact_wrench(stamp: int, frame_id: str, contact: Contact, normal: tuple[float, float]) -> bytes:
    """Bytes of the wrench that goes with an answer: the contact force on the tibia; stamp in [ns].

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    force_x = -contact.contact_force * normal[0]
    force_y = -contact.contact_force * normal[1]
    torque_z = contact.contact_point.x * force_y - contact.contact_point.y * force_x
    return encode_wrench_stamped(WrenchStamped(stamp, frame_id, (force_x, force_y, 0.0), (0.0, 0.0, torque_z)))


def _time(stamp: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a stamp [ns]; raises ValueError if the seconds are no int32."""
    seconds, nanoseconds = divmod(stamp, SECOND)
    if not -(2**31) <= seconds < 2**31:
        raise ValueError(f"stamp {stamp} ns is beyond the int32 seconds of a ROS time")
    return seconds, nanoseconds


@lru_cache(maxsize=16)
def _joint_state_packer(frame_id: str, name: tuple[str, ...], *lengths: int) -> _Packer:
    """For messages with these texts and these lengths of position, velocity and effort."""
    texts = _text(frame_id) + struct.pack("<I", len(name)) + b"".join([_text(text) for text in name])
    form = _START + f"{len(texts)}s"
    end = 8 + len(texts)
    for length in lengths:
        padding = -(end + 4) % 8 if length else 0
        form += f"I{padding}x{length}d"
        end += 4 + padding + 8 * length
    return struct.Struct(form).pack, texts


@lru_cache(maxsize=16)
def _wrench_packer(frame_id: str) -> _Packer:
    frame = _text(frame_id)
    return struct.Struct(f"{_START}{len(frame)}s{-len(frame) % 8}x6d").pack, frame


@lru_cache(maxsize=16)
def _contact_packer(frame_id: str) -> _Packer:
    frame = _text(frame_id)
    return struct.Struct(f"{_START}{len(frame)}s{-len(frame) % 8}x13d3B5x2dI").pack, frame


def _text(text: str) -> bytes:
    """A string behind its length, and zeros up to a multiple of 4."""
    encoded = text.encode()
    return struct.pack(f"<I{len(encoded)}sx{-(len(encoded) + 1) % 4}x", len(encoded) + 1, encoded)
