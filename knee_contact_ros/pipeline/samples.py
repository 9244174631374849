"""Messages to samples: the one place where joint names and signs are applied."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.messages.cdr import JOINT_STATE, SECOND, WRENCH, Coder, Content, JointState, WrenchStamped
from knee_contact_ros.messages.ros_types import stamp_to_ns
from knee_contact_ros.messages.topics import JOINT_STATES
from knee_contact_ros.parameters.compartments import Rule
from knee_contact_ros.parameters.schema import Knee
from knee_contact_ros.system.printable import listed, printable

LAST_STAMP = 2**31 * SECOND - 1
"""The last one [ns] that a ROS message can hold"""


class RefusedSampleError(Exception):
    """A sample that cannot be used; `reason` is the counter's name, the text says what is wrong."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(printable(text))
        self.reason = reason


class AngleSample(NamedTuple):
    """A flexion angle at a stamp, and with the displacement drive the femoral height."""

    stamp: int
    """[ns] at which it holds: that of its message less `delay`, which may be below 0"""
    angle: float
    """[rad] positive in flexion"""
    data: bytes = b""
    """The message it came in, as it is recorded: what came may hold leftovers of the sender's memory between fields"""
    height: float | None = None
    """[m] of the femoral reference point; None with the force drive"""
    delay: int = 0
    """[ns] `pairing.angle_delay`"""
    others: tuple[float, ...] = ()
    """What else the message tells of the leg's joints, [rad] or [N m]; as `leg_sample` orders it"""

    @property
    def came_at(self) -> int:
        """Stamp [ns] of its message, under which it is recorded."""
        return self.stamp + self.delay


class LoadSample(NamedTuple):
    """A joint reaction at a stamp, of which a compartment gets its part when the flexion angle is known."""

    stamp: int
    """[ns]"""
    axial: float
    """[N] > 0 when it presses the femur onto the tibia: -force.y"""
    moment: float
    """[N m] about x; not a number if it is not needed and did not come"""
    frame_id: str
    """The tibia frame"""
    data: bytes = b""
    """The message it came in, likewise"""
    arrived: float = 0.0
    """When it came, by the caller's clock [s]"""
    wrench: WrenchStamped | None = None
    """All of it, where more counts than the axial force"""


Deserialize = Callable[[bytes, str], Any]
"""The ordinary way: a message from its bytes and its topic; raises anything if they are not one"""


class Decoder:
    """The bytes of the input messages to their content: by our own coder, or the ordinary way where it gives up."""

    def __init__(self, deserialize: Deserialize) -> None:
        self.ordinary = 0
        """Messages that went the ordinary way"""
        self._deserialize = deserialize

    def joint_state(self, data: bytes) -> tuple[JointState, bytes]:
        """The content of a JointState, and the bytes under which it is recorded.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return JOINT_STATE.decode(data) or self._in_the_ordinary_way(data, JOINT_STATES, JOINT_STATE, joint_state_of)

    def force(self, data: bytes, topic: str) -> tuple[WrenchStamped, bytes]:
        """The content of a WrenchStamped of a topic, likewise.

        Raises:
            RefusedSampleError: the bytes are no such message.
        """
        return WRENCH.decode(data) or self._in_the_ordinary_way(data, topic, WRENCH, wrench_of)

    def _in_the_ordinary_way(
        self, data: bytes, topic: str, coder: Coder[Content], content_of: Callable[[Any], Content]
    ) -> tuple[Content, bytes]:
        self.ordinary += 1
        try:
            content = content_of(self._deserialize(data, topic))
        except Exception as error:  # whatever broken bytes provoke in a deserializer
            text = f"{topic}: {len(data)} bytes are no message of its type ({' '.join(str(error).split())})"
            raise RefusedSampleError("undecodable", text) from None
        checked_stamp(content.stamp, topic)
        return content, coder.encode(content)


def joint_state_of(message: Any) -> JointState:
    """The content of a JointState, ROS's own or a plain one."""
    return JointState(
        stamp_to_ns(message.header.stamp), message.header.frame_id, tuple(message.name),
        *(tuple(map(float, numbers)) for numbers in (message.position, message.velocity, message.effort)),
    )  # fmt: skip


def wrench_of(message: Any) -> WrenchStamped:
    """The content of a WrenchStamped, likewise."""
    force, torque = message.wrench.force, message.wrench.torque
    return WrenchStamped(
        stamp_to_ns(message.header.stamp), message.header.frame_id,
        (force.x, force.y, force.z), (torque.x, torque.y, torque.z),
    )  # fmt: skip


def angle_sample(
    message: JointState, knee: Knee, height_prescribed: bool = False, data: bytes = b"", delay: int = 0
) -> AngleSample:
    """Flexion angle from a JointState: sign x position + offset; with `height_prescribed` also the femoral height.

    `data` are the bytes under which it is recorded; `delay` [ns] is how much earlier than stamped it holds.

    Raises:
        RefusedSampleError: a joint is missing, has no position, or its value is not finite or beyond all knees; or the
            stamp is none.
    """
    angle = knee.flexion_sign * number_of(message, knee.joint_name, "position") + knee.flexion_offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: flexion angle of joint {knee.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        raise RefusedSampleError("out_of_range", text)
    height = number_of(message, knee.height_joint_name, "position") if height_prescribed else None
    if height is not None and abs(height) > LARGEST_HEIGHT:
        text = f"joint_states: height of joint {knee.height_joint_name!r} is {height:g} m, beyond {LARGEST_HEIGHT:g}"
        raise RefusedSampleError("out_of_range", text)
    return AngleSample(checked_stamp(message.stamp, "joint_states") - delay, angle, data, height, delay)


def number_of(message: JointState, joint: str, quantity: str) -> float:
    """Position [rad or m] or effort [N m] of a joint in a JointState.

    Raises:
        RefusedSampleError: it has none that is finite.
    """
    if joint not in message.name:
        known = listed(message.name)
        raise RefusedSampleError("joint_missing", f"joint_states has no joint {joint!r}; it has {known}")
    index, numbers = message.name.index(joint), message.position if quantity == "position" else message.effort
    if index >= len(numbers):
        raise RefusedSampleError("joint_missing", f"joint_states gives no {quantity} for joint {joint!r}")
    if not math.isfinite(numbers[index]):
        raise RefusedSampleError("not_finite", f"joint_states: {quantity} of joint {joint!r} is {numbers[index]}")
    return numbers[index]


def load_sample(
    message: WrenchStamped, by_moment: Rule | None = None, arrived: float = 0.0, data: bytes = b""
) -> LoadSample:
    """Axial load L = -F_y and frontal moment from a WrenchStamped on the tibia; `data` as above.

    `by_moment` is the rule for the compartment's part where the moment decides: what it gives must be a load of a knee.

    Raises:
        RefusedSampleError: the axial force, or a frontal moment that is needed, is not finite; the load is beyond all
            knees; or the stamp is none.
    """
    axial, moment = message.force[1], message.torque[0]
    if not math.isfinite(axial):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {axial}")
    if by_moment and not math.isfinite(moment):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: torque.x is {moment}")
    if abs(axial) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: force.y is {axial:g} N, beyond {LARGEST_LOAD:g}"
        )
    part = by_moment(-axial, moment, 0.0) if by_moment else 0.0
    if max(abs(part), abs(-axial - part)) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: torque.x of {moment:g} N m makes a load of {part:g} N"
        )
    stamp = checked_stamp(message.stamp, "joint_reaction_force")
    return LoadSample(stamp, -axial, moment, message.frame_id, data, arrived)


def checked_stamp(stamp: int, topic: str) -> int:
    """A stamp [ns] that a recording can hold.

    Raises:
        RefusedSampleError: it is none.
    """
    if not 0 <= stamp <= LAST_STAMP:
        raise RefusedSampleError("bad_stamp", f"{topic}: stamp {stamp} ns is not within 0 and {LAST_STAMP} ns")
    return stamp
