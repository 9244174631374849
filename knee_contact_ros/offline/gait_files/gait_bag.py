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
from knee_contact_ros.messages.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, MESSAGE_TYPES
from knee_contact_ros.offline.gait_files.knee_gait import Angles, Reactions
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
AT_ONCE = 8192
"""Rows that are made messages at a time"""
MCAP = ".mcap"
BAG_FILES = {MCAP, ".yaml"}


def write_bag(
    side: str, angles: Angles, reactions: Reactions, folder: Path, origin: dict[str, str], joint: str = JOINT
) -> None:
    """Write a new rosbag2 folder; messages in the order of their stamps, the angle before the reaction.

    `side` is right or left, `origin` the metadata record of that name; angles have their rates.

    Raises:
        UsageError: it cannot be written.
    """
    with BagWriter(folder / f"{folder.name}_0.mcap") as bag:
        for topic in INPUTS:
            bag.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        bag.add_metadata(ORIGIN, origin)
        both = (angle_messages(angles, joint), reaction_messages(reactions, side))
        for stamp, topic, data in heapq.merge(*both, key=itemgetter(0)):
            bag.write(f"/{topic}", stamp, data)


def angle_messages(angles: Angles, joint: str) -> Iterator[tuple[int, str, bytes]]:
    """Stamp [ns], topic and bytes of every angle."""
    assert angles.rate is not None  # noqa: S101  (the importers give them)
    for stamp, angle, rate in rows(angles.stamps, angles.angle, angles.rate):
        yield stamp, JOINT_STATES, encode_joint_state(JointState(stamp, "", (joint,), (angle,), (rate,), ()))


def reaction_messages(reactions: Reactions, side: str) -> Iterator[tuple[int, str, bytes]]:
    """Stamp [ns], topic and bytes of every reaction."""
    frame = f"tibia_{side[0]}"
    for stamp, force, torque in rows(*reactions):
        wrench = WrenchStamped(stamp, frame, tuple(force), tuple(torque))
        yield stamp, JOINT_REACTION_FORCE, encode_wrench_stamped(wrench)


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
