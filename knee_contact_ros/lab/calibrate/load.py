"""The problem of fitting a person's constants of the load estimate to a measured joint reaction in a bag."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import bag_digest
from knee_contact_ros.bags.reader import BagReader, Names, others_beside
from knee_contact_ros.joint_reaction.estimator import LEVELS, EstimationLevel, Estimator
from knee_contact_ros.joint_reaction.leg import NetMoments, leg_of
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.lab.calibrate.problem import STEP, Conclusions, Data, Problem, Unknown
from knee_contact_ros.model.types import UNUSABLE, Floats
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.parameters.files import known_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.contact_stream import load_sample
from knee_contact_ros.streams.load_stream import Sensed
from knee_contact_ros.streams.messages import WRENCH, RefusedSampleError
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, LOAD_ESTIMATE, MESSAGE_TYPES, NANOSECONDS
from knee_contact_ros.system.errors import UsageError, in_a_line

Stamps = NDArray[np.int64]
AXIAL_FORCE = "axial_force"
OWN_NAME, ROLE = f"/{JOINT_REACTION_FORCE}", "/reference"
"""Default topic of the reference, and a role of its own, so that no other force is read in its place"""
SECTION = "person."
FITTABLE = [name for name in known_parameters(LoadParameters) if name.startswith(SECTION)]
"""Parameters that may be free: the constants of a person"""
LEAST_GAIN = 1e-3
"""The least reduction of the error [body weights] that counts"""
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
    left_out: Mapping[str, int]
    """Number of samples that are left out, by the reason"""
    doubts: tuple[str, ...]
    """What makes no sense in the bags, a sentence each"""
    bags: tuple[tuple[str, int], ...]
    """Name of each bag, and the number of its samples"""

    def without(self, place: int) -> Referenced:
        """Give the same samples without a reference for those of one of the bags."""
        begin = sum(count for _, count in self.bags[:place])
        column = self.answers[AXIAL_FORCE].copy()
        column[begin : begin + self.bags[place][1]] = np.nan
        return replace(self, answers={AXIAL_FORCE: column})


def referenced(
    bags: Sequence[Path], parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]
) -> Referenced:
    """Read bags of a person; samples that are flagged, or have no reference at their stamps, are left out.

    The reference at a stamp is interpolated between its neighbours, if they are not further than `pairing.max_gap`
    apart.

    Args:
        bags: Paths of the bags.
        parameters: Parameters of the load node.
        names: Names of the bags' three topics.
        advance: Called with the amount that is read of a bag, and that of all.

    Raises:
        UsageError: a bag cannot be used, a topic is missing, no sample of it is left, or two bags are the same.
    """
    digests = [bag_digest(bag) for bag in bags]
    for one, other in combinations(range(len(bags)), 2):
        if digests[one] == digests[other]:
            fault = f"bags {bags[one]} and {bags[other]} are the same"
            raise UsageError(f"{fault}: each is left out in turn, and must be a new one")
    topic, left_out = names.get(OWN_NAME, OWN_NAME), Counter[str]()
    samples: list[Sensed] = []
    columns, counts, doubts = list[Floats](), list[tuple[str, int]](), list[str]()
    for bag in bags:
        begin = len(samples)
        summary = estimate_load(
            bag, parameters, None, advance, names=names, keep=lambda stream: samples.append(stream.sensed)
        )
        stamps, axial, refused = _reference(bag, topic)
        column = _interpolated(stamps, axial, summary.stamps, round(parameters.pairing.max_gap * NANOSECONDS))
        flagged = np.array([bool(sample.status & UNUSABLE) for sample in samples[begin:]])
        reasons = {"flagged": int(flagged.sum()), "without a reference": int((np.isnan(column) & ~flagged).sum())}
        reasons |= {f"refused as {reason}": count for reason, count in (summary.refused + refused).items()}
        column[flagged] = np.nan
        if np.isnan(column).all():
            raise UsageError(f"bag {bag}: no sample can be fitted to the reference ({_counted(reasons)})")
        left_out.update(reasons)
        doubts += [*_own_estimate(bag, topic), *others_beside(bag)]
        if summary.damage:
            doubts.append(f"bag {bag} is damaged, and read as far as it can be: {in_a_line(summary.damage)}")
        columns.append(column)
        counts.append((bag.name, len(column)))
    return Referenced(
        ", ".join(map(str, bags)), ", ".join(digests), {AXIAL_FORCE: np.concatenate(columns)},
        tuple(samples), left_out, tuple(doubts), tuple(counts),
    )  # fmt: skip


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
    gaps = np.concatenate(([0], np.diff(stamps), [0]))[np.searchsorted(stamps, at)]
    first = stamps[0]
    found = np.interp(at - first, stamps - first, values, left=np.nan, right=np.nan)
    return np.where(later & ((gaps <= max_gap) | np.isin(at, stamps)), found, np.nan)


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
        estimator = Estimator(self.parameters.chosen_level, person)
        both = zip(self.measured.samples, self.nets or _net_moments(self.level, person, self.measured), strict=True)
        axial = [estimator.react(each.stamp, each.joints, each.ground, net, each.status)[0].axial for each, net in both]
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, place: Floats) -> dict[str, Floats]:
        """Give the answers, with the samples' stamps as `time` [s]."""
        return {"time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]), **self.answers(place)}

    def doubts(self, place: Floats) -> list[str]:  # noqa: ARG002
        """Report what makes no sense in the bag."""
        return list(self.measured.doubts)

    def conclusions(self, place: Floats, fitted: Callable[[Problem], Floats]) -> Conclusions:
        """Say how far off the estimate is, and what the person gains; several bags are left out in turn.

        The file is `calibrated`, with the error as `standard_deviation`, if that is less than with the constants of
        the start.
        """
        data, several = self.measured, len(self.measured.bags) > 1
        reference, answer = data.answers[AXIAL_FORCE], self.answers(place)[AXIAL_FORCE]
        known = np.isfinite(reference)
        with np.errstate(invalid="ignore"):
            r = float(np.corrcoef(reference[known], answer[known])[0, 1])
        counts = [f"{count} {reason}" for reason, count in data.left_out.items() if count or "refused" not in reason]
        remarks = [
            f"that is {self.error(place):.3f} body weights{f', r {r:.3f}' if math.isfinite(r) else ''}, "
            f"level {self.parameters.chosen_level}",
            f"samples: {data.number} fitted; left out: {', '.join(counts)}",
        ]
        own, start = self.error(place), self.error(self.start)
        if several:
            own, start, lines = self._left_out(fitted)
            remarks += lines
        if not start - own >= LEAST_GAIN:
            unseen = " in a bag that it has not seen" if several else ""
            doubt = f"calibrating gains nothing: the error is {own:.3f} body weights{unseen}, and {start:.3f} with the"
            return Conclusions(remarks, {}, [f"{doubt} constants of the start; so the file does not say calibrated"])
        deviation = min(max(own, LEAST_DEVIATION), LARGEST_DEVIATION)
        remarks += [] if several else [OTHER_TRIALS]
        return Conclusions(remarks, {"calibrated": True, "standard_deviation": deviation}, [])

    def error(self, place: Floats, within: NDArray[np.bool_] | None = None) -> float:
        """RMS [body weights] of the estimate's error, where there is a reference, or within some samples alone."""
        error = self.answers(place)[AXIAL_FORCE] - self.measured.answers[AXIAL_FORCE]
        return float(np.sqrt(np.nanmean(error[within] ** 2))) / self.person(place).weight

    def _left_out(self, fitted: Callable[[Problem], Floats]) -> tuple[float, float, list[str]]:
        """Give the RMS errors in bags that were left out, by constants of the others and of the start; and lines."""
        errors, lines = [], []
        for place, (bag, _) in enumerate(self.measured.bags):
            others = replace(self, measured=self.measured.without(place))
            within = np.isnan(others.measured.answers[AXIAL_FORCE])
            own, start = self.error(fitted(others), within), self.error(self.start, within)
            errors.append((own, start))
            lines.append(f"bag {bag}: {own:.3f} body weights with constants of the other bags, {start:.3f} with those "
                         "of the start")  # fmt: skip
        own, start = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
        gain = f"calibrating takes the error from {start:.3f} to {own:.3f} body weights in a bag that it has not seen"
        return own, start, [*lines, gain]

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
