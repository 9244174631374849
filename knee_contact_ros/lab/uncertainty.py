"""Standard deviations of depth and force from those of angle, load, share and constants of the knee.

Linear propagation follows JCGM 100:2008, Sec. 5.1.2, for independent inputs: u² = Σ (∂f/∂x u(x))². The
slopes are central differences over one deviation to either side, each a whole run of the model, so curvature between
them is averaged.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from operator import attrgetter
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from ..bags.bag import Bag
from ..bags.names import OWN_NAMES, Names
from ..bags.provenance import Provenance
from ..model.types import Floats, Rows
from ..offline.bag_parameters import file_contents, resolved_parameters
from ..offline.notebooks import Name, in_python_words, solve_inputs, warn_of
from ..parameters.curves import curve_files
from ..parameters.files import ParameterSource, all_values, dotted, known_parameters
from ..parameters.schema import (
    LATERAL_PREFIX,
    Parameters,
    has_two_compartments,
    without_effect,
)
from ..results import missing_attribute
from ..system.arguments import checked
from ..system.errors import UsageError, suggest
from ..system.files import expand_user, read_mapping
from ..system.progress import OnProgress, no_progress, progress
from .knees import INPUT_PARAMETERS, Knees, compute
from .recordings import Recording, read_recording

UNCERTAIN_INPUTS = {
    "flexion_angle": ("angles", "rad"),
    "axial_load": ("axial", "N"),
    "medial_share": ("share", ""),
    "femoral_height": ("heights", "m"),
}
"""Inputs of a tick that may be uncertain: their fields in `Recording`, and units"""
UNCERTAIN_PREFIXES = ("load.", "femur.", "tibia.", "contact.", "body_weight")
"""Beginnings of the names of the parameters that may be uncertain"""
MAX_RELATIVE = 1.0
"""Largest relative deviation: beyond it linear propagation does not hold"""
LEAST_RELATIVE_DEVIATION = 5e-4
"""Smallest deviation as a part of the value, if the number is below 1: it would otherwise be a fraction of the value"""
MAX_DEVIATION = {"rad": 0.35, "m": 0.01, "": 1.0}
"""Largest deviation of an input by its unit, and of any angle"""
LEAST_EFFECT = (1e-9, 1e-3)
"""Smallest effects on depth [m] and force [N] that count: rounding and the solver's own errors are as large"""
DEFAULT_LEVEL = 0.95
"""Default probability of an interval"""


class Deviation(NamedTuple):
    """Standard deviation of an input or a parameter with a constant error in a recording: an offset, or a factor.

    A relative deviation s means a factor eˢ, so a positive value stays positive however large the deviation.
    """

    name: str
    """Name of the input or the parameter"""
    size: float
    """Size in the unit of the input or parameter, or as a fraction of its value"""
    relative: bool
    """Whether the size is a fraction of the value"""

    def moved(self, value: Any, times: float) -> Any:
        """Return a value, a number or an array, moved by a number of deviations."""
        return value * math.exp(times * self.size) if self.relative else value + times * self.size

    @property
    def text(self) -> str:
        """The deviation with its unit, as text."""
        if self.relative:
            return f"{100.0 * self.size:g} %"
        return f"{self.size:g} {self.unit}".strip()

    @property
    def unit(self) -> str:
        """The SI unit of the input or the parameter; empty if it has none."""
        return _unit_of(self.name)


def _unit_of(name: str) -> str:
    if name in UNCERTAIN_INPUTS:
        return UNCERTAIN_INPUTS[name][1]
    return known_parameters()[name].unit


def deviations_of(
    given: Mapping[str, Any] | Name, parameters: Parameters
) -> tuple[Deviation, ...]:
    """Check standard deviations by name of inputs or of real parameters, and keep their order.

    Each is a number in SI units, or a text in percent of the value, like `"10 %"`; for an angle, a share or a height
    only a number. They may be in a YAML file.

    Raises:
        UsageError: the file cannot be read, a name is unknown or has no effect, or a value is no standard deviation.
    """
    if not isinstance(given, Mapping):
        given = read_mapping(
            expand_user(str(given)), "file of standard deviations", "names to standard deviations"
        )
    if not given:
        raise UsageError(
            "uncertainty: no standard deviation is given; for example contact.stiffness: 10 %"
        )
    unused = {"femoral_height"}
    if parameters.drive == "displacement":
        unused = {"axial_load", "medial_share"}
    inputs = [name for name in UNCERTAIN_INPUTS if name not in unused]
    prefixes: tuple[str, ...] = UNCERTAIN_PREFIXES
    if has_two_compartments(parameters):
        prefixes = (*prefixes, LATERAL_PREFIX)
    values = all_values(parameters)
    known = [
        name
        for name, value in values.items()
        if name.startswith(prefixes) and isinstance(value, float) and name not in INPUT_PARAMETERS
    ]
    found = []
    for name, size in dotted(given).items():
        if name not in (*inputs, *known):
            where = (
                f"with drive {parameters.drive} and load.compartment {parameters.load.compartment}"
            )
            allowed = f"{where} {', '.join(inputs)}, or a real number of {', '.join(prefixes)}"
            hint = suggest(name, [*inputs, *known], allowed, cutoff=0.75)
            raise UsageError(f"uncertainty: {name or repr(name)} is not allowed; {hint}")
        scale = parameters.body_weight if name == "axial_load" else values.get(name)
        found.append(_deviation(name, size, scale))
    return tuple(found)


def _deviation(name: str, size: Any, scale: Any) -> Deviation:
    """Read a standard deviation; `scale` is the value that it may not exceed, None: percents are not allowed.

    Raises:
        UsageError: it is no number, not positive or too large.
    """
    unit = _unit_of(name)
    relative = isinstance(size, str)
    number: Any = math.nan
    if relative:
        percent = re.fullmatch(r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*%\s*", size)
        if percent and scale is not None:
            number = 0.01 * float(percent[1])
        most = MAX_RELATIVE
    else:
        if isinstance(size, Real) and not isinstance(size, bool | np.bool_):
            number = size
        bounded_by_unit = unit == "rad" or scale is None
        # A value of 0 bounds nothing.
        most = MAX_DEVIATION[unit] if bounded_by_unit else abs(scale) or 1e30
    if not 0.0 < number <= most + 1e-9 * most:
        limit = "" if relative or most >= 1e30 else f" and up to {most:g}"
        percents = "" if scale is None else ", or up to 100 %"
        hint = "; is it in degrees?" if unit == "rad" else ""
        raise UsageError(
            f"uncertainty: {name}: {size!r} is not allowed; a number > 0{limit} in SI units{percents}{hint}"
        )
    if (
        not relative
        and scale is not None
        and number <= min(1.0, LEAST_RELATIVE_DEVIATION * abs(scale))
    ):
        raise UsageError(
            f"uncertainty: {name}: {size!r} {unit} is only {100.0 * number / abs(scale):.2g} % of {abs(scale):g}; "
            f"write '{100.0 * number:g} %' for that part of it, or '{100.0 * number / abs(scale):.2g} %' if it is meant"
        )
    return Deviation(name, float(number), relative)


class Propagated(NamedTuple):
    """Standard deviations of a compartment's depth and force, arrays of shape (n,).

    Example:
        >>> from knee_contact_ros import uncertainty
        >>> medial = uncertainty("bags/gait2354_right", deviations={"contact.stiffness": "20 %"}).medial
        >>> low, high = medial.depth_interval(0.95)
        >>> bool((low < medial.rows["penetration_depth"]).all())
        True
    """

    rows: Rows
    """The answers themselves, with their estimated numerical errors"""
    parts: dict[Deviation, tuple[Floats, Floats]]
    """Changes of depth [m] and force [N], with their signs, when one input alone grows by one deviation"""

    def __repr__(self) -> str:
        at = int(self.rows["contact_force"].argmax())
        names = ", ".join(each.name for each in self.parts if each not in self.without_effect)
        idle = ", ".join(each.name for each in self.without_effect)
        force, depth = (self.rows[name][at] for name in ("contact_force", "penetration_depth"))
        return (
            f"<Propagated: {len(self.rows)} ticks; at the largest force {force:.1f} ± {self.force[at]:.2g} N, "
            f"{1e3 * depth:.3f} ± {1e3 * self.depth[at]:.2g} mm, one standard deviation of {names}"
            f"{f'; without effect: {idle}' if idle else ''}>"
        )

    @property
    def without_effect(self) -> list[Deviation]:
        """Those that change neither depth nor force, such as a constant that the contact law does not use."""
        return [
            deviation
            for deviation, effects in self.parts.items()
            if all(
                np.abs(effect).max(initial=0.0) < least
                for effect, least in zip(effects, LEAST_EFFECT, strict=True)
            )
        ]

    @property
    def depth(self) -> Floats:
        """Standard deviation of the penetration depth [m]."""
        return self._combined(0)

    @property
    def force(self) -> Floats:
        """Standard deviation of the contact force [N]."""
        return self._combined(1)

    def depth_interval(self, level: float = DEFAULT_LEVEL) -> tuple[Floats, Floats]:
        """Return the interval of the depth [m] for a probability, assuming normal errors; not below 0."""
        return self._interval(self.rows["penetration_depth"], self.depth, level)

    def force_interval(self, level: float = DEFAULT_LEVEL) -> tuple[Floats, Floats]:
        """Return the interval of the contact force [N] for a probability, assuming normal errors.

        It does not go below 0, unless the force itself does because the contact law allows tension.
        """
        return self._interval(self.rows["contact_force"], self.force, level)

    def _interval(self, values: Any, deviation: Floats, level: float) -> tuple[Floats, Floats]:
        reach = coverage_factor(level) * deviation
        return np.maximum(values - reach, np.minimum(values, 0.0)), values + reach

    def _combined(self, which: int) -> Floats:
        """Return the standard deviation of the depth (0) or the force (1) from all inputs together."""
        return np.asarray(
            np.sqrt(np.sum([part[which] ** 2 for part in self.parts.values()], axis=0))
        )


def coverage_factor(level: float) -> float:
    """Return the half-width, in standard deviations, of the interval of a normal value for probability `level`.

    Raises:
        UsageError: `level` is not between 0 and 1.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"level: {level!r} is not allowed; a probability between 0 and 1")
    return NormalDist().inv_cdf(0.5 + 0.5 * level)


@dataclass(frozen=True)
class UncertainGait:
    """A recorded gait, its knee, and the standard deviations of its inputs and parameters."""

    deviations: tuple[Deviation, ...]
    parameters: Parameters
    files: Mapping[str, str]
    """Contents of the files that parameters name"""
    recording: Recording
    rows: tuple[Rows, ...]
    """Answers of each compartment, shape (n,)"""
    compiled: bool

    def answers(self, moved: Mapping[Deviation, float]) -> list[Rows]:
        """Compute the answers of each compartment with inputs off by a number of their deviations.

        Raises:
            UsageError: an input or a parameter leaves its range.
        """
        # All parameters are named: a named lateral one does not follow its medial one, so it has its own deviation.
        values = {}
        fields = {}
        for deviation in self.deviations:
            times = moved.get(deviation, 0.0)
            if deviation.name in UNCERTAIN_INPUTS:
                field, _ = UNCERTAIN_INPUTS[deviation.name]
                fields[field] = deviation.moved(getattr(self.recording, field), times)
            else:
                value = float(attrgetter(deviation.name)(self.parameters))
                values[deviation.name] = deviation.moved(value, times)
        knees = Knees(self.recording._replace(**fields), self.parameters, self.files)
        found = compute(knees, [values], series=True, compiled=self.compiled)
        if found.failed[0]:
            raise UsageError(found.failed[0])
        return [several[0] for several in found.series]

    @property
    def doubt(self) -> str:
        """Sentence on constants that the contact law does not use; empty if there are none."""
        names = [each.name for each in self.deviations]
        of_law = [name.removeprefix("contact.") for name in names if name.startswith("contact.")]
        return without_effect(self.parameters.contact, of_law)

    def propagate(self, advance: OnProgress = no_progress) -> Uncertainty:
        """Propagate the standard deviations linearly.

        Raises:
            UsageError: an input or a parameter leaves its range by one deviation both upwards and downwards.
        """
        found = [Propagated(rows, {}) for rows in self.rows]
        for done, deviation in enumerate(self.deviations, start=1):
            ends: list[Sequence[Rows]] = []
            width = 0.0
            for times in (-1.0, 1.0):
                try:
                    ends.append(self.answers({deviation: times}))
                    width += 1.0
                except UsageError:  # the difference is that of the other side
                    ends.append(self.rows)
            if not width:
                raise UsageError(
                    f"uncertainty: {deviation.name}: {deviation.text} exceeds the allowed range in both directions"
                )
            for one, below, above in zip(found, *ends, strict=True):
                depth, force = (
                    (above[name] - below[name]) / width
                    for name in ("penetration_depth", "contact_force")
                )
                one.parts[deviation] = depth, force
            advance(done, len(self.deviations))
        return Uncertainty(found[0], found[1] if len(found) > 1 else None)


def read_uncertain_gait(
    bag: Bag,
    basis: Parameters | Provenance,
    sizes: Mapping[str, Any] | Name,
    names: Names = OWN_NAMES,
    *,
    compiled: bool | None = None,
) -> UncertainGait:
    """Read a bag; see `deviations_of` for `sizes`, and `solve` for the other arguments.

    All answers are held in memory: 300 B for each tick and compartment.

    Raises:
        UsageError: an argument cannot be used, or parameters changed while the recording was made.
    """
    parameters = resolved_parameters(basis)
    texts = file_contents(basis)
    deviations = deviations_of(sizes, parameters)
    if isinstance(basis, Provenance) and basis.changes:
        raise UsageError(
            f"bag {bag}: its parameters changed, or the model was reset; uncertainty needs a constant model"
        )
    files = {name: texts[parameter] for parameter, name in curve_files(parameters).items()}
    recording, rows = read_recording(bag, basis, texts, names, compiled=compiled)
    use_library = compiled is not False
    return UncertainGait(deviations, parameters, files, recording, rows, use_library)


@dataclass(frozen=True)
class Uncertainty:
    """Result of `uncertainty`: standard deviations of each compartment's answers.

    Example:
        >>> from knee_contact_ros import uncertainty
        >>> found = uncertainty("bags/gait2354_right", deviations={"flexion_angle": 0.02})
        >>> found.lateral is None
        True
    """

    medial: Propagated
    """Standard deviations of the medial compartment, or of the only one"""
    lateral: Propagated | None
    """Standard deviations of the lateral compartment, where both are modelled"""

    def __repr__(self) -> str:
        lateral = f"\n  lateral {self.lateral!r}" if self.lateral else ""
        return f"<Uncertainty: medial {self.medial!r}{lateral}>"

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self, name)


@checked
def uncertainty(
    bag: Name | None = None,
    params: ParameterSource | None = None,
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
        values: Single parameters, which override all others.
        subject: A subject file.
        remap: Other names of the inputs in the bag.
        namespace: Namespace of the inputs in the bag.
        compiled: As for `load_model`.

    An implausible or damaged bag causes warnings.

    Raises:
        UsageError: an argument cannot be used, or parameters changed while the recording was made.

    Example:
        >>> from knee_contact_ros import uncertainty
        >>> found = uncertainty("bags/gait2354_right", deviations={"contact.stiffness": "20 %"})
        >>> print(f"{1e3 * found.medial.depth.max():.2f} mm")
        0.10 mm
    """
    with in_python_words():
        inputs = solve_inputs(bag, params, values, subject, remap, namespace)
        with inputs as (opened, basis, names), progress("Propagating") as advance:
            gait = read_uncertain_gait(opened, basis, deviations or {}, names, compiled=compiled)
            doubts = [*gait.recording.doubts, gait.doubt]
            warn_of(opened.path, "solved", doubts, gait.recording.damage)
            return gait.propagate(advance)
