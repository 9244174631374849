"""Messages to samples: the one place where joint names, signs and the compartment's share are applied."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.messages.cdr_in import SECOND, JointState, WrenchStamped
from knee_contact_ros.parameters.compartments import BY_MOMENT, COMPARTMENTS
from knee_contact_ros.parameters.schema import Knee, Load
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
    """[ns]"""
    angle: float
    """[rad] positive in flexion"""
    message: JointState
    """The message it came in"""
    height: float | None = None
    """[m] of the femoral reference point; None with the force drive"""


class LoadSample(NamedTuple):
    """A compressive compartment load at a stamp."""

    stamp: int
    """[ns]"""
    load: float
    """[N] > 0 when it presses the femur onto the tibia"""
    frame_id: str
    """The tibia frame"""
    message: WrenchStamped
    """The message it came in"""
    arrived: float = 0.0
    """When it came, by the caller's clock [s]"""


def angle_sample(message: JointState, knee: Knee, height_prescribed: bool = False) -> AngleSample:
    """Flexion angle from a JointState: sign x position + offset; with `height_prescribed` also the femoral height.

    Raises:
        RefusedSampleError: a joint is missing, has no position, or its value is not finite or beyond all knees; or the
            stamp is none.
    """
    angle = knee.flexion_sign * _position(message, knee.joint_name) + knee.flexion_offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: flexion angle of joint {knee.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        raise RefusedSampleError("out_of_range", text)
    height = _position(message, knee.height_joint_name) if height_prescribed else None
    if height is not None and abs(height) > LARGEST_HEIGHT:
        text = f"joint_states: height of joint {knee.height_joint_name!r} is {height:g} m, beyond {LARGEST_HEIGHT:g}"
        raise RefusedSampleError("out_of_range", text)
    return AngleSample(_checked(message.stamp, "joint_states"), angle, message, height)


def _position(message: JointState, joint: str) -> float:
    """Position of a joint in a JointState [rad or m]; raises RefusedSampleError if it has none that is finite."""
    if joint not in message.name:
        known = listed(message.name)
        raise RefusedSampleError("joint_missing", f"joint_states has no joint {joint!r}; it has {known}")
    index = message.name.index(joint)
    if index >= len(message.position):
        raise RefusedSampleError("joint_missing", f"joint_states gives no position for joint {joint!r}")
    position = message.position[index]
    if not math.isfinite(position):
        raise RefusedSampleError("not_finite", f"joint_states: position of joint {joint!r} is {position}")
    return position


def load_sample(message: WrenchStamped, load: Load, arrived: float = 0.0) -> LoadSample:
    """Compressive load from a WrenchStamped on the tibia: the compartment's part of L = -F_y.

    Raises:
        RefusedSampleError: the axial force, or a frontal moment that is needed, is not finite; the load is beyond all
            knees; or the stamp is none.
    """
    axial, moment = message.force[1], message.torque[0]
    if not math.isfinite(axial):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {axial}")
    if not math.isfinite(moment) and load.compartment in BY_MOMENT:
        raise RefusedSampleError("not_finite", f"joint_reaction_force: torque.x is {moment}")
    if abs(axial) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: force.y is {axial:g} N, beyond {LARGEST_LOAD:g}"
        )
    part = COMPARTMENTS[load.compartment](axial, moment, load)
    if abs(part) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: torque.x of {moment:g} N m makes a load of {part:g} N"
        )
    return LoadSample(_checked(message.stamp, "joint_reaction_force"), part, message.frame_id, message, arrived)


def _checked(stamp: int, topic: str) -> int:
    """A stamp [ns] that a recording can hold; raises RefusedSampleError if it is none."""
    if not 0 <= stamp <= LAST_STAMP:
        raise RefusedSampleError("bad_stamp", f"{topic}: stamp {stamp} ns is not within 0 and {LAST_STAMP} ns")
    return stamp
