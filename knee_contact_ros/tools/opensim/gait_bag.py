"""A knee's gait → a rosbag2 folder like those we ship, with a metadata record that says where it comes from."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from knee_contact_ros import __version__
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.messages.cdr import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.messages.topics import INPUTS, JOINT_REACTION_FORCE, JOINT_STATES, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import sha256_of
from knee_contact_ros.tools.opensim.opensim_results import Files, KneeGait, Settings

ORIGIN = "origin"
"""Name of the metadata record"""
JOINT = "knee"
"""In the bag, whatever the model calls it: the default of `knee.joint_name`"""
QUANTITIES = {
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its frame's origin, in the tibia frame (x anterior, y superior, z to the "
    "right; a left knee is mirrored)",
}
MCAP = ".mcap"
BAG_FILES = {MCAP, ".yaml"}


def write_bag(gait: KneeGait, folder: Path, origin: dict[str, str]) -> None:
    """Write a new rosbag2 folder; messages in the order of their stamps, the angle before the reaction.

    Raises:
        UsageError: it cannot be written.
    """
    with BagWriter(folder / f"{folder.name}_0.mcap") as bag:
        for topic in INPUTS:
            bag.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        bag.add_metadata(ORIGIN, origin)
        messages = sorted([*angle_messages(gait), *reaction_messages(gait)], key=lambda message: message[0])
        for stamp, topic, data in messages:
            bag.write(f"/{topic}", stamp, data)


def angle_messages(gait: KneeGait) -> list[tuple[int, str, bytes]]:
    """Stamp [ns], topic and bytes of every angle."""
    stamps, angles, rates = gait.angles
    assert rates is not None  # noqa: S101  (a gait that was read has them)
    rows = zip(stamps.tolist(), angles.tolist(), rates.tolist(), strict=True)
    return [
        (stamp, JOINT_STATES, encode_joint_state(JointState(stamp, "", (JOINT,), (angle,), (rate,), ())))
        for stamp, angle, rate in rows
    ]


def reaction_messages(gait: KneeGait) -> list[tuple[int, str, bytes]]:
    """Stamp [ns], topic and bytes of every reaction."""
    frame = f"tibia_{gait.side[0]}"
    rows = zip(*(values.tolist() for values in gait.reactions), strict=True)
    return [
        (stamp, JOINT_REACTION_FORCE, encode_wrench_stamped(WrenchStamped(stamp, frame, tuple(force), tuple(torque))))
        for stamp, force, torque in rows
    ]


def origin_record(gait: KneeGait, files: Files, settings: Settings, more: dict[str, str]) -> dict[str, str]:
    """What the metadata record says; nothing in it depends on where or when it is written."""
    record = {"package": f"knee_contact_ros {__version__}", "source": "OpenSim results", "side": gait.side}
    for name, path in asdict(files).items():
        if path is not None:
            record |= {name: path.name, f"{name}_sha256": digest(path)}
    record |= {f"column of {what}": name for what, name in gait.columns.items()}
    record |= {"conversions": "\n".join(gait.notes), "settings": json.dumps(asdict(settings)), **QUANTITIES}
    if gait.body_weight:
        record["body_weight"] = f"{gait.body_weight:.3f} N"
    return record | more


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
