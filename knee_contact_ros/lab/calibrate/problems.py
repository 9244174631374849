"""The two problems that `calibrate` fits.

The contact model of a compartment to a table of what was measured of it, and a person's constants of the load estimate
to a measured joint reaction in a bag.
"""

from __future__ import annotations

import math
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.folder import bag_digest, others_beside
from knee_contact_ros.bags.names import Names
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, Estimator
from knee_contact_ros.joint_reaction.leg import NetMoments, leg_of
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.lab.calibrate.fit import Data, Problem, Values
from knee_contact_ros.lab.calibrate.unknowns import Unknown
from knee_contact_ros.lab.gait_bag import digest
from knee_contact_ros.lab.headers import TableFormat, header_of
from knee_contact_ros.lab.tables import read_numbers
from knee_contact_ros.lab.units import check_unit
from knee_contact_ros.model.kernel import worth_compiling
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import UNUSABLE, Floats, Status
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.parameters.build import build_model, contact_pair, retuned
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.files import flat_parameters, known_parameters, load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.results import Results
from knee_contact_ros.streams.contact_pipeline import load_sample
from knee_contact_ros.streams.load_pipeline import Sensed
from knee_contact_ros.streams.messages import WRENCH, RefusedSampleError
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    LOAD_ESTIMATE,
    MESSAGE_TYPES,
    NANOSECONDS,
)
from knee_contact_ros.system.errors import UsageError, join_faults, suggest
from knee_contact_ros.system.progress import OnProgress

TIME, ANGLE, LOAD, AXIAL_LOAD, HEIGHT = (
    "time",
    "flexion_angle",
    "load",
    "axial_load",
    "femoral_height",
)
ANSWERS: dict[str, str] = {"penetration_depth": "m", "contact_force": "N", "gap": "m", HEIGHT: "m"}
"""Columns to which the model is fitted, with their units; the height only where it is not prescribed"""
INPUTS = {TIME: "s", ANGLE: "rad", LOAD: "N", AXIAL_LOAD: "N"}
COLUMNS = (*INPUTS, *ANSWERS)
SHARE = "load.share"
SECTIONS = ("femur.", "tibia.", "contact.")
FINE = 1e-9
"""Tolerance of the depth [m] while fitting: the model's error must be far below that of the measurement"""
RUNS = 300
"""Approximate number of runs of the model that a fit takes for each free parameter"""


@dataclass(frozen=True)
class Measured(Data):
    """Inputs and measured answers of a trial of n samples; for the answers' names see `ANSWERS`."""

    time: Floats
    """Time [s], shape (n,), increasing"""
    angle: Floats
    """Flexion angle [rad], shape (n,)"""
    load: Floats
    """Compressive load of the compartment, or axial load, [N], shape (n,)"""
    axial: bool
    """Whether the load is the axial joint reaction, of which the compartment bears `load.share`"""
    height: Floats | None
    """Prescribed femoral height [m], shape (n,); None with drive force"""

    def load_of(self, share: float) -> Floats:
        """Return the load of the compartment [N]: the `share` of an axial load, or the measured load itself."""
        return share * self.load if self.axial else self.load


def read_measured(path: Path, drive: str) -> Measured:
    """Read a trial from a text table, as `import-csv` does; an empty cell or nan means that nothing was measured.

    Columns are `time` [s], `flexion_angle` [rad], `load` or `axial_load` [N]
    or, with drive displacement, `femoral_height` [m]; and one or more of `ANSWERS`.

    Raises:
        UsageError: the file cannot be read or is not such a table, or values make no sense.
    """
    header = header_of(path, COLUMNS, TableFormat())
    numbers, said, _ = read_numbers(
        header, [header.place(name) for name in header.names], TableFormat()
    )
    measured = measured_from(dict(zip(header.names, numbers.T, strict=True)), drive, str(path))
    for place, name in enumerate(header.names):
        unit = (INPUTS | ANSWERS)[name]
        for note in check_unit(path, name, said.get(place, ""), unit, "it must be in", cure=""):
            warnings.warn(note, stacklevel=2)
    return replace(measured, digest=digest(path))


def measured_from(
    table: Mapping[str, ArrayLike] | Any, drive: str, source: str = "table"
) -> Measured:
    """Make a trial from columns by name: a mapping of arrays of shape (n,), or a data frame; see `read_measured`.

    Args:
        table: The columns.
        drive: The parameter `drive`: force or displacement.
        source: Name of the table, for messages.

    Raises:
        UsageError: columns are missing, or values make no sense.
    """
    columns = {str(name): _column(table, name, source) for name in table}
    loads = [name for name in (LOAD, AXIAL_LOAD) if name in columns]
    if len(loads) == 2:
        raise UsageError(
            f"{source}: columns load and axial_load are both there; give the one that was measured"
        )
    inputs = [TIME, ANGLE, *([HEIGHT] if drive == "displacement" else []), *loads]
    inputs += [LOAD] if drive != "displacement" and not loads else []
    for name in inputs:
        if name not in columns:
            raise UsageError(
                f"{source}: it has no column {name}, which drive {drive} needs; it has "
                f"{', '.join(columns) or 'none'}"
            )
    measurable = [name for name in ANSWERS if name not in inputs]
    answers = {name: columns[name] for name in measurable if name in columns}
    if not answers:
        raise UsageError(
            f"{source}: nothing is measured in it; one or more of the columns {', '.join(measurable)} "
            "are needed"
        )
    if len({len(column) for column in columns.values()}) > 1 or not len(columns[TIME]):
        raise UsageError(f"{source}: its columns must be equally long, with one sample or more")
    for name in (*inputs, *answers):
        column = columns[name]
        wrong = ~np.isfinite(column) if name in inputs else np.isinf(column)
        if wrong.any():
            what = (
                "an input must be known at every sample"
                if name in inputs
                else "allowed are numbers and empty cells"
            )
            where = f"column {name} is {column[wrong][0]:g} in row {int(wrong.argmax()) + 1}"
            raise UsageError(f"{source}: {where}; {what}")
        if np.isnan(column).all():
            raise UsageError(
                f"{source}: column {name} is empty; leave it out, or give what was measured"
            )
    time = columns[TIME]
    if (back := np.diff(np.rint(time * 1e9)) <= 0.0).any():
        row = int(back.argmax()) + 2
        raise UsageError(
            f"{source}: column {TIME} must increase, by a nanosecond or more; row {row} does not"
        )
    load = columns[loads[0]] if loads else np.zeros(len(time))
    height = columns[HEIGHT] if HEIGHT in inputs else None
    return Measured(source, "", answers, time, columns[ANGLE], load, loads == [AXIAL_LOAD], height)


def _column(table: Any, name: Any, source: str) -> Floats:
    """Copy a column as numbers."""
    if str(name) not in COLUMNS:
        raise UsageError(
            f"{source}: column {name or repr(name)} is not known; {suggest(str(name), COLUMNS)}"
        )
    try:
        column = np.array(table[name], dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"{source}: column {name} must hold numbers") from None
    if column.ndim != 1:
        raise UsageError(f"{source}: column {name} has shape {column.shape}; allowed is (n,)")
    return column


def fittable() -> list[str]:
    """Names of the parameters that may be free; the fit refuses one that does not affect the model."""
    known = known_parameters()
    return [
        SHARE,
        *(
            name
            for name in known
            if name.startswith(SECTIONS) and isinstance(known[name].default, float)
        ),
    ]


@dataclass(frozen=True)
class ContactProblem(Problem):
    """The problem of fitting the contact model of a compartment."""

    measured: Measured
    parameters: Parameters
    """All parameters at the start"""
    model: KneeModel
    """Model at the start"""
    texts: Mapping[str, str]
    """Contents of the files that parameters name, by parameter"""

    def answers(self, values: Values) -> Results:
        """Compute the answers, shape (n,); see `Problem.answers`.

        Values are within their ranges, and parameters are not checked again: that takes milliseconds.
        """
        changed = self.parameters
        for name, value in values.items():
            section, own = name.split(".")
            changed = changed.model_copy(
                update={section: getattr(changed, section).model_copy(update={own: value})}
            )
        femur, tibia = changed.femur, changed.tibia
        if femur.geometry == tibia.geometry == "circle" and tibia.radius <= femur.radius:
            raise UsageError(
                f"tibia.radius: {tibia.radius:g} must exceed femur.radius, {femur.radius:g}"
            )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # `predicted` has warned of implausible inputs
            return self._run(changed)

    def _run(self, parameters: Parameters) -> Results:
        """Run a model with other parameters; its surfaces are made again only if they change."""
        trial, begun = self.measured, self.parameters
        same_surfaces = (parameters.femur.radius, parameters.tibia) == (
            begun.femur.radius,
            begun.tibia,
        )
        try:
            pair = self.model.pair if same_surfaces else contact_pair(parameters, self.texts)
            model = retuned(replace(self.model, pair=pair), parameters)
            results = model.run(
                trial.time, trial.angle, trial.load_of(parameters.load.share), trial.height
            )
        except ValueError as error:
            raise UsageError(f"{trial.source}: {error}") from None
        return results.view(Results)

    def predicted(self, values: Values) -> Results:
        """Compute the answers after a check of all parameters; see `Problem.predicted`."""
        return self._run(load_parameters(flat_parameters(self.parameters) | values))

    def conclusions(
        self,
        values: Values,
        refit: Callable[[Problem], Values],  # noqa: ARG002
    ) -> tuple[list[str], dict[str, Any], list[str]]:
        """Report answers with a status that makes them unusable."""
        status = self.predicted(values)["status"]
        faults = {
            Status.NOT_CONVERGED: "missed their tolerance",
            Status.IMPLAUSIBLE: "are implausibly deep",
        }
        counts = {fault: int(np.count_nonzero(status & bit)) for bit, fault in faults.items()}
        return (
            [],
            {},
            [
                f"{count} of {len(status)} answers {fault}"
                for fault, count in counts.items()
                if count
            ],
        )


def problem_of(
    parameters: Parameters,
    measured: Measured,
    unknowns: tuple[Unknown, ...],
    compiled: bool | None,
) -> ContactProblem:
    """Make the problem of fitting a compartment's contact model, with a tolerance of `FINE` or less.

    Args:
        parameters: All parameters at the start.
        measured: The trial.
        unknowns: The free parameters.
        compiled: Whether to use the compiled model; None: where that is expected to be faster.

    Raises:
        UsageError: the load is the axial one but the share is not fixed, or inputs are too large for a knee.
    """
    if measured.axial and parameters.load.rule != "fixed_share":
        raise UsageError(
            f"{measured.source}: column axial_load needs load.compartment fixed_share, not "
            f"{parameters.load.rule}; give the compartment's own load as column load"
        )
    tolerance = min(parameters.fidelity.tolerance, FINE)
    fidelity = parameters.fidelity.model_copy(update={"tolerance": tolerance, "budget": 0})
    exact = parameters.model_copy(update={"fidelity": fidelity})
    texts = curve_texts(exact, {})
    if compiled is None:
        compiled = worth_compiling(RUNS * len(unknowns) * len(measured.time))
    model = replace(build_model(exact, curves=texts), compiled=compiled, results=Results)
    return ContactProblem(measured, unknowns, exact, model, texts)


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
    bags: Sequence[Path],
    parameters: LoadParameters,
    names: Names,
    advance: OnProgress,
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
        if (first := digests.index(own)) < place:
            fault = f"bags {bags[first]} and {bags[place]} are the same"
            raise UsageError(
                f"{fault}: each bag is left out in turn, so each must be a different one"
            )
    topic, left_out = names.get(OWN_NAME, OWN_NAME), Counter[str]()
    samples, columns, counts, doubts = (
        list[Sensed](),
        list[Floats](),
        list[tuple[str, int]](),
        list[str](),
    )
    max_gap = round(parameters.pairing.max_gap * NANOSECONDS)
    for bag in bags:
        begin = len(samples)
        with Bag(bag) as opened:
            summary = estimate_load(
                opened,
                parameters,
                None,
                advance,
                names=names,
                keep=lambda answer: samples.append(answer.sensed),
            )
            stamps, axial, refused = _reference(opened, topic)
            doubts += [*_own_estimate(opened, topic), *others_beside(bag)]
        at = summary.stamps
        later = at > np.maximum.accumulate(np.concatenate(([-1], at[:-1])))
        gaps = np.diff(stamps, prepend=stamps[0], append=stamps[-1])[np.searchsorted(stamps, at)]
        column = np.interp(at - stamps[0], stamps - stamps[0], axial, left=np.nan, right=np.nan)
        column[~(later & ((gaps <= max_gap) | np.isin(at, stamps)))] = np.nan
        flagged = np.array([bool(sample.status & UNUSABLE) for sample in samples[begin:]])
        reasons = {
            "flagged": int(flagged.sum()),
            "without a reference": int((np.isnan(column) & ~flagged).sum()),
        }
        reasons |= {
            f"refused as {reason}": count for reason, count in (summary.refused + refused).items()
        }
        column[flagged] = np.nan
        if np.isnan(column).all():
            raise UsageError(
                f"bag {bag}: no sample can be fitted to the reference ({_counted(reasons)})"
            )
        left_out.update(reasons)
        if summary.damage:
            doubts.append(
                f"bag {bag} is damaged, and read as far as it can be: {join_faults(summary.damage)}"
            )
        columns.append(column)
        counts.append((bag.name, len(column)))
    source = f"bag {', '.join(map(str, bags))}"
    answers = {AXIAL_FORCE: np.concatenate(columns)}
    return Referenced(
        source, ", ".join(digests), answers, tuple(samples), left_out, tuple(doubts), tuple(counts)
    )


def _reference(bag: Bag, topic: str) -> tuple[NDArray[np.int64], Floats, Counter[str]]:
    """Read increasing stamps [ns] and axial forces [N] of the reference, and count refused samples by the reason."""
    try:
        reader = bag.select({ROLE: MESSAGE_TYPES[JOINT_REACTION_FORCE]}, {ROLE: topic})
    except UsageError as error:
        raise UsageError(
            f"{error}; --remap {JOINT_REACTION_FORCE}:=TOPIC names a measured joint reaction"
        ) from None
    refused, kept = Counter[str](), dict[int, float]()
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
        raise UsageError(
            f"bag {bag.path}: no message on {topic} can be a reference ({_counted(refused)})"
        )
    return np.array(list(kept)), np.array(list(kept.values())), refused


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


def _counted(reasons: Mapping[str, int]) -> str:
    return (
        ", ".join(f"{count} {reason}" for reason, count in reasons.items() if count)
        or "nothing is refused"
    )


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
        estimator, nets = (
            Estimator(level, person),
            self.nets or _net_moments(level, person, self.measured.samples),
        )
        axial = [
            estimator.react(each.stamp, each.joints, each.ground, net, each.status)[0].axial
            for each, net in zip(self.measured.samples, nets, strict=True)
        ]
        return {AXIAL_FORCE: np.array(axial)}

    def predicted(self, values: Values) -> dict[str, Floats]:
        """Return the answers, with the samples' stamps as `time` [s]."""
        return {
            "time": np.array([each.stamp / NANOSECONDS for each in self.measured.samples]),
            **self.answers(values),
        }

    def conclusions(
        self, values: Values, refit: Callable[[Problem], Values]
    ) -> tuple[list[str], dict[str, Any], list[str]]:
        """Report the error of the estimate and what the fit gains; several bags are left out in turn.

        The file gets `calibrated`, and the error as `standard_deviation`, if the error is smaller than with the
        constants of the start.
        """
        data, several = self.measured, len(self.measured.bags) > 1
        reference, answer = data.answers[AXIAL_FORCE], self.answers(values)[AXIAL_FORCE]
        known, begun = (
            np.isfinite(reference),
            {unknown.name: unknown.start for unknown in self.unknowns},
        )
        with np.errstate(invalid="ignore"):
            r = float(np.corrcoef(reference[known], answer[known])[0, 1])
        own, start = self.error(values, known), self.error(begun, known)
        counts = [
            f"{count} {reason}"
            for reason, count in data.left_out.items()
            if count or "refused" not in reason
        ]
        remarks = [
            f"that is {own:.3f} body weights{f', r {r:.3f}' if math.isfinite(r) else ''}, "
            f"level {self.parameters.chosen_level}",
            f"samples: {data.number} fitted; left out: {', '.join(counts)}",
        ]
        if several:
            errors, number = (
                [],
                np.repeat(np.arange(len(data.bags)), [count for _, count in data.bags]),
            )
            for place, (bag, _) in enumerate(data.bags):
                within = known & (number == place)
                others = replace(data, answers={AXIAL_FORCE: np.where(within, np.nan, reference)})
                errors.append(
                    (
                        self.error(refit(replace(self, measured=others)), within),
                        self.error(begun, within),
                    )
                )
                own, start = errors[-1]
                remarks.append(
                    f"bag {bag}: {own:.3f} body weights with constants of the other bags, {start:.3f} with "
                    "those of the start"
                )
            own, start = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
            remarks.append(
                f"calibrating takes the error from {start:.3f} to {own:.3f} body weights in a bag that it "
                "has not seen"
            )
        if not start - own >= LEAST_GAIN:
            unseen = " in a bag that it has not seen" if several else ""
            doubt = f"calibrating gains nothing: the error is {own:.3f} body weights{unseen}, and {start:.3f} with the"
            return (
                remarks,
                {},
                [
                    *data.doubts,
                    f"{doubt} constants of the start; so the file does not say calibrated",
                ],
            )
        deviation = min(max(own, LEAST_DEVIATION), LARGEST_DEVIATION)
        remarks += [] if several else [OTHER_TRIALS]
        return remarks, {"calibrated": True, "standard_deviation": deviation}, list(data.doubts)

    def error(self, values: Values, within: NDArray[np.bool_]) -> float:
        """RMS error of the estimate [body weights] at some samples with a reference."""
        error = self.answers(values)[AXIAL_FORCE] - self.measured.answers[AXIAL_FORCE]
        return float(np.sqrt(np.mean(error[within] ** 2))) / self.person(values).weight


def load_problem_of(
    parameters: LoadParameters, measured: Referenced, unknowns: tuple[Unknown, ...]
) -> LoadProblem:
    """Make the problem, and compute once whatever does not depend on free parameters."""
    moves, level = any(unknown.name in BODY for unknown in unknowns), parameters.chosen_level
    nets = () if moves else _net_moments(level, parameters.person.constants, measured.samples)
    return LoadProblem(measured, unknowns, parameters, nets)


def _net_moments(level: str, person: Person, samples: Sequence[Sensed]) -> tuple[NetMoments, ...]:
    """Compute the net moments at knee and ankle of a person at every sample."""
    leg = leg_of(person.mass, person.height)
    return tuple(
        LOAD_LEVELS[level].dynamics(leg, each.joints, each.motion, each.ground) for each in samples
    )
