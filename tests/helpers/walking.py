"""Sensors of a walking leg, from simple functions: hip, knee, ankle, and what the ground exerts on the foot."""

import math

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import LOAD_INPUTS, MESSAGE_TYPES

MS = 1_000_000
STRIDE = 1.1
"""[s]"""
ANGLES, FORCE = (f"/{topic}" for topic in LOAD_INPUTS)
WHOLE_LEG = {"hip.joint_name": "hip", "ankle.joint_name": "ankle", "ground.components": "full"}
"""Parameters for all that the leg tells"""


def phase(stamp):
    """Where in a stride a stamp [ns] is, as an angle."""
    return 2.0 * math.pi * stamp * 1e-9 / STRIDE


def joint_state(stamp, effort=False):
    """Angles [rad], roughly as in walking; with `effort` also actuators [N m] that help to extend and plantarflex."""
    turn = phase(stamp)
    hip, knee = 0.15 + 0.35 * math.cos(turn), 0.45 - 0.3 * math.cos(turn + 0.8)
    ankle = 0.05 + 0.15 * math.sin(2.0 * turn)
    torques = (0.0, -8.0 - 4.0 * math.sin(turn), -5.0) if effort else ()
    return JointState(stamp, "leg", ("hip", "knee", "ankle"), (hip, knee, ankle), (), torques)


def ground(stamp, frame="plate"):
    """What the ground exerts on the foot about the ankle [N, N m]: stance in the one half of a stride, nothing else."""
    stance = max(math.sin(phase(stamp)), 0.0)
    vertical, shear = 900.0 * math.sqrt(stance), -120.0 * stance * math.sin(2.0 * phase(stamp))
    return WrenchStamped(
        stamp,
        frame,
        (shear, vertical, -30.0 * stance),
        (6.0 * stance, 2.0 * stance, 40.0 * stance),
    )


def walk(
    number=240,
    step=5 * MS,
    begin=0,
    effort=False,
    frame="plate",
):
    """Messages of both inputs, `number` of each, `step` [ns] apart; the angle of a stamp comes first."""
    messages = []
    for stamp in range(begin, begin + number * step, step):
        messages.append(RawMessage(ANGLES, stamp, encode_joint_state(joint_state(stamp, effort))))
        messages.append(RawMessage(FORCE, stamp, encode_wrench_stamped(ground(stamp, frame))))
    return messages


def walking_bag(path, messages, prefix=""):
    """A bag of these messages, their topics with something before their names."""
    with BagWriter(path) as bag:
        for topic in LOAD_INPUTS:
            bag.add_topic(f"{prefix}/{topic}", MESSAGE_TYPES[topic])
        for message in messages:
            bag.write_message(prefix + message.topic, message.log_time, message.data)
    return path
