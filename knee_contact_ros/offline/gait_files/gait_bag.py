"""A knee's gait → a rosbag2 folder like those we ship, with a metadata record that says where it comes from."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.messages.cdr import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.messages.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    MESSAGE_TYPES,
)
from knee_contact_ros.offline.gait_files.knee_gait import Angles, Reactions
from knee_contact_ros.offline.gait_files.leg_gait import GroundForces, Leg
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import sha256_of

ORIGIN = "origin"
"""Name of the metadata record"""
JOINT = "knee"
"""In the bag, whatever the model calls it: the default of `knee.joint_name`"""
QUANTITIES = {
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its frame's origin, in the tibia frame (x anterior, y superior, z to the "
    "right; a left knee is mirrored)",
}
LEG_JOINTS = ("hip", "ankle")
"""In the bag, behind the knee: as `load/inverse_dynamics` names them"""
LEG_QUANTITIES = {
    "joints": "knee flexion; hip, the angle between thigh and vertical in the sagittal plane, positive when the knee "
    "is ahead of the hip; ankle, positive in dorsiflexion, 0 at a right angle; rad",
    "ground_force": "what the ground exerts on the foot, N, and N m about the ankle joint's centre (x forward, y up, z "
    "to the right; a left leg is mirrored)",
}
GROUND_FRAME = "ground"
AT_ONCE = 8192
"""Rows that are made messages at a time"""
MCAP = ".mcap"
BAG_FILES = {MCAP, ".yaml"}


def write_bag(
    side: str,
    angles: Angles,
    reactions: Reactions,
    folder: Path,
    origin: dict[str, str],
    joint: str = JOINT,
    leg: Leg | None = None,
) -> None:
    """Write a new rosbag2 folder; messages in the order of their stamps, the angle before the forces.

    `side` is right or left, `origin` the metadata record of that name; angles have their rates. With a `leg`, whose
    joints have the stamps of `angles`, its hip and ankle come with the knee, and the ground's forces on a topic.

    Raises:
        UsageError: it cannot be written.
    """
    with BagWriter(folder / f"{folder.name}_0.mcap") as bag:
        for topic in (*INPUTS, GROUND_REACTION_FORCE) if leg else INPUTS:
            bag.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        bag.add_metadata(ORIGIN, origin)
        joints = {joint: angles}
        streams = [wrench_messages(reactions, JOINT_REACTION_FORCE, f"tibia_{side[0]}")]
        if leg:
            joints |= dict(zip(LEG_JOINTS, (leg.hip, leg.ankle), strict=True))
            streams.append(wrench_messages(leg.ground, GROUND_REACTION_FORCE, GROUND_FRAME))
        for stamp, topic, data in heapq.merge(joint_messages(joints), *streams, key=itemgetter(0)):
            bag.write(f"/{topic}", stamp, data)


def joint_messages(joints: dict[str, Angles]) -> Iterator[tuple[int, str, bytes]]:
    """Stamp [ns], topic and bytes of the joints' angles, by their names; all have the same stamps, and rates."""
    names, of_joints = tuple(joints), list(joints.values())
    rates = [angles.rate for angles in of_joints if angles.rate is not None]
    assert len(rates) == len(names)  # noqa: S101  (the importers give them)
    for stamp, *told in rows(of_joints[0].stamps, *(angles.angle for angles in of_joints), *rates):
        angle, rate = tuple(told[: len(names)]), tuple(told[len(names) :])
        yield stamp, JOINT_STATES, encode_joint_state(JointState(stamp, "", names, angle, rate, ()))


def wrench_messages(wrenches: Reactions | GroundForces, topic: str, frame: str) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp [ns], topic and bytes of a WrenchStamped for every reaction or ground force."""
    for stamp, force, torque in rows(*wrenches):
        yield stamp, topic, encode_wrench_stamped(WrenchStamped(stamp, frame, tuple(force), tuple(torque)))


def rows(*columns: NDArray[Any]) -> Iterator[tuple[Any, ...]]:
    """Rows of columns as plain numbers, some at a time: those of hours would take gigabytes."""
    for begin in range(0, len(columns[0]), AT_ONCE):
        yield from zip(*(column[begin : begin + AT_ONCE].tolist() for column in columns), strict=True)


def check_output(folder: Path, overwrite: bool) -> None:
    """Refuse a name that is taken, unless it is a bag's and may be replaced, or that looks like a file's.

    Raises:
        UsageError: it is taken, or ends with `.mcap`.
    """
    if folder.suffix == MCAP:
        raise UsageError(f"--output {folder}: a bag's folder is written; give its name without {MCAP}")
    if not folder.exists():
        return
    if not overwrite:
        raise UsageError(f"{folder} exists already; give another --output, or --overwrite")
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file and no bag's folder, and is not replaced")
    others = [path.name for path in folder.iterdir() if path.suffix not in BAG_FILES]
    if others:
        raise UsageError(f"{folder} is no bag's folder, as it has {others[0]}, and is not replaced")


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as file:
        return sha256_of(file)
