"""Fit a person's constants of the load estimate to a measured joint reaction in a bag."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bags.bag import Bag
from ...bags.folder import bag_digest, others_beside
from ...bags.names import Names
from ...joint_reaction.estimator import LOAD_LEVELS, Estimator
from ...joint_reaction.leg import NetMoments, leg_of
from ...joint_reaction.muscles import Person
from ...model.types import UNUSABLE, Floats
from ...offline.estimate_load import LoadSummary, estimate_load
from ...parameters.files import known_parameters
from ...parameters.load_schema import LoadParameters
from ...streams.contact_pipeline import load_sample
from ...streams.load_pipeline import Sensed
from ...streams.messages import WRENCH, RefusedSampleError
from ...streams.topics import (
    JOINT_REACTION_FORCE,
    LOAD_ESTIMATE,
    MESSAGE_TYPES,
    NANOSECONDS,
)
from ...system.errors import UsageError, join_faults
from ...system.progress import OnProgress
from .fit import Conclusions, Data, FitProblem, ParameterValues
from .unknowns import Unknown

AXIAL_FORCE = "axial_force"
"""Column to which the estimate is fitted [N]"""
REFERENCE_TOPIC = f"/{JOINT_REACTION_FORCE}"
"""Default topic of the reference"""
REFERENCE_ROLE = "/reference"
"""Role of the reference's topic, which keeps other forces from being read instead"""
PERSON = "person."
FITTABLE = [name for name in known_parameters(LoadParameters) if name.startswith(PERSON)]
"""Parameters that may be free: the constants of a person"""
MIN_GAIN = 1e-3
"""Smallest reduction of the error [body weights] that counts"""
BODY_PARAMETERS = ("person.mass", "person.height")
"""Parameters on which the net moments depend"""
DEVIATION_RANGE = (0.01, 10.0)
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


def read_referenced(
    bags: Sequence[Path], parameters: LoadParameters, names: Names, advance: OnProgress
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
    for place, own in enumerate(digests):
        first = digests.index(own)
        if first < place:
            fault = f"bags {bags[first]} and {bags[place]} are the same"
            raise UsageError(
                f"{fault}: each bag is left out in turn, so each must be a different one"
            )
    trials = [_read_trial(bag, parameters, names, advance) for bag in bags]
    left_out = Counter[str]()
    for trial in trials:
        left_out.update(trial.left_out)
    return Referenced(
        f"bag {', '.join(map(str, bags))}",
        ", ".join(digests),
        {AXIAL_FORCE: np.concatenate([trial.axial for trial in trials])},
        tuple(sample for trial in trials for sample in trial.samples),
        left_out,
        tuple(doubt for trial in trials for doubt in trial.doubts),
        tuple((bag.name, len(trial.samples)) for bag, trial in zip(bags, trials, strict=True)),
    )


class _Trial(NamedTuple):
    """What a bag holds; see `Referenced`."""

    samples: list[Sensed]
    axial: Floats
    left_out: dict[str, int]
    doubts: list[str]


def _read_trial(
    path: Path, parameters: LoadParameters, names: Names, advance: OnProgress
) -> _Trial:
    topic = names.get(REFERENCE_TOPIC, REFERENCE_TOPIC)
    with Bag(path) as bag:
        samples, summary, doubts = read_sensors(bag, parameters, names, advance)
        stamps, axial, refused = _reference(bag, topic)
        doubts = [*_own_estimate(bag, topic), *doubts]
    at = summary.stamps
    first_of_its_stamp = at > np.maximum.accumulate(np.concatenate(([-1], at[:-1])))
    gaps = np.diff(stamps, prepend=stamps[0], append=stamps[-1])[np.searchsorted(stamps, at)]
    near = gaps <= round(parameters.pairing.max_gap * NANOSECONDS)
    column = np.interp(at - stamps[0], stamps - stamps[0], axial, left=np.nan, right=np.nan)
    column[~(first_of_its_stamp & (near | np.isin(at, stamps)))] = np.nan
    flagged = np.array([bool(sample.status & UNUSABLE) for sample in samples])
    left_out = {
        "flagged": int(flagged.sum()),
        "without a reference": int((np.isnan(column) & ~flagged).sum()),
    }
    for reason, count in (summary.refused + refused).items():
        left_out[f"refused as {reason}"] = count
    column[flagged] = np.nan
    if np.isnan(column).all():
        raise UsageError(
            f"bag {path}: no sample can be fitted to the reference ({_join_counts(left_out)})"
        )
    return _Trial(samples, column, left_out, doubts)


def read_sensors(
    bag: Bag, parameters: LoadParameters, names: Names, advance: OnProgress
) -> tuple[list[Sensed], LoadSummary, list[str]]:
    """Read the samples of a leg's sensors; also what they come to, and what is odd or damaged, a sentence each."""
    samples = list[Sensed]()
    summary = estimate_load(
        bag,
        parameters,
        None,
        advance,
        names=names,
        keep=lambda answer: samples.append(answer.sensed),
    )
    doubts = others_beside(bag.path)
    if summary.damage:
        faults = join_faults(summary.damage)
        doubts.append(f"bag {bag.path} is damaged, and read as far as it can be: {faults}")
    return samples, summary, doubts


def _reference(bag: Bag, topic: str) -> tuple[NDArray[np.int64], Floats, Counter[str]]:
    """Read increasing stamps [ns] and axial forces [N] of the reference, and count refused samples by the reason."""
    try:
        reader = bag.select(
            {REFERENCE_ROLE: MESSAGE_TYPES[JOINT_REACTION_FORCE]}, {REFERENCE_ROLE: topic}
        )
    except UsageError as error:
        raise UsageError(
            f"{error}; --remap {JOINT_REACTION_FORCE}:=TOPIC names a measured joint reaction"
        ) from None
    refused = Counter[str]()
    forces = dict[int, float]()
    for message in reader.raw_messages():
        try:
            sample = load_sample(WRENCH.read_message(message.data, JOINT_REACTION_FORCE)[0])
        except RefusedSampleError as error:
            refused[error.reason] += 1
            continue
        if forces and sample.stamp <= next(reversed(forces)):
            refused["time_went_back"] += 1
        else:
            forces[sample.stamp] = sample.axial
    if not forces:
        raise UsageError(
            f"bag {bag.path}: no message on {topic} can be a reference ({_join_counts(refused)})"
        )
    return np.array(list(forces)), np.array(list(forces.values())), refused


def _own_estimate(bag: Bag, topic: str) -> list[str]:
    """Report a reference that is likely our own estimate, as its bag also has a topic `load_estimate`."""
    estimate = topic.removesuffix(JOINT_REACTION_FORCE) + LOAD_ESTIMATE
    try:
        bag.select({estimate: MESSAGE_TYPES[LOAD_ESTIMATE]})
    except UsageError:
        return []
    return [
        f"the bag also has {estimate}: its {topic} is likely an estimate of the load node, and was not measured"
    ]


def _join_counts(reasons: Mapping[str, int]) -> str:
    counts = [f"{count} {reason}" for reason, count in reasons.items() if count]
    return ", ".join(counts) or "nothing is refused"


@dataclass(frozen=True)
class LoadProblem(FitProblem):
    """The problem of fitting the constants of a person."""

    measured: Referenced
    parameters: LoadParameters
    """All parameters at the start"""
    nets: tuple[NetMoments, ...]
    """Net moments at the n samples; empty where mass or height is free"""

    def person(self, values: ParameterValues) -> Person:
        """Return the constants of a person."""
        return self.parameters.person.constants._replace(
            **{name.removeprefix(PERSON): value for name, value in values.items()}
        )

    def answers(self, values: ParameterValues) -> dict[str, Floats]:
        """Compute the estimate `axial_force` [N] at every sample, shape (n,), bit for bit as the estimator does."""
        person = self.person(values)
        level = self.parameters.chosen_level
        nets = self.nets or _net_moments(level, person, self.measured.samples)
        estimator = Estimator(level, person)
        axial = [
            estimator.react(each.stamp, each.joints, each.ground, net, each.status)[0].axial
            for each, net in zip(self.measured.samples, nets, strict=True)
        ]
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, values: ParameterValues) -> dict[str, Floats]:
        """Return the answers, with the samples' stamps as `time` [s]."""
        return {
            "time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]),
            **self.answers(values),
        }

    def conclusions(
        self, values: ParameterValues, refit: Callable[[FitProblem], ParameterValues]
    ) -> Conclusions:
        """Report the error of the estimate and what the fit gains; several bags are left out in turn.

        The file gets `calibrated`, and the error as `standard_deviation`, if the error is smaller than with the
        constants of the start.
        """
        data = self.measured
        reference = data.answers[AXIAL_FORCE]
        known = np.isfinite(reference)
        start = {unknown.name: unknown.start for unknown in self.unknowns}
        error = self.error(values, known)
        start_error = self.error(start, known)
        with np.errstate(invalid="ignore"):
            answer = self.answers(values)[AXIAL_FORCE]
            r = float(np.corrcoef(reference[known], answer[known])[0, 1])
        correlation = f", r {r:.3f}" if math.isfinite(r) else ""
        left_out = [
            f"{count} {reason}"
            for reason, count in data.left_out.items()
            if count or "refused" not in reason
        ]
        remarks = [
            f"that is {error:.3f} body weights{correlation}, level {self.parameters.chosen_level}",
            f"samples: {data.number} fitted; left out: {', '.join(left_out)}",
        ]
        unseen = ""
        if len(data.bags) > 1:
            unseen = " in a bag that it has not seen"
            errors = []
            counts = [count for _, count in data.bags]
            bag_of_sample = np.repeat(np.arange(len(counts)), counts)
            for place, (bag, _) in enumerate(data.bags):
                within = known & (bag_of_sample == place)
                others = replace(data, answers={AXIAL_FORCE: np.where(within, np.nan, reference)})
                refitted = self.error(refit(replace(self, measured=others)), within)
                errors.append((refitted, self.error(start, within)))
                remarks.append(
                    f"bag {bag}: {refitted:.3f} body weights with constants of the other bags, "
                    f"{errors[-1][1]:.3f} with those of the start"
                )
            error, start_error = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
            remarks.append(
                f"calibrating takes the error from {start_error:.3f} to {error:.3f} body weights{unseen}"
            )
        if not start_error - error >= MIN_GAIN:
            doubt = (
                f"calibrating gains nothing: the error is {error:.3f} body weights{unseen}, and {start_error:.3f} "
                "with the constants of the start; so the file does not say calibrated"
            )
            return Conclusions(remarks, {}, [*data.doubts, doubt])
        if not unseen:
            remarks.append(OTHER_TRIALS)
        deviation = float(np.clip(error, *DEVIATION_RANGE))
        parameters = {"calibrated": True, "standard_deviation": deviation}
        return Conclusions(remarks, parameters, list(data.doubts))

    def error(self, values: ParameterValues, within: NDArray[np.bool_]) -> float:
        """RMS error of the estimate [body weights] at some samples with a reference."""
        error = self.answers(values)[AXIAL_FORCE] - self.measured.answers[AXIAL_FORCE]
        return float(np.sqrt(np.mean(error[within] ** 2))) / self.person(values).weight


def make_load_problem(
    parameters: LoadParameters, measured: Referenced, unknowns: tuple[Unknown, ...]
) -> LoadProblem:
    """Make the problem, and compute once whatever does not depend on free parameters."""
    nets: tuple[NetMoments, ...] = ()
    if not any(unknown.name in BODY_PARAMETERS for unknown in unknowns):
        person = parameters.person.constants
        nets = _net_moments(parameters.chosen_level, person, measured.samples)
    return LoadProblem(measured, unknowns, parameters, nets)


def _net_moments(level: str, person: Person, samples: Sequence[Sensed]) -> tuple[NetMoments, ...]:
    """Compute the net moments at knee and ankle of a person at every sample."""
    leg = leg_of(person.mass, person.height)
    return tuple(
        LOAD_LEVELS[level].dynamics(leg, each.joints, each.motion, each.ground) for each in samples
    )
