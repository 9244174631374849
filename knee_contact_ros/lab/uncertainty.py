"""Standard deviations of depth and force that follow from those of angle, load, share and constants of the knee."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.joint_reaction.compartments import LoadRule
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.types import Rows, Status
from knee_contact_ros.offline.notebooks import Name, in_python_words, solve_inputs
from knee_contact_ros.offline.solve import parameters_in, solve, texts_of
from knee_contact_ros.parameters.build import load_rule
from knee_contact_ros.parameters.files import (
    Source,
    all_values,
    dotted,
    flat_parameters,
    known_parameters,
    load_parameters,
)
from knee_contact_ros.parameters.schema import LATERAL, Parameters, has_both, lateral_knee
from knee_contact_ros.streams.contact_stream import Compartment, ContactStream, compartments_of, half_spacing
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import expanded, read_mapping
from knee_contact_ros.system.terminal import progress

FLEXION_ANGLE, AXIAL_LOAD = "flexion_angle", "axial_load"
MEDIAL_SHARE, FEMORAL_HEIGHT = "medial_share", "femoral_height"
STREAMS = {FLEXION_ANGLE: "rad", AXIAL_LOAD: "N", MEDIAL_SHARE: "", FEMORAL_HEIGHT: "m"}
"""Units of the deviations of the inputs of a tick, and of the medial share that follows from them"""
SECTIONS = ("load.", "femur.", "tibia.", "contact.", "lateral.", "body_weight")
"""Beginnings of the names of the parameters that may be uncertain"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""The unit at the beginning of a parameter's description"""
LARGEST = 1.0
"""Largest relative deviation: beyond it little is known, and no linear propagation holds"""


class Deviation(NamedTuple):
    """Standard deviation of an input or a parameter with a constant error in a recording: an offset, or a factor.

    A relative deviation s is that of a factor eˢ: a positive value stays positive, however large the deviation.
    """

    name: str
    """Name of the input or the parameter"""
    size: float
    """Size in the unit of the input or parameter, or as a part of its value"""
    relative: bool
    """Whether the size is a part of the value"""

    def moved(self, value: Any, times: float) -> Any:
        """Return a value, a number or an array, with an error of so many deviations."""
        return value * math.exp(times * self.size) if self.relative else value + times * self.size

    @property
    def text(self) -> str:
        """The deviation with its unit, as text."""
        return f"{100.0 * self.size:g} %" if self.relative else f"{self.size:g} {_unit_of(self.name)}".strip()


def _unit_of(name: str) -> str:
    """Return the SI unit of an input or a parameter; empty if it has none."""
    if name in STREAMS:
        return STREAMS[name]
    unit = UNIT.match(known_parameters()[name].description)
    return unit[1] if unit else ""


def read_deviations(path: Path) -> Mapping[str, Any]:
    """Read the mapping of names to standard deviations in a YAML file.

    Raises:
        UsageError: the file cannot be read, or holds no mapping.
    """
    return dotted(read_mapping(path, "file of standard deviations", "names to standard deviations"))


def deviations_of(given: Mapping[str, Any], parameters: Parameters) -> tuple[Deviation, ...]:
    """Check standard deviations by name (of `STREAMS`, or of parameters that are real numbers), and keep their order.

    Each is a number in SI units, or a text in percent of the value, as `"10 %"`; that of an angle, a share or a height
    is a number.

    Raises:
        UsageError: a name is unknown or has no effect in this drive, or its value is no standard deviation.
    """
    if not given:
        raise UsageError("uncertainty: no standard deviation is given; as contact.stiffness: 10 %")
    values = all_values(parameters)
    return tuple(_deviation(name, size, values, parameters) for name, size in given.items())


def _deviation(name: str, given: Any, values: Mapping[str, Any], parameters: Parameters) -> Deviation:
    """Check a standard deviation; `values` are those of all parameters by name."""
    real = [key for key, value in values.items() if key.startswith(SECTIONS) and isinstance(value, float)]
    if name not in STREAMS and name not in real:
        near = difflib.get_close_matches(name, [*STREAMS, *real], n=1, cutoff=0.75)
        allowed = (
            f"{', '.join(STREAMS)}, or a parameter that is a real number, of load, femur, tibia, contact, lateral, or "
            "body_weight"
        )
        hint = f"did you mean {near[0]}?" if near else allowed
        raise UsageError(f"uncertainty: {name or repr(name)} is not allowed; {hint}")
    if (name == FEMORAL_HEIGHT) != (parameters.drive == "displacement") and name in STREAMS and name != FLEXION_ANGLE:
        raise UsageError(f"uncertainty: {name} moves nothing with drive {parameters.drive}")
    if name.startswith(LATERAL) and not has_both(parameters):
        raise UsageError(f"uncertainty: {name} moves nothing with load.compartment {parameters.load.compartment}")
    relative = isinstance(given, str)
    size = _percent(given) if isinstance(given, str) else _number(given)
    if not 0.0 < size < math.inf or (relative and size > LARGEST):
        raise UsageError(f"uncertainty: {name}: {given!r} is not allowed; a number > 0 in SI units, or up to '100 %'")
    if relative and name in STREAMS and name != AXIAL_LOAD:
        raise UsageError(f"uncertainty: {name}: {given!r} is not allowed; in {STREAMS[name] or 'parts of 1'}")
    return Deviation(name, size, relative)


def _number(given: Any) -> float:
    """Return a number of Python or NumPy as float; NaN if it is no number, infinite if it is too large."""
    try:
        return float(given) if isinstance(given, Real) and not isinstance(given, bool) else math.nan
    except OverflowError:
        return math.inf


def _percent(text: str) -> float:
    """Return a text in percent as a part of 1; NaN if it is none."""
    number, percent, rest = text.partition("%")
    try:
        return float(number) / 100.0 if percent and not rest.strip() else math.nan
    except ValueError:
        return math.nan


Floats = NDArray[np.float64]
Moved = Mapping[Deviation, float]
"""Errors of inputs and parameters, in standard deviations of each"""


class Given(NamedTuple):
    """Inputs of the ticks of a recording, arrays of shape (n,), and the parameters it was computed with."""

    parameters: Parameters
    texts: Mapping[str, str]
    """Contents of the files that parameters name, by parameter"""
    rows: tuple[Rows, ...]
    """Answers of each compartment, arrays of shape (n,)"""
    angles: Floats
    """Flexion angles [rad]"""
    axial: Floats
    """Axial loads [N]"""
    moment: Floats
    """Frontal moments [N m]"""
    compartments: tuple[Compartment, ...]
    """Compartments that compute the answers to inputs with errors"""
    wanted: bool | None
    """Whether the compiled model is to be used; None: if it is quicker, with its compilation"""
    compiled: bool
    """Whether the compartments use the compiled model"""
    damage: tuple[str, ...]
    """Damage of the recording, as sentences"""

    def ready_for(self, replays: int) -> Given:
        """Return the same inputs, prepared for so many replays: for many, the model is compiled."""
        ticks = replays * sum(map(len, self.rows))
        compiles = worth_compiling(ticks) if self.wanted is None else self.wanted
        for compartment in self.compartments if compiles and not self.compiled else ():
            compartment.compile()
        return self._replace(compiled=self.compiled or compiles)

    def answers(self, moved: Moved) -> list[Rows]:
        """Return the answers of each compartment to inputs and parameters with errors.

        A lateral parameter that follows its medial one has the same error, unless it is in `moved` itself. Without
        errors the answers are those of the recording, bit for bit.

        Raises:
            UsageError: a parameter leaves its range, or an input the range of a knee.
        """
        parameters = self._parameters(moved)
        by_name = {deviation.name: (deviation, times) for deviation, times in moved.items()}

        def off(name: str, values: Any) -> Any:
            if name not in by_name:
                return values
            deviation, times = by_name[name]
            return deviation.moved(values, times)

        angles, axial = off(FLEXION_ANGLE, self.angles), off(AXIAL_LOAD, self.axial)
        medial = load_rule(parameters, self.texts)(axial, self.moment, angles)
        if MEDIAL_SHARE in by_name:
            medial = medial + off(MEDIAL_SHARE, 0.0) * axial
        stamps, status = self.rows[0]["stamp"], self.rows[0]["status"] & Status.TIME_RESET
        displaced = parameters.drive == "displacement"
        heights = off(FEMORAL_HEIGHT, self.rows[0]["femoral_height"].copy()) if displaced else None
        answers = []
        for compartment, loads in zip(self._compartments(parameters, moved), (medial, axial - medial), strict=False):
            parts = []
            for part in np.split(np.arange(len(stamps)), np.flatnonzero(status)):
                if len(part):
                    rows = slice(part[0], part[-1] + 1)
                    height = None if heights is None else heights[rows]
                    parts.append(_run(compartment, stamps[rows], angles[rows], loads[rows], height, status[rows]))
            answers.append(np.concatenate(parts))
        return answers

    def _compartments(self, parameters: Parameters, moved: Moved) -> Sequence[Compartment]:
        """Return compartments with other parameters: the same ones retuned, unless surfaces have to be made anew."""
        if any(times and of_a_surface(deviation.name) for deviation, times in moved.items()):
            new = compartments_of(parameters, self.texts)
            for compartment in new if self.compiled else ():
                compartment.compile()
            return new
        z = half_spacing(parameters)
        for compartment, own, place in zip(
            self.compartments, (parameters, lateral_knee(parameters)), (-z, z), strict=False
        ):
            compartment.retune(own, place)
        return self.compartments

    def _parameters(self, moved: Moved) -> Parameters:
        """Return the parameters with their errors."""
        values = flat_parameters(self.parameters)
        off = {
            deviation.name: deviation.moved(self._value(deviation.name), times)
            for deviation, times in moved.items()
            if deviation.name not in STREAMS
        }
        return load_parameters(values | off) if off else self.parameters

    def _value(self, name: str) -> float:
        """Return the value of a parameter by its dotted name; a lateral one may follow the medial one."""
        part: Any = self.parameters
        for step in name.split("."):
            part = getattr(part, step)
        return float(part)


def given_in(
    bag: Path, basis: Parameters | Provenance, advance: Callable[[int, int], None], names: Names = OWN_NAMES,
    *, replays: int, compiled: bool | None = None, curves: Mapping[str, str] | None = None,
) -> Given:  # fmt: skip
    """Read the inputs of the model from a bag, to be answered `replays` times; other arguments are those of `solve`.

    All answers are held in memory: 300 B for each tick and compartment.

    Raises:
        UsageError: the bag cannot be used, see `solve`; or parameters changed while the recording was made.
    """
    if isinstance(basis, Provenance) and basis.changes:
        raise UsageError(
            f"bag {bag}: its parameters changed, or the model was reset; uncertainty needs a constant model"
        )
    parameters = parameters_in(basis)
    texts = texts_of(basis) if curves is None else curves
    inputs: list[tuple[Any, Any, Any]] = []
    blocks: list[Sequence[Rows]] = []

    def listen(pipeline: ContactStream) -> None:
        class Noting(LoadRule):
            def __call__(self, axial: Any, moment: Any, flexion: Any) -> Any:
                inputs.append((axial, moment, flexion))
                return super().__call__(axial, moment, flexion)

        pipeline.rule = Noting(**vars(pipeline.rule))

    summary = solve(
        bag, basis, None, advance, names=names, compiled=compiled, keep=blocks.append, prepare=listen, curves=texts
    )
    axial, moment, angles = (
        np.concatenate([np.atleast_1d(one) for one in column]) for column in zip(*inputs, strict=True)
    )
    rows = tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))
    compartments = compartments_of(parameters, texts)
    damage = tuple(summary.damage)
    given = Given(parameters, texts, rows, angles, axial, moment, compartments, compiled, False, damage)
    return given.ready_for(replays)


def _run(compartment: Compartment, *columns: Any) -> Rows:
    """Compute ticks from rest; the columns are the arguments of `Compartment.advance_all`.

    Raises:
        UsageError: a value is outside the range of a knee.
    """
    compartment.start_anew()
    try:
        return compartment.advance_all(*columns)
    except ValueError as error:
        raise UsageError(f"uncertainty: {error}") from None


def of_a_surface(name: str) -> bool:
    """Return whether a parameter belongs to a surface or a mechanism, which are made anew when it changes."""
    return name.removeprefix(LATERAL).startswith(("femur.", "tibia.", "translation.")) and not name.endswith(".mass")


DEPTH, FORCE = "penetration_depth", "contact_force"
LEVEL = 0.95
"""Default probability of an interval"""
TRIES = 100
"""Largest number of draws of a sample until all parameters lie in their ranges"""


class Propagated(NamedTuple):
    """Standard deviations of a compartment's depth and force, arrays of shape (n,)."""

    rows: Rows
    """The answers themselves, with their estimated numerical errors"""
    parts: dict[Deviation, tuple[Floats, Floats]]
    """Changes of depth [m] and force [N], with their signs, when one input alone grows by one deviation"""

    @property
    def depth(self) -> Floats:
        """Standard deviation of the penetration depth [m]."""
        return self._combined(0)

    @property
    def force(self) -> Floats:
        """Standard deviation of the contact force [N]."""
        return self._combined(1)

    def depth_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Return the bounds between which the depth [m] lies with a probability, if errors are normal; not below 0."""
        return self._interval(DEPTH, self.depth, level)

    def force_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Return the bounds between which the contact force [N] lies with a probability, if errors are normal.

        They are not below 0, unless the force itself is because the contact law allows tension.
        """
        return self._interval(FORCE, self.force, level)

    def _interval(self, name: str, deviation: Floats, level: float) -> tuple[Floats, Floats]:
        reach, values = factor(level) * deviation, np.asarray(self.rows[name])
        least = np.minimum(values, 0.0)
        return np.maximum(values - reach, least), values + reach

    def _combined(self, which: int) -> Floats:
        """Return the standard deviation that all inputs make together, of the depth (0) or the force (1)."""
        squares = [part[which] ** 2 for part in self.parts.values()]
        return np.asarray(np.sqrt(np.sum(squares, axis=0)))


class Sampled(NamedTuple):
    """Mean and standard deviation of a compartment's depth and force over samples of the inputs, shape (n,)."""

    number: int
    """Number of samples"""
    depth_mean: Floats
    """Mean depth [m]"""
    depth: Floats
    """Standard deviation of the depth [m]"""
    force_mean: Floats
    """Mean contact force [N]"""
    force: Floats
    """Standard deviation of the contact force [N]"""
    depth_inside: Floats
    """Share of the samples whose depth is within the linear interval of `LEVEL`"""
    force_inside: Floats
    """Share of the samples whose force is within the linear interval of `LEVEL`"""


def factor(level: float) -> float:
    """Return the half-width, in standard deviations, of the interval of a normal value with probability `level`.

    Raises:
        UsageError: `level` is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"level: {level!r} is not allowed; a probability between 0 and 1")
    return NormalDist().inv_cdf(0.5 + 0.5 * level)


def propagated(given: Given, deviations: Sequence[Deviation], advance: Callable[[int, int], None]) -> list[Propagated]:
    """Propagate deviations linearly, for each compartment; `advance` is called with the inputs done and in all.

    Raises:
        UsageError: an input or a parameter leaves its range by one deviation both upwards and downwards.
    """
    parts: list[dict[Deviation, tuple[Floats, Floats]]] = [{} for _ in given.rows]
    for done, deviation in enumerate(deviations, start=1):
        # All are named, as a named lateral parameter does not follow its medial one: it has its own deviation.
        low, high = (
            _answers(given, {other: times * (other == deviation) for other in deviations}) for times in (-1.0, 1.0)
        )
        if low is None and high is None:
            raise UsageError(
                f"uncertainty: {deviation.name}: {deviation.text} leaves the range of what it is of both ways"
            )
        sides = [one or list(given.rows) for one in (low, high)]
        width = 2.0 if low and high else 1.0
        for place, (below, above) in enumerate(zip(*sides, strict=True)):
            depth, force = ((above[name] - below[name]) / width for name in (DEPTH, FORCE))
            parts[place][deviation] = depth, force
        advance(done, len(deviations))
    return [Propagated(rows, part) for rows, part in zip(given.rows, parts, strict=True)]


def sampled(
    given: Given, linear: Sequence[Propagated], samples: int, seed: int, advance: Callable[[int, int], None]
) -> list[Sampled]:
    """Draw samples of all inputs at once, normal and independent, and compare them with `linear`, for each compartment.

    A sample with a parameter out of its range is drawn again. `advance` is called with the samples done and in all.
    """
    random = np.random.default_rng(seed)
    deviations = list(linear[0].parts)
    bounds = [(one.depth_interval(), one.force_interval()) for one in linear]
    sums = [np.zeros((3, 2, len(one.rows))) for one in linear]
    for done in range(1, samples + 1):
        for place, rows in enumerate(_drawn(given, deviations, random)):
            before, total = linear[place].rows, sums[place]
            for which, name in enumerate((DEPTH, FORCE)):
                low, high = bounds[place][which]
                off = rows[name] - before[name]
                total[0, which] += off
                total[1, which] += off * off
                total[2, which] += (low <= rows[name]) & (rows[name] <= high)
        advance(done, samples)
    results = []
    for one, (first, second, inside) in zip(linear, sums, strict=True):
        mean = first / samples
        spread = np.sqrt(np.maximum(second - samples * mean**2, 0.0) / max(samples - 1, 1))
        means = [mean[which] + one.rows[name] for which, name in enumerate((DEPTH, FORCE))]
        shares = inside / samples
        results.append(Sampled(samples, means[0], spread[0], means[1], spread[1], shares[0], shares[1]))
    return results


def _answers(given: Given, moved: Moved) -> list[Rows] | None:
    """Return the answers to inputs with errors; None if one leaves its range."""
    try:
        return given.answers(moved)
    except UsageError:
        return None


def _drawn(given: Given, deviations: Sequence[Deviation], random: np.random.Generator) -> list[Rows]:
    """Return the answers to a random sample of the inputs, in which all parameters are in their ranges."""
    for _ in range(TRIES):
        try:
            return given.answers(dict(zip(deviations, random.standard_normal(len(deviations)).tolist(), strict=True)))
        except UsageError as error:
            last = error
    raise UsageError(f"uncertainty: of {TRIES} samples none lies in the parameters' ranges: {last}")


@dataclass(frozen=True)
class Uncertainty:
    """Result of `uncertainty`: standard deviations of each compartment's answers, and the inputs they follow from."""

    medial: Propagated
    """Standard deviations of the medial compartment, or of the only one"""
    lateral: Propagated | None
    """Standard deviations of the lateral compartment, where both are modelled"""
    given: Given
    """Inputs and parameters of the recording"""

    def sampled(self, samples: int = 200, seed: int = 0) -> list[Sampled]:
        """Compare the linear propagation with random samples of all inputs at once, for each compartment.

        Raises:
            UsageError: fewer than 2 samples, or none of them lies in the parameters' ranges.
        """
        if samples < 2:
            raise UsageError(f"samples: {samples} is not allowed; 2 or more")
        linear = [self.medial, *([self.lateral] if self.lateral else [])]
        with progress("Sampling") as advance:
            return sampled(self.given.ready_for(samples), linear, samples, seed, advance)


def uncertainty(
    bag: Name | None = None,
    params: Source | None = None,
    deviations: Mapping[str, Any] | Name | None = None,
    values: Mapping[str, Any] | None = None,
    *,
    subject: Name | None = None,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    compiled: bool | None = None,
) -> Uncertainty:
    """Propagate standard deviations of inputs and parameters to the depth and force of a recorded gait.

    Args:
        bag: This, and all other arguments but `deviations`, are as for `solve`.
        params: Parameters of the knee.
        deviations: Standard deviations by name, or a YAML file of them: of `flexion_angle` [rad], `axial_load` ([N] or
            `"5 %"`), `medial_share`, `femoral_height` [m], and of parameters that are real numbers, in SI units or in
            percent: `{"contact.stiffness": "20 %"}`. Each is constant through the recording, and independent of the
            others.
        values: Single parameters, which win over all others.
        subject: A subject file.
        remap: Other names of the inputs in the bag.
        namespace: Namespace of the inputs in the bag.
        compiled: As for `load_model`.

    Raises:
        UsageError: an argument cannot be used, or parameters changed while the recording was made.
    """
    with in_python_words():
        path, basis, names = solve_inputs(bag, params, values, subject, remap, namespace)
        sizes = deviations or {}
        sizes = dotted(sizes) if isinstance(sizes, Mapping) else read_deviations(Path(expanded(str(sizes))))
        wanted = deviations_of(sizes, parameters_in(basis))
        with progress("Solving") as advance:
            given = given_in(path, basis, advance, names, replays=2 * len(wanted), compiled=compiled)
        with progress("Propagating") as advance:
            medial, *lateral = propagated(given, wanted, advance)
    return Uncertainty(medial, lateral[0] if lateral else None, given)
