"""Read a bag of a leg's sensors with the measured joint reaction, to which the load estimate is fitted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.bag_files import in_a_line, others_beside
from knee_contact_ros.bags.provenance import bag_digest
from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.bags.topic_names import Names
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.messages.topics import JOINT_REACTION_FORCE, LOAD_ESTIMATE, MESSAGE_TYPES
from knee_contact_ros.model.types import UNUSABLE
from knee_contact_ros.offline.sensed import Sensed, SensedBag, sensed_in
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.pipeline.samples import Decoder, RefusedSampleError, load_sample
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
AXIAL_FORCE = "axial_force"
OWN_NAME, ROLE = f"/{JOINT_REACTION_FORCE}", "/reference"
"""Default topic of the reference, and a role of its own, so that no other force is read in its place"""


class Referenced(NamedTuple):
    """Samples of a leg's sensors, n of them, one for each ground force, and the joint reaction at their stamps."""

    source: str
    """Path of the bag"""
    digest: str
    """SHA-256 of the bag"""
    samples: tuple[Sensed, ...]
    """All n samples"""
    answers: dict[str, Floats]
    """`axial_force` [N], shape (n,): the reference; not a number at samples that are left out"""
    left_out: dict[str, int]
    """Number of samples that are left out, by the reason"""
    doubts: tuple[str, ...]
    """What makes no sense in the bag, a sentence each"""

    @property
    def number(self) -> int:
        """Number of samples that have a reference."""
        return int(np.isfinite(self.answers[AXIAL_FORCE]).sum())


def referenced(
    bag: Path, parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]
) -> Referenced:  # fmt: skip
    """Read a bag; samples that are flagged, or have no reference at their stamps, are left out.

    The reference at a stamp is interpolated between its neighbours, if they are not further than `pairing.max_gap`
    apart.

    Args:
        bag: Path of the bag.
        parameters: Parameters of the load node.
        names: Names of the bag's three topics.
        advance: Called with the amount that is read, and that of all.

    Raises:
        UsageError: the bag cannot be used, a topic is missing, or no sample is left.
    """
    sensed = sensed_in(bag, parameters, names, advance)
    stamps, axial, refused = _reference(bag, names.get(OWN_NAME, OWN_NAME))
    if not sensed.samples:
        raise UsageError(f"bag {bag}: no ground force has joint angles at its time ({_counted(sensed.refused)})")
    column = interpolated(stamps, axial, sensed, round(parameters.pairing.max_gap * NANOSECONDS))
    flagged = np.array([bool(sample.status & UNUSABLE) for sample in sensed.samples])
    without = int((np.isnan(column) & ~flagged).sum())
    column[flagged] = np.nan
    left_out = {"flagged": int(flagged.sum()), "without a reference": without}
    left_out |= {f"refused as {reason}": count for reason, count in (sensed.refused + refused).items()}
    if np.isnan(column).all():
        raise UsageError(f"bag {bag}: no sample can be fitted to the reference ({_counted(left_out)})")
    return Referenced(
        str(bag), bag_digest(bag), tuple(sensed.samples), {AXIAL_FORCE: column}, left_out,
        (*_own(bag, names.get(OWN_NAME, OWN_NAME)), *others_beside(bag), *_damage(bag, sensed)),
    )  # fmt: skip


def interpolated(stamps: Stamps, values: Floats, sensed: SensedBag, max_gap: int) -> Floats:
    """Interpolate the reference at the stamps of all samples.

    Args:
        stamps: Stamps of the reference [ns], increasing.
        values: The reference.
        sensed: The samples.
        max_gap: The largest distance [ns] of neighbours between which to interpolate.

    Returns:
        The reference, shape (n,). It is not a number where neighbours are missing or too far apart, and where a
        sample's stamp is not later than all before: of two runs over the same stamps, the first one counts.
    """
    at = np.array([sample.stamp for sample in sensed.samples], dtype=np.int64)
    later = at > np.maximum.accumulate(np.concatenate(([-1], at[:-1])))
    after = np.searchsorted(stamps, at, side="left")
    inside = np.minimum(after, len(stamps) - 1)
    before = np.maximum(inside - 1, 0)
    exact = stamps[inside] == at
    gap = stamps[inside] - stamps[before]
    between = (after > 0) & (after < len(stamps)) & (gap <= max_gap)
    part = (at - stamps[before]) / np.maximum(gap, 1)
    at_stamps = np.where(exact, values[inside], values[before] + part * (values[inside] - values[before]))
    return np.where(later & (exact | between), at_stamps, np.nan)


def _reference(bag: Path, topic: str) -> tuple[Stamps, Floats, Counter[str]]:
    """Read increasing stamps [ns] and axial forces [N] of the reference, and count refused samples by the reason."""
    decoder, kept, refused, last = Decoder(deserialize), [], Counter[str](), -1
    with _opened(bag, topic) as reader:
        for message in reader.raw_messages():
            try:
                sample = load_sample(decoder.force(message.data, JOINT_REACTION_FORCE)[0])
            except RefusedSampleError as error:
                refused[error.reason] += 1
                continue
            if sample.stamp <= last:
                refused["time_went_back"] += 1
                continue
            last = sample.stamp
            kept.append((sample.stamp, sample.axial))
    if not kept:
        raise UsageError(f"bag {bag}: no message on {topic} can be a reference ({_counted(refused)})")
    return np.array([stamp for stamp, _ in kept]), np.array([axial for _, axial in kept]), refused


def _opened(bag: Path, topic: str) -> BagReader:
    try:
        return BagReader(bag, {ROLE: MESSAGE_TYPES[JOINT_REACTION_FORCE]}, {ROLE: topic})
    except UsageError as error:
        raise UsageError(f"{error}; --remap {JOINT_REACTION_FORCE}:=TOPIC names a measured joint reaction") from None


def _own(bag: Path, topic: str) -> list[str]:
    """Report a reference that is likely an estimate of our own, as there is a topic `load_estimate` beside it."""
    estimate = topic.removesuffix(JOINT_REACTION_FORCE) + LOAD_ESTIMATE
    if not topic.endswith(OWN_NAME):
        return []
    try:
        BagReader(bag, {estimate: MESSAGE_TYPES[LOAD_ESTIMATE]}).close()
    except UsageError:
        return []
    return [f"the bag also has {estimate}: its {topic} is likely an estimate of the load node, and was not measured"]


def _damage(bag: Path, sensed: SensedBag) -> list[str]:
    return [f"bag {bag} is damaged, and read as far as it can be: {in_a_line(sensed.damage)}"] if sensed.damage else []


def _counted(reasons: dict[str, int] | Counter[str]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count) or "nothing is refused"
