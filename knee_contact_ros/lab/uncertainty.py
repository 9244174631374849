"""Standard deviations of depth and force that follow from those of angle, load, share and constants of the knee.

Linear propagation follows JCGM 100:2008, Sec. 5.1.2, for independent inputs: u² = Σ (∂f/∂x u(x))². The
slopes are differences between one deviation less and one more, each a whole run of the model, so that a curvature
between them counts on average. `sampled` draws all inputs at once (JCGM 101:2008) and assumes no linearity.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from operator import attrgetter
from pathlib import Path
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.reader import OWN_NAMES, Names
from knee_contact_ros.lab.sweep import Floats, Knees, compute, read_recording
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.types import Rows
from knee_contact_ros.offline.notebooks import Name, in_python_words, solve_inputs
from knee_contact_ros.offline.solve import parameters_in, texts_of
from knee_contact_ros.parameters.files import Source, all_values, curve_files, dotted, known_parameters
from knee_contact_ros.parameters.schema import LATERAL, Parameters, has_both
from knee_contact_ros.results import no_such
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import expanded, read_mapping
from knee_contact_ros.system.terminal import progress

STREAMS = {
    "flexion_angle": ("angles", "rad"), "axial_load": ("axial", "N"), "medial_share": ("share", ""),
    "femoral_height": ("heights", "m"),
}  # fmt: skip
"""Inputs of a tick that may be uncertain: their fields of `Recording`, and units"""
SECTIONS = ("load.", "femur.", "tibia.", "contact.", "lateral.", "body_weight")
"""Beginnings of the names of the parameters that may be uncertain"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""The unit at the beginning of a parameter's description"""
LARGEST = 1.0
"""Largest relative deviation: beyond it little is known, and no linear propagation holds"""
DEPTH_AND_FORCE = ("penetration_depth", "contact_force")
LEVEL = 0.95
"""Default probability of an interval"""
TRIES = 100
"""Largest number of draws of a sample until all parameters lie in their ranges"""


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
        return f"{100.0 * self.size:g} %" if self.relative else f"{self.size:g} {self.unit}".strip()

    @property
    def unit(self) -> str:
        """The SI unit of the input or the parameter; empty if it has none."""
        if self.name in STREAMS:
            return STREAMS[self.name][1]
        unit = UNIT.match(known_parameters()[self.name].description)
        return unit[1] if unit else ""


Moved = Mapping[Deviation, float]
"""Errors of inputs and parameters, in standard deviations of each"""


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
    displaced = parameters.drive == "displacement"
    if name in STREAMS and name != "flexion_angle" and (name == "femoral_height") != displaced:
        raise UsageError(f"uncertainty: {name} moves nothing with drive {parameters.drive}")
    if name.startswith(LATERAL) and not has_both(parameters):
        raise UsageError(f"uncertainty: {name} moves nothing with load.compartment {parameters.load.compartment}")
    relative = isinstance(given, str)
    size = _number(given)
    if not 0.0 < size < math.inf or (relative and size > LARGEST):
        raise UsageError(f"uncertainty: {name}: {given!r} is not allowed; a number > 0 in SI units, or up to '100 %'")
    if relative and name in STREAMS and name != "axial_load":
        raise UsageError(f"uncertainty: {name}: {given!r} is not allowed; in {STREAMS[name][1] or 'parts of 1'}")
    return Deviation(name, size, relative)


def _number(given: Any) -> float:
    """Return a number, or a text in percent as a part of 1; NaN if it is neither."""
    try:
        if isinstance(given, str):
            number, percent, rest = given.partition("%")
            return float(number) / 100.0 if percent and not rest.strip() else math.nan
        return float(given) if isinstance(given, Real) and not isinstance(given, bool) else math.nan
    except (ValueError, OverflowError):
        return math.nan


class Given(NamedTuple):
    """A recording and its knee, whose inputs and parameters may be off."""

    knees: Knees
    """Inputs of all ticks (`recording`), and the parameters they were computed with (`parameters`)"""
    rows: tuple[Rows, ...]
    """Answers of each compartment, arrays of shape (n,)"""
    replays: int
    """Number of runs that are to be expected: for many, the model is compiled"""
    compiled: bool | None
    """Whether the compiled model is to be used; None: if it is quicker, with its compilation"""

    def answers(self, moved: Moved) -> list[Rows]:
        """Return the answers of each compartment to inputs and parameters with errors.

        A lateral parameter that follows its medial one has the same error, unless it is in `moved` itself. Without
        errors the answers are those of the recording, bit for bit.

        Raises:
            UsageError: a parameter leaves its range, or an input the range of a knee.
        """
        recording, parameters = self.knees.recording, self.knees.parameters
        inputs, values = dict[str, Any](), dict[str, float]()
        for deviation, times in moved.items():
            if deviation.name in STREAMS:
                field, _ = STREAMS[deviation.name]
                inputs[field] = deviation.moved(getattr(recording, field), times)
            else:
                values[deviation.name] = deviation.moved(float(attrgetter(deviation.name)(parameters)), times)
        knees = Knees(recording._replace(**inputs), parameters, self.knees.files)
        ticks = self.replays * sum(map(len, self.rows))
        compiled = worth_compiling(ticks) if self.compiled is None else self.compiled
        found = compute(knees, [values], series=True, compiled=compiled)
        if found.failed[0]:
            raise UsageError(found.failed[0])
        return [rows[0] for rows in found.series]


def given_in(
    bag: Path, basis: Parameters | Provenance, advance: Callable[[int, int], None], names: Names = OWN_NAMES,
    *, replays: int, compiled: bool | None = None,
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
    parameters, texts = parameters_in(basis), texts_of(basis)
    files = {name: texts[parameter] for parameter, name in curve_files(parameters).items()}
    recording, rows = read_recording(bag, basis, texts, names, advance, compiled=compiled)
    return Given(Knees(recording, parameters, files), rows, replays, compiled)


class Propagated(NamedTuple):
    """Standard deviations of a compartment's depth and force, arrays of shape (n,)."""

    rows: Rows
    """The answers themselves, with their estimated numerical errors"""
    parts: dict[Deviation, tuple[Floats, Floats]]
    """Changes of depth [m] and force [N], with their signs, when one input alone grows by one deviation"""

    def __repr__(self) -> str:
        at, names = int(self.rows["contact_force"].argmax()), ", ".join(each.name for each in self.parts)
        force, depth = (self.rows[name][at] for name in ("contact_force", "penetration_depth"))
        return (
            f"<Propagated: {len(self.rows)} ticks; at the largest force {force:.1f} ± {self.force[at]:.2g} N, "
            f"{1e3 * depth:.3f} ± {1e3 * self.depth[at]:.2g} mm, one standard deviation of {names}>"
        )

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
        return self._interval(0, level)

    def force_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """Return the bounds between which the contact force [N] lies with a probability, if errors are normal.

        They are not below 0, unless the force itself is because the contact law allows tension.
        """
        return self._interval(1, level)

    def _interval(self, which: int, level: float) -> tuple[Floats, Floats]:
        reach, values = factor(level) * self._combined(which), np.asarray(self.rows[DEPTH_AND_FORCE[which]])
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

    def __repr__(self) -> str:
        inside = f"{np.mean(self.depth_inside):.3f} of the depths and {np.mean(self.force_inside):.3f} of the forces"
        return f"<Sampled: {self.number} samples of {len(self.depth)} ticks; {inside} are in the linear intervals>"


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
    found = [Propagated(rows, {}) for rows in given.rows]
    for done, deviation in enumerate(deviations, start=1):
        ends: list[Sequence[Rows]] = []
        for times in (-1.0, 1.0):
            # All are named, as a named lateral parameter does not follow its medial one: it has its own deviation.
            moved = {other: times * (other == deviation) for other in deviations}
            try:
                ends.append(given.answers(moved))
            except UsageError:
                ends.append(given.rows)  # the difference is that of the other side
        low, high = ends
        width = 2.0 - sum(end is given.rows for end in ends)
        if not width:
            raise UsageError(
                f"uncertainty: {deviation.name}: {deviation.text} leaves the range of what it is of both ways"
            )
        for one, below, above in zip(found, low, high, strict=True):
            depth, force = ((above[name] - below[name]) / width for name in DEPTH_AND_FORCE)
            one.parts[deviation] = depth, force
        advance(done, len(deviations))
    return found


def sampled(
    given: Given, linear: Sequence[Propagated], samples: int, seed: int, advance: Callable[[int, int], None]
) -> list[Sampled]:
    """Draw samples of all inputs at once, normal and independent, and compare them with `linear`, for each compartment.

    A sample with a parameter out of its range is drawn again. `advance` is called with the samples done and in all.
    """
    random = np.random.default_rng(seed)
    deviations = list(linear[0].parts)
    before = [np.stack([one.rows[name] for name in DEPTH_AND_FORCE]) for one in linear]
    bounds = [np.stack([one.depth_interval(), one.force_interval()], axis=1) for one in linear]
    sums = [np.zeros((3, *one.shape)) for one in before]
    for done in range(1, samples + 1):
        for place, rows in enumerate(_drawn(given, deviations, random)):
            now = np.stack([rows[name] for name in DEPTH_AND_FORCE])
            off, (low, high) = now - before[place], bounds[place]
            sums[place] += np.stack([off, off * off, (low <= now) & (now <= high)])
        advance(done, samples)
    results = []
    for base, (first, second, inside) in zip(before, sums, strict=True):
        mean = first / samples
        spread = np.sqrt(np.maximum(second - samples * mean**2, 0.0) / max(samples - 1, 1))
        depth, force = zip(base + mean, spread, strict=True)
        results.append(Sampled(samples, *depth, *force, *inside / samples))
    return results


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

    def __repr__(self) -> str:
        lateral = f"\n  lateral {self.lateral!r}" if self.lateral else ""
        return f"<Uncertainty: medial {self.medial!r}{lateral}>"

    def __getattr__(self, name: str) -> Any:
        raise no_such(self, name)

    def sampled(self, samples: int = 200, seed: int = 0) -> list[Sampled]:
        """Compare the linear propagation with random samples of all inputs at once, for each compartment.

        Raises:
            UsageError: fewer than 2 samples, or none of them lies in the parameters' ranges.
        """
        if samples < 2:
            raise UsageError(f"samples: {samples} is not allowed; 2 or more")
        linear = [self.medial, *([self.lateral] if self.lateral else [])]
        with progress("Sampling") as advance:
            given = self.given._replace(replays=max(samples, self.given.replays))
            return sampled(given, linear, samples, seed, advance)


def uncertainty(
    bag: Name | None = None, params: Source | None = None, deviations: Mapping[str, Any] | Name | None = None,
    values: Mapping[str, Any] | None = None, *, subject: Name | None = None, remap: Mapping[str, str] | None = None,
    namespace: str = "", compiled: bool | None = None,
) -> Uncertainty:  # fmt: skip
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
