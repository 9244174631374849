"""The problem of fitting a person's constants of the load estimate to a measured joint reaction in a bag."""

from __future__ import annotations

import math
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
from knee_contact_ros.joint_reaction.estimator import LEVELS, Estimator
from knee_contact_ros.joint_reaction.leg import NetMoments, leg_of
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.lab.calibrate.fit import Data, Problem, Unknown, Values
from knee_contact_ros.model.types import UNUSABLE, Floats
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.parameters.files import known_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.contact_stream import load_sample
from knee_contact_ros.streams.load_stream import Sensed
from knee_contact_ros.streams.messages import WRENCH, RefusedSampleError
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, LOAD_ESTIMATE, MESSAGE_TYPES, NANOSECONDS
from knee_contact_ros.system.errors import UsageError, in_a_line

AXIAL_FORCE = "axial_force"
OWN_NAME, ROLE = f"/{JOINT_REACTION_FORCE}", "/reference"
"""Default topic of the reference, and its role, which keeps other forces from being read instead"""
SECTION = "person."
FITTABLE = [name for name in known_parameters(LoadParameters) if name.startswith(SECTION)]
"""Parameters that may be free: the constants of a person"""
LEAST_GAIN = 1e-3
"""Smallest reduction of the error [body weights] that counts"""
BODY = ("person.mass", "person.height")
"""Parameters on which the net moments depend"""
LEAST_DEVIATION, LARGEST_DEVIATION = 0.01, 10.0
"""Range of the parameter `standard_deviation` [body weights]"""
OTHER_TRIALS = (
    "standard_deviation is the RMS error on these data; on another trial of the same person it was up to 1.4 "
    "times as large (docs/how-to/uncertainty-and-calibration.md)"
)


@dataclass(frozen=True)
class Referenced(Data):
    """The n samples of a leg's sensors, one for each ground force, and the joint reaction at their stamps.

    The answer is `axial_force` [N], shape (n,): the reference; NaN at samples that are left out.
    """

    samples: tuple[Sensed, ...]
    """All n samples"""
    left_out: Mapping[str, int]
    """Number of samples left out, by reason"""
    doubts: tuple[str, ...]
    """What is implausible in the bags, a sentence each"""
    bags: tuple[tuple[str, int], ...]
    """Name and number of samples of each bag"""


def referenced(
    bags: Sequence[Path], parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]
) -> Referenced:
    """Read bags of a person; leave out samples that are flagged or have no reference at their stamps.

    The reference is interpolated between neighbours that are at most `pairing.max_gap` apart. If two runs have the
    same stamps, the first one counts.

    Args:
        bags: Paths of the bags.
        parameters: Parameters of the load node.
        names: Names of the bags' three topics.
        advance: Called with the amount read of a bag, and the whole amount.

    Raises:
        UsageError: a bag cannot be used, a topic is missing or has no usable sample, or two bags are the same.
    """
    digests = [bag_digest(bag) for bag in bags]
    for one, other in combinations(range(len(bags)), 2):
        if digests[one] == digests[other]:
            fault = f"bags {bags[one]} and {bags[other]} are the same"
            raise UsageError(f"{fault}: each bag is left out in turn, so each must be a different one")
    topic, left_out = names.get(OWN_NAME, OWN_NAME), Counter[str]()
    samples, columns, counts, doubts = list[Sensed](), list[Floats](), list[tuple[str, int]](), list[str]()
    max_gap = round(parameters.pairing.max_gap * NANOSECONDS)
    for bag in bags:
        begin = len(samples)
        summary = estimate_load(
            bag, parameters, None, advance, names=names, keep=lambda stream: samples.append(stream.sensed)
        )
        stamps, axial, refused = _reference(bag, topic)
        at = summary.stamps
        later = at > np.maximum.accumulate(np.concatenate(([-1], at[:-1])))
        gaps = np.diff(stamps, prepend=stamps[0], append=stamps[-1])[np.searchsorted(stamps, at)]
        column = np.interp(at - stamps[0], stamps - stamps[0], axial, left=np.nan, right=np.nan)
        column[~(later & ((gaps <= max_gap) | np.isin(at, stamps)))] = np.nan
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
    source = f"bag {', '.join(map(str, bags))}"
    answers = {AXIAL_FORCE: np.concatenate(columns)}
    return Referenced(source, ", ".join(digests), answers, tuple(samples), left_out, tuple(doubts), tuple(counts))


def _reference(bag: Path, topic: str) -> tuple[NDArray[np.int64], Floats, Counter[str]]:
    """Read increasing stamps [ns] and axial forces [N] of the reference, and count refused samples by the reason."""
    try:
        reader = BagReader(bag, {ROLE: MESSAGE_TYPES[JOINT_REACTION_FORCE]}, {ROLE: topic})
    except UsageError as error:
        raise UsageError(f"{error}; --remap {JOINT_REACTION_FORCE}:=TOPIC names a measured joint reaction") from None
    refused, kept = Counter[str](), dict[int, float]()
    with reader:
        for message in reader.raw_messages():
            try:
                sample = load_sample(WRENCH.read(message.data, JOINT_REACTION_FORCE)[0])
            except RefusedSampleError as error:
                refused[error.reason] += 1
                continue
            if kept and sample.stamp <= next(reversed(kept)):
                refused["time_went_back"] += 1
            else:
                kept[sample.stamp] = sample.axial
    if not kept:
        raise UsageError(f"bag {bag}: no message on {topic} can be a reference ({_counted(refused)})")
    return np.array(list(kept)), np.array(list(kept.values())), refused


def _own_estimate(bag: Path, topic: str) -> list[str]:
    """Report a reference that is likely our own estimate, as its bag also has a topic `load_estimate`."""
    estimate = topic.removesuffix(JOINT_REACTION_FORCE) + LOAD_ESTIMATE
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
    nets: tuple[NetMoments, ...]
    """Net moments at the n samples; empty where mass or height is free"""

    def person(self, values: Values) -> Person:
        """Return the constants of a person."""
        return self.parameters.person.constants._replace(
            **{name.removeprefix(SECTION): value for name, value in values.items()}
        )

    def answers(self, values: Values) -> dict[str, Floats]:
        """Compute the estimate `axial_force` [N] at every sample, shape (n,), bit for bit as the estimator does."""
        person, level = self.person(values), self.parameters.chosen_level
        estimator, nets = Estimator(level, person), self.nets or _net_moments(level, person, self.measured.samples)
        axial = [estimator.react(each.stamp, each.joints, each.ground, net, each.status)[0].axial
                 for each, net in zip(self.measured.samples, nets, strict=True)]  # fmt: skip
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, values: Values) -> dict[str, Floats]:
        """Return the answers, with the samples' stamps as `time` [s]."""
        return {"time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]), **self.answers(values)}

    def conclusions(
        self, values: Values, refit: Callable[[Problem], Values]
    ) -> tuple[list[str], dict[str, Any], list[str]]:
        """Report the error of the estimate and what the fit gains; several bags are left out in turn.

        The file gets `calibrated`, and the error as `standard_deviation`, if the error is smaller than with the
        constants of the start.
        """
        data, several = self.measured, len(self.measured.bags) > 1
        reference, answer = data.answers[AXIAL_FORCE], self.answers(values)[AXIAL_FORCE]
        known, begun = np.isfinite(reference), {unknown.name: unknown.start for unknown in self.unknowns}
        with np.errstate(invalid="ignore"):
            r = float(np.corrcoef(reference[known], answer[known])[0, 1])
        own, start = self.error(values, known), self.error(begun, known)
        counts = [f"{count} {reason}" for reason, count in data.left_out.items() if count or "refused" not in reason]
        remarks = [
            f"that is {own:.3f} body weights{f', r {r:.3f}' if math.isfinite(r) else ''}, "
            f"level {self.parameters.chosen_level}",
            f"samples: {data.number} fitted; left out: {', '.join(counts)}",
        ]
        if several:
            errors, end = [], 0
            for bag, count in data.bags:
                within, end = np.zeros_like(known), end + count
                within[end - count : end] = known[end - count : end]
                others = replace(data, answers={AXIAL_FORCE: np.where(within, np.nan, reference)})
                errors.append((self.error(refit(replace(self, measured=others)), within), self.error(begun, within)))
                own, start = errors[-1]
                remarks.append(f"bag {bag}: {own:.3f} body weights with constants of the other bags, {start:.3f} with "
                               "those of the start")  # fmt: skip
            own, start = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
            remarks.append(f"calibrating takes the error from {start:.3f} to {own:.3f} body weights in a bag that it "
                           "has not seen")  # fmt: skip
        if not start - own >= LEAST_GAIN:
            unseen = " in a bag that it has not seen" if several else ""
            doubt = f"calibrating gains nothing: the error is {own:.3f} body weights{unseen}, and {start:.3f} with the"
            return remarks, {}, [*data.doubts, f"{doubt} constants of the start; so the file does not say calibrated"]
        deviation = min(max(own, LEAST_DEVIATION), LARGEST_DEVIATION)
        remarks += [] if several else [OTHER_TRIALS]
        return remarks, {"calibrated": True, "standard_deviation": deviation}, list(data.doubts)

    def error(self, values: Values, within: NDArray[np.bool_]) -> float:
        """RMS error of the estimate [body weights] at some samples with a reference."""
        error = self.answers(values)[AXIAL_FORCE] - self.measured.answers[AXIAL_FORCE]
        return float(np.sqrt(np.mean(error[within] ** 2))) / self.person(values).weight


def load_problem_of(parameters: LoadParameters, measured: Referenced, unknowns: tuple[Unknown, ...]) -> LoadProblem:
    """Make the problem, and compute once whatever does not depend on free parameters."""
    moves, level = any(unknown.name in BODY for unknown in unknowns), parameters.chosen_level
    nets = () if moves else _net_moments(level, parameters.person.constants, measured.samples)
    return LoadProblem(measured, unknowns, parameters, nets)


def _net_moments(level: str, person: Person, samples: Sequence[Sensed]) -> tuple[NetMoments, ...]:
    """Compute the net moments at knee and ankle of a person at every sample."""
    leg = leg_of(person.mass, person.height)
    return tuple(LEVELS[level].dynamics(leg, each.joints, each.motion, each.ground) for each in samples)
