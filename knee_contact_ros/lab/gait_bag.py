"""A knee's gait in SI units and the package's signs and frames, and its way into a bag."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.lab.tables import Floats, Stamps
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    MESSAGE_TYPES,
    NANOSECONDS,
)
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import sha256_of


class Angles(NamedTuple):
    """Flexion angles of a joint over time."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    angle: Floats
    """[rad], positive in flexion; shape (n,)"""
    rate: Floats | None
    """[rad/s], shape (n,); None: to be derived from the angles"""


class Reactions(NamedTuple):
    """Joint reactions that the femur exerts on the tibia, in the tibia frame (x anterior, y superior, z right)."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    force: Floats
    """[N], shape (n, 3)"""
    torque: Floats
    """[N m] about the tibia frame's origin, shape (n, 3)"""


def common_window(
    angles: Angles, reactions: Reactions, start: float | None, end: float | None, ground: Stamps | None = None
) -> tuple[int, int]:
    """Return the first and the last stamp [ns] of the time that all inputs cover, within `start` and `end` [s].

    Times before 0 are left out. `ground` are the stamps [ns] of the ground forces, shape (n,), where there are some.

    Raises:
        UsageError: the inputs have no time in common, or none within `start` and `end`.
    """
    three = (angles.stamps, reactions.stamps, *(() if ground is None else (ground,)))
    spans = [(int(stamps[0]), int(stamps[-1])) for stamps in three]
    first, last = max(0, *(span[0] for span in spans)), min(span[1] for span in spans)
    if first >= last:
        covered = " and ".join(f"{a / NANOSECONDS:g} to {b / NANOSECONDS:g} s" for a, b in spans)
        what = "kinematics and reactions" if ground is None else "kinematics, reactions and ground forces"
        raise UsageError(f"{what} have no time in common: {covered}")
    wanted = (first if start is None else round(start * NANOSECONDS), last if end is None else round(end * NANOSECONDS))
    if max(first, wanted[0]) >= min(last, wanted[1]):
        options = f"--start {wanted[0] / NANOSECONDS:g} --end {wanted[1] / NANOSECONDS:g}"
        raise UsageError(f"{options}: nothing is left of {first / NANOSECONDS:g} to {last / NANOSECONDS:g} s")
    return max(first, wanted[0]), min(last, wanted[1])


def cut(angles: Angles, reactions: Reactions, window: tuple[int, int]) -> tuple[Angles, Reactions]:
    """Cut both to a window [ns]; the angles keep one neighbour on either side, so that every reaction has its angle.

    Raises:
        UsageError: fewer than two reactions are left.
    """
    kept = (reactions.stamps >= window[0]) & (reactions.stamps <= window[1])
    if np.count_nonzero(kept) < 2:
        low, high = (stamp / NANOSECONDS for stamp in window)
        raise UsageError(f"fewer than two rows of the reactions are within {low:g} to {high:g} s")
    first = max(int(np.searchsorted(angles.stamps, window[0], "right")) - 1, 0)
    last = int(np.searchsorted(angles.stamps, window[1], "left")) + 1
    rate = None if angles.rate is None else angles.rate[first:last]
    inside = Reactions(reactions.stamps[kept], reactions.force[kept], reactions.torque[kept])
    return Angles(angles.stamps[first:last], angles.angle[first:last], rate), inside


def resample(angles: Angles, reactions: Reactions, window: tuple[int, int], rate: float) -> tuple[Angles, Reactions]:
    """Resample both at the multiples of 1/`rate` [Hz] within the window [ns], by linear interpolation.

    Raises:
        UsageError: fewer than two multiples are in the window.
    """
    period = NANOSECONDS / rate
    counts = np.arange(np.ceil(window[0] / period - 1e-6), np.floor(window[1] / period + 1e-6) + 1)
    stamps = np.clip(np.rint(counts * period).astype(np.int64), *window)
    if len(stamps) < 2:
        raise UsageError(f"--rate {rate:g}: fewer than two samples in {(window[1] - window[0]) / NANOSECONDS:g} s")

    def at(known: Stamps, values: Floats) -> Floats:
        return np.interp(stamps - window[0], known - window[0], values)

    angle = at(angles.stamps, angles.angle)
    speed = None if angles.rate is None else at(angles.stamps, angles.rate)
    force, torque = (np.column_stack([at(reactions.stamps, column) for column in values.T]) for values in reactions[1:])
    return Angles(stamps, angle, speed), Reactions(stamps, force, torque)


def with_rate(angles: Angles) -> Angles:
    """Return angles with their rate: derived by differences of second order if there is none."""
    if angles.rate is not None:
        return angles
    seconds = (angles.stamps - angles.stamps[0]) / NANOSECONDS
    return angles._replace(rate=np.gradient(angles.angle, seconds))


def mirrored(reactions: Reactions) -> Reactions:
    """Mirror the reactions of a left knee to a right one: force z and torques x and y change their signs."""
    return reactions._replace(
        force=reactions.force * np.array([1.0, 1.0, -1.0]), torque=reactions.torque * np.array([-1.0, -1.0, 1.0])
    )


class GroundForces(NamedTuple):
    """Forces and torques that the ground exerts on a foot, in upright axes (x forward, y up, z to the right)."""

    stamps: Stamps
    """[ns], growing; shape (n,)"""
    force: Floats
    """[N], shape (n, 3)"""
    torque: Floats
    """[N m] about the ankle joint's centre, shape (n, 3)"""


class Leg(NamedTuple):
    """Hip and ankle at the stamps of the knee's angle, and the ground forces at stamps of their own."""

    hip: Angles
    """Angle between thigh and vertical in the sagittal plane, positive when the knee is ahead of the hip"""
    ankle: Angles
    """Angle of the ankle, positive in dorsiflexion, 0 at a right angle"""
    ground: GroundForces


def leg_at(leg: Leg, stamps: Stamps, ground_stamps: Stamps) -> Leg:
    """Resample the joints at `stamps` [ns] and the ground forces at `ground_stamps` [ns], by linear interpolation."""
    ground = leg.ground
    force, torque = (
        np.column_stack([interpolated(ground_stamps, ground.stamps, column) for column in values.T])
        for values in (ground.force, ground.torque)
    )
    return Leg(_at(leg.hip, stamps), _at(leg.ankle, stamps), GroundForces(ground_stamps, force, torque))


def interpolated(stamps: Stamps, known: Stamps, values: Floats) -> Floats:
    """Interpolate values, shape (n,), linearly at other stamps [ns]; beyond the known stamps the end values hold."""
    first = known[0]  # nanoseconds since 1970 have more digits than a float
    return np.asarray(np.interp(stamps - first, known - first, values))


def _at(angles: Angles, stamps: Stamps) -> Angles:
    """Resample angles at other stamps [ns], and derive their rate."""
    return with_rate(Angles(stamps, interpolated(stamps, angles.stamps, angles.angle), None))


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
