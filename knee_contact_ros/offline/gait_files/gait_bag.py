"""Writing a knee's gait as a rosbag2 folder, with a metadata record that gives its origin."""

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
"""Name of the metadata record with the origin of a bag"""
JOINT = "knee"
"""Name of the knee in a bag, whatever its name in the model: the default of `knee.joint_name`"""
QUANTITIES = {
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its frame's origin, in the tibia frame (x anterior, y superior, z to the "
    "right; a left knee is mirrored)",
}
LEG_JOINTS = ("hip", "ankle")
"""Names of the further joints in a bag, behind the knee, as in the parameter file `load/inverse_dynamics`"""
LEG_QUANTITIES = {
    "joints": "knee flexion; hip, the angle between thigh and vertical in the sagittal plane, positive when the knee "
    "is ahead of the hip; ankle, positive in dorsiflexion, 0 at a right angle; rad",
    "ground_force": "what the ground exerts on the foot, N, and N m about the ankle joint's centre (x forward, y up, z "
    "to the right; a left leg is mirrored)",
}
GROUND_FRAME = "ground"
BLOCK = 8192
"""Number of rows that are made messages at a time"""
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
    """Write a new rosbag2 folder; messages are in the order of their stamps, an angle before forces of the same stamp.

    Args:
        side: `right` or `left`.
        angles: Flexion angles of the knee, with their rates.
        reactions: Joint reactions on the tibia.
        folder: The folder to write.
        origin: Values of the metadata record `ORIGIN`.
        joint: Name of the knee in the bag.
        leg: Hip and ankle, at the stamps of `angles`, and the ground forces; None: the bag has the knee alone.

    Raises:
        UsageError: the folder cannot be written.
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
    """Yield stamp [ns], topic and bytes of a JointState for every stamp; all joints have the same stamps, and rates."""
    names, columns = tuple(joints), list(joints.values())
    rates = [angles.rate for angles in columns if angles.rate is not None]
    assert len(rates) == len(names)  # noqa: S101  (the importers give them)
    for stamp, *values in rows(columns[0].stamps, *(angles.angle for angles in columns), *rates):
        angle, rate = tuple(values[: len(names)]), tuple(values[len(names) :])
        yield stamp, JOINT_STATES, encode_joint_state(JointState(stamp, "", names, angle, rate, ()))


def wrench_messages(wrenches: Reactions | GroundForces, topic: str, frame: str) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp [ns], topic and bytes of a WrenchStamped for every reaction or ground force."""
    for stamp, force, torque in rows(*wrenches):
        yield stamp, topic, encode_wrench_stamped(WrenchStamped(stamp, frame, tuple(force), tuple(torque)))


def rows(*columns: NDArray[Any]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of columns as plain numbers, block by block: those of hours at once would take gigabytes."""
    for begin in range(0, len(columns[0]), BLOCK):
        yield from zip(*(column[begin : begin + BLOCK].tolist() for column in columns), strict=True)


def check_output(folder: Path, overwrite: bool) -> None:
    """Refuse a folder to write that exists, unless it is a bag's and may be replaced, and a name that is a file's.

    Raises:
        UsageError: the folder exists, or its name ends with `.mcap`.
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
    """Return the SHA-256 of a file as hexadecimal text."""
    with path.open("rb") as file:
        return sha256_of(file)
