"""Messages to samples: the one place where joint names, signs and the compartment's share are applied.

Works on ROS messages and on plain ones alike, for it only reads their fields.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.messages import stamp_to_ns
from knee_contact_ros.parameters import Knee, Load


class RefusedSampleError(Exception):
    """A sample that cannot be used; `reason` is the counter's name, the text says what is wrong."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class AngleSample(NamedTuple):
    """A flexion angle at a stamp, and with the displacement drive the femoral height."""

    stamp: int
    """[ns]"""
    angle: float
    """[rad] positive in flexion"""
    message: Any
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
    message: Any
    """The message it came in"""


def angle_sample(message: Any, knee: Knee, height_prescribed: bool = False) -> AngleSample:
    """Flexion angle from a JointState: sign x position + offset; with `height_prescribed` also the femoral height.

    Raises:
        RefusedSampleError: a joint is missing, has no position, or its value is not finite or beyond all knees.
    """
    angle = knee.flexion_sign * _position(message, knee.joint_name) + knee.flexion_offset
    if abs(angle) > LARGEST_ANGLE:
        text = f"joint_states: flexion angle of joint {knee.joint_name!r} is {angle:g} rad, beyond {LARGEST_ANGLE:g}"
        raise RefusedSampleError("out_of_range", text)
    height = _position(message, knee.height_joint_name) if height_prescribed else None
    if height is not None and abs(height) > LARGEST_HEIGHT:
        text = f"joint_states: height of joint {knee.height_joint_name!r} is {height:g} m, beyond {LARGEST_HEIGHT:g}"
        raise RefusedSampleError("out_of_range", text)
    return AngleSample(stamp_to_ns(message.header.stamp), angle, message, height)


def _position(message: Any, joint: str) -> float:
    """Position of a joint in a JointState [rad or m]; raises RefusedSampleError if it has none that is finite."""
    names = list(message.name)
    if joint not in names:
        raise RefusedSampleError("joint_missing", f"joint_states has no joint {joint!r}; it has {', '.join(names)}")
    index = names.index(joint)
    if index >= len(message.position):
        raise RefusedSampleError("joint_missing", f"joint_states gives no position for joint {joint!r}")
    position = float(message.position[index])
    if not math.isfinite(position):
        raise RefusedSampleError("not_finite", f"joint_states: position of joint {joint!r} is {position}")
    return position


def load_sample(message: Any, load: Load) -> LoadSample:
    """Compressive load from a WrenchStamped on the tibia: L = -F_y, times the compartment's share.

    Raises:
        RefusedSampleError: the axial force is not finite or beyond all knees.
    """
    axial = float(message.wrench.force.y)
    if not math.isfinite(axial):
        raise RefusedSampleError("not_finite", f"joint_reaction_force: force.y is {axial}")
    if abs(axial) > LARGEST_LOAD:
        raise RefusedSampleError(
            "out_of_range", f"joint_reaction_force: force.y is {axial:g} N, beyond {LARGEST_LOAD:g}"
        )
    share = load.share if load.compartment == "fixed_share" else 1.0
    return LoadSample(stamp_to_ns(message.header.stamp), share * -axial, message.header.frame_id, message)
