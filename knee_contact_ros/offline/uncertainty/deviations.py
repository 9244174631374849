"""The standard deviations of inputs and parameters, as they are given: by name, absolute or in percent."""

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

FLEXION_ANGLE, AXIAL_LOAD, MEDIAL_SHARE, FEMORAL_HEIGHT = (
    "flexion_angle",
    "axial_load",
    "medial_share",
    "femoral_height",
)
STREAMS = {FLEXION_ANGLE: "rad", AXIAL_LOAD: "N", MEDIAL_SHARE: "", FEMORAL_HEIGHT: "m"}
"""What a tick is given, and the share that follows from it, with the units of their deviations"""
SECTIONS = ("load.", "femur.", "tibia.", "contact.", "lateral.", "body_weight")
"""What the names of the parameters begin with that may be uncertain"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""What a parameter's meaning begins with, if it has a unit"""
LARGEST = 1.0
"""Of a deviation in parts of the value: beyond it little is known, and no straight line holds"""


class Deviation(NamedTuple):
    """A standard deviation of something that is off by the same through a recording: an offset, or a factor.

    One in percent is a factor eˢ, s being the deviation: what is positive stays so, however large the deviation.
    """

    name: str
    size: float
    """In the unit of what it is of, or a part of it"""
    relative: bool

    def moved(self, value: Any, times: float) -> Any:
        """A value, a number or an array of them, off by so many deviations."""
        return value * math.exp(times * self.size) if self.relative else value + times * self.size

    @property
    def text(self) -> str:
        """The deviation with its unit, for a person."""
        return f"{100.0 * self.size:g} %" if self.relative else f"{self.size:g} {_unit_of(self.name)}".strip()


def _unit_of(name: str) -> str:
    """The SI unit of an input or a parameter; empty if it has none."""
    if name in STREAMS:
        return STREAMS[name]
    unit = UNIT.match(known_parameters()[name].description)
    return unit[1] if unit else ""


def read_deviations(path: Path) -> Mapping[str, Any]:
    """What a YAML file maps names to.

    Raises:
        UsageError: it cannot be read, or is none.
    """
    return dotted(read_mapping(path, "file of standard deviations", "names to standard deviations"))


def deviations_of(given: Mapping[str, Any], parameters: Parameters) -> tuple[Deviation, ...]:
    """Standard deviations by name (of `STREAMS`, or of parameters that are real numbers), in the order given.

    Each is a number in SI units, or a text in percent of the value: `"10 %"`; that of an angle, a share or a height is
    a number.

    Raises:
        UsageError: a name is none of these, has no effect in this drive, or a deviation is none.
    """
    if not given:
        raise UsageError("uncertainty: no standard deviation is given; as contact.stiffness: 10 %")
    values = all_values(parameters)
    return tuple(_deviation(name, size, values, parameters) for name, size in given.items())


def _deviation(name: str, given: Any, values: Mapping[str, Any], parameters: Parameters) -> Deviation:
    real = [each for each, value in values.items() if each.startswith(SECTIONS) and isinstance(value, float)]
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
    """A number, Python's or NumPy's; not a number if it is none, and infinite if it has too many digits."""
    try:
        return float(given) if isinstance(given, Real) and not isinstance(given, bool) else math.nan
    except OverflowError:
        return math.inf


def _percent(text: str) -> float:
    """Parts of 1 of a text in percent, likewise."""
    number, percent, rest = text.partition("%")
    try:
        return float(number) / 100.0 if percent and not rest.strip() else math.nan
    except ValueError:
        return math.nan
