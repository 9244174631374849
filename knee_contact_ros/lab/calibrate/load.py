"""The problem of fitting a person's constants of the load estimate to a measured joint reaction in a bag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import bag_digest
from knee_contact_ros.bags.reader import BagReader, Names, others_beside
from knee_contact_ros.joint_reaction.estimator import LEVELS, EstimationLevel, Estimator
from knee_contact_ros.joint_reaction.leg import NetMoments, leg_of
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.lab.calibrate.problem import STEP, Data, Fittable, Problem, Unknown
from knee_contact_ros.model.types import UNUSABLE, Floats
from knee_contact_ros.offline.estimate_load import Sensed, sensed_in
from knee_contact_ros.parameters.files import all_values, known_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.contact_stream import load_sample
from knee_contact_ros.streams.messages import WRENCH, RefusedSampleError
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, LOAD_ESTIMATE, MESSAGE_TYPES, NANOSECONDS
from knee_contact_ros.system.errors import UsageError, in_a_line

Stamps = NDArray[np.int64]
AXIAL_FORCE = "axial_force"
OWN_NAME, ROLE = f"/{JOINT_REACTION_FORCE}", "/reference"
"""Default topic of the reference, and a role of its own, so that no other force is read in its place"""
SECTION = "person."
BODY = ("person.mass", "person.height")
"""Parameters on which the net moments depend"""
LEAST_DEVIATION, LARGEST_DEVIATION = 0.01, 10.0
"""Range of the parameter `standard_deviation` [body weights]"""
OTHER_TRIALS = (
    "standard_deviation is the RMS of what is left of these data; in another trial of the same person it was up to 1.4 "
    "times as large (docs/how-to/uncertainty-and-calibration.md)"
)


@dataclass(frozen=True)
class Referenced(Data):
    """Samples of a leg's sensors, n of them, one for each ground force, and the joint reaction at their stamps.

    The answer is `axial_force` [N], shape (n,): the reference; not a number at samples that are left out.
    """

    samples: tuple[Sensed, ...]
    """All n samples"""
    left_out: dict[str, int]
    """Number of samples that are left out, by the reason"""
    doubts: tuple[str, ...]
    """What makes no sense in the bag, a sentence each"""
    bags: tuple[tuple[str, int], ...] = ()
    """Name of each bag, and the number of its samples, where there are several"""

    def without(self, place: int) -> Referenced:
        """Give the same samples without a reference for those of one of the bags."""
        begin = sum(count for _, count in self.bags[:place])
        column = self.answers[AXIAL_FORCE].copy()
        column[begin : begin + self.bags[place][1]] = np.nan
        return replace(self, answers={AXIAL_FORCE: column})


def referenced_in(
    bags: Sequence[Path], parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]
) -> Referenced:
    """Read one or several bags of a person, one after the other; see `referenced`.

    Raises:
        UsageError: as `referenced`, or two bags are the same.
    """
    parts = [referenced(bag, parameters, names, advance) for bag in bags]
    if len(parts) == 1:
        return parts[0]
    for one, other in combinations(parts, 2):
        if one.digest == other.digest:
            fault = (
                f"bags {one.source} and {other.source} are the same: each is left out in turn, and must be a new one"
            )
            raise UsageError(fault)
    left_out = Counter[str]()
    for part in parts:
        left_out.update(part.left_out)
    column = np.concatenate([part.answers[AXIAL_FORCE] for part in parts])
    return Referenced(
        ", ".join(part.source for part in parts), ", ".join(part.digest for part in parts), {AXIAL_FORCE: column},
        tuple(sample for part in parts for sample in part.samples), dict(left_out),
        tuple(doubt for part in parts for doubt in part.doubts),
        tuple((bag.name, len(part.samples)) for bag, part in zip(bags, parts, strict=True)),
    )  # fmt: skip


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
    sensed, topic = sensed_in(bag, parameters, names, advance), names.get(OWN_NAME, OWN_NAME)
    stamps, axial, refused = _reference(bag, topic)
    if not sensed.samples:
        raise UsageError(f"bag {bag}: no ground force has joint angles at its time ({_counted(sensed.refused)})")
    at = np.array([sample.stamp for sample in sensed.samples], dtype=np.int64)
    column = _interpolated(stamps, axial, at, round(parameters.pairing.max_gap * NANOSECONDS))
    flagged = np.array([bool(sample.status & UNUSABLE) for sample in sensed.samples])
    left_out = {"flagged": int(flagged.sum()), "without a reference": int((np.isnan(column) & ~flagged).sum())}
    left_out |= {f"refused as {reason}": count for reason, count in (sensed.refused + refused).items()}
    column[flagged] = np.nan
    if np.isnan(column).all():
        raise UsageError(f"bag {bag}: no sample can be fitted to the reference ({_counted(left_out)})")
    doubts = [*_own_estimate(bag, topic), *others_beside(bag)]
    if sensed.damage:
        doubts.append(f"bag {bag} is damaged, and read as far as it can be: {in_a_line(sensed.damage)}")
    return Referenced(str(bag), bag_digest(bag), {AXIAL_FORCE: column}, tuple(sensed.samples), left_out, tuple(doubts))


def _interpolated(stamps: Stamps, values: Floats, at: Stamps, max_gap: int) -> Floats:
    """Interpolate the reference at the stamps of all samples.

    Args:
        stamps: Stamps of the reference [ns], increasing.
        values: The reference.
        at: Stamps of the samples [ns], shape (n,).
        max_gap: The largest distance [ns] of neighbours between which to interpolate.

    Returns:
        The reference, shape (n,). It is not a number where neighbours are missing or too far apart, and where a
        sample's stamp is not later than all before: of two runs over the same stamps, the first one counts.
    """
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
    try:
        reader = BagReader(bag, {ROLE: MESSAGE_TYPES[JOINT_REACTION_FORCE]}, {ROLE: topic})
    except UsageError as error:
        raise UsageError(f"{error}; --remap {JOINT_REACTION_FORCE}:=TOPIC names a measured joint reaction") from None
    refused, last = Counter[str](), -1
    kept: list[tuple[int, float]] = []
    with reader:
        for message in reader.raw_messages():
            try:
                sample = load_sample(WRENCH.read(message.data, JOINT_REACTION_FORCE)[0])
            except RefusedSampleError as error:
                refused[error.reason] += 1
                continue
            if sample.stamp > last:
                last = sample.stamp
                kept.append((sample.stamp, sample.axial))
            else:
                refused["time_went_back"] += 1
    if not kept:
        raise UsageError(f"bag {bag}: no message on {topic} can be a reference ({_counted(refused)})")
    return np.array([stamp for stamp, _ in kept]), np.array([axial for _, axial in kept]), refused


def _own_estimate(bag: Path, topic: str) -> list[str]:
    """Report a reference that is likely an estimate of our own, as there is a topic `load_estimate` beside it."""
    estimate = topic.removesuffix(JOINT_REACTION_FORCE) + LOAD_ESTIMATE
    if not topic.endswith(OWN_NAME):
        return []
    try:
        BagReader(bag, {estimate: MESSAGE_TYPES[LOAD_ESTIMATE]}).close()
    except UsageError:
        return []
    return [f"the bag also has {estimate}: its {topic} is likely an estimate of the load node, and was not measured"]


def _counted(reasons: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count) or "nothing is refused"


def fittable_in(parameters: LoadParameters) -> Fittable:
    """Give the parameters that can be fitted: the constants of the person."""
    known = known_parameters(LoadParameters)
    names = [name for name in known if name.startswith(SECTION)]

    def why_not(name: str) -> str:
        if name not in known and name in known_parameters():
            return f"it is one of the contact, which is fitted to a table; to a bag {', '.join(names)} are"
        return f"it is none of a person; allowed are {', '.join(names)}" if name in known else ""

    return Fittable(names, known, all_values(parameters), "person.moment_arm_scale", why_not)


@dataclass(frozen=True)
class LoadProblem(Problem):
    """The problem of fitting the constants of a person."""

    measured: Referenced
    parameters: LoadParameters
    """All parameters at the start"""
    level: EstimationLevel
    nets: tuple[NetMoments, ...]
    """Net moments at the n samples; empty where mass or height is free"""

    def answers(self, place: Floats) -> dict[str, Floats]:
        """Compute the estimate `axial_force` [N] at every sample, shape (n,), with the bits of the estimator."""
        person = self.person(place)
        estimator = Estimator(self.parameters.chosen_level, person, self.parameters.trust)
        both = zip(self.measured.samples, self.nets or _net_moments(self.level, person, self.measured), strict=True)
        axial = [estimator.react(each.stamp, each.joints, each.ground, net, each.status)[0].axial for each, net in both]
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, place: Floats) -> dict[str, Floats]:
        """Give the answers, with the samples' stamps as `time` [s]."""
        return {"time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]), **self.answers(place)}

    def doubts(self, place: Floats) -> list[str]:  # noqa: ARG002
        """Report what makes no sense in the bag."""
        return list(self.measured.doubts)

    def remarks(self, place: Floats) -> list[str]:
        """Give the RMS residual in body weights, the correlation with the reference, and counts of samples."""
        reference, answer = self.measured.answers[AXIAL_FORCE], self.answers(place)[AXIAL_FORCE]
        known = np.isfinite(reference)
        one, other = reference[known] - reference[known].mean(), answer[known] - answer[known].mean()
        size = float(np.sqrt((one**2).sum() * (other**2).sum()))
        alike = f", r {float((one * other).sum()) / size:.3f}" if size > 0.0 else ""
        left_out = self.measured.left_out.items()
        counts = [f"{count} {reason}" for reason, count in left_out if count or "refused" not in reason]
        return [
            f"that is {self.relative_rms(place):.3f} body weights{alike}, level {self.parameters.chosen_level}",
            f"samples: {self.measured.number} fitted; left out: {', '.join(counts)}",
            *([] if self.measured.bags else [OTHER_TRIALS]),
        ]

    def also(self, place: Floats) -> dict[str, Any]:
        """Give `calibrated`, and `standard_deviation` in body weights: the RMS residual, within its range."""
        size = min(max(self.relative_rms(place), LEAST_DEVIATION), LARGEST_DEVIATION)
        return {"calibrated": True, "standard_deviation": size}

    def relative_rms(self, place: Floats) -> float:
        """Compute the RMS of the residuals in body weights."""
        misfit = self.misfits(place)[AXIAL_FORCE]
        return float(np.sqrt(np.mean(misfit**2)) / self.person(place).weight)

    def left_out(self, fitted: Callable[[LoadProblem], Floats]) -> list[tuple[str, float, float]]:
        """Fit to all bags but one, for each of several.

        Args:
            fitted: Fits a problem, and gives the place.

        Returns:
            Name of the bag, RMS of its residuals [body weights] by constants of the others, and by those of the start.
        """
        found = []
        for place, (bag, _) in enumerate(self.measured.bags):
            others = replace(self, measured=self.measured.without(place))
            own = np.isfinite(self.measured.answers[AXIAL_FORCE]) & np.isnan(others.measured.answers[AXIAL_FORCE])
            errors = [
                (self.answers(constants)[AXIAL_FORCE] - self.measured.answers[AXIAL_FORCE])[own]
                for constants in (fitted(others), self.start)
            ]
            one, other = (float(np.sqrt(np.mean(error**2))) / self.person(self.start).weight for error in errors)
            found.append((bag, one, other))
        return found

    def person(self, place: Floats) -> Person:
        """Give the constants of the person at a place."""
        values = {name.removeprefix(SECTION): value for name, value in self.values(place).items()}
        return self.parameters.person.constants._replace(**values)


def load_problem_of(parameters: LoadParameters, measured: Referenced, unknowns: tuple[Unknown, ...]) -> LoadProblem:
    """Make the problem, and compute once what does not depend on free parameters.

    Raises:
        UsageError: there are not more samples than free parameters.
    """
    if measured.number <= len(unknowns):
        raise UsageError(f"bag {measured.source}: {measured.number} samples can be fitted, for {len(unknowns)} "
                         "parameters; more are needed than parameters are free")  # fmt: skip
    level, moves = LEVELS[parameters.chosen_level], any(unknown.name in BODY for unknown in unknowns)
    nets = () if moves else _net_moments(level, parameters.person.constants, measured)
    return LoadProblem(measured, unknowns, np.full(len(unknowns), STEP), parameters, level, nets)


def _net_moments(level: EstimationLevel, person: Person, measured: Referenced) -> tuple[NetMoments, ...]:
    """Compute the net moments at knee and ankle of a person at every sample."""
    leg = leg_of(person.mass, person.height)
    return tuple(level.dynamics(leg, each.joints, each.motion, each.ground) for each in measured.samples)
