"""Standard deviations of inputs and parameters as a user gives them: by name, absolute or in percent."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.parameters.lateral import LATERAL, has_both
from knee_contact_ros.parameters.reading import all_values, dotted, known_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.yaml_file import read_mapping

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
