"""The parameters that are fitted: their names, ranges and coordinates."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.parameters.reading import Declaration, all_values, known_parameters
from knee_contact_ros.parameters.schema import Parameters, constants_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.measured import Measured

Ends = tuple[float, float]
Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names, or names to the ends of a narrower range"""
SHARE = "load.share"
SECTIONS = ("femur.", "tibia.", "contact.")
UNIT = re.compile(r"\[([^\]]+)\]")
"""What a parameter's meaning begins with, if it has a unit"""
RADII = ("femoral_radius", "tibial_radius")
ELASTIC = {"stiffness": ("youngs_modulus", "poissons_ratio"), "stiffness_2": ("youngs_modulus_2", "poissons_ratio_2")}
"""What a stiffness is made of where `contact.stiffness_from` is material"""


class Unknown(NamedTuple):
    """A parameter that is fitted. What cannot be 0 has its logarithm as coordinate, else its value over `scale`."""

    name: str
    start: float
    least: float
    """Of its range; both ends are allowed"""
    most: float
    unit: str
    """Empty if it has none"""
    scale: float
    """In its unit; 0: logarithmic"""

    @property
    def bounds(self) -> Ends:
        """Its range, as coordinates."""
        return self.coordinate(self.least), self.coordinate(self.most)

    def coordinate(self, value: float) -> float:
        """Of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """At a coordinate, within the range."""
        if self.scale:
            return min(max(coordinate * self.scale, self.least), self.most)
        return min(max(math.exp(min(coordinate, 700.0)), self.least), self.most)


def unknowns_of(free: Free, parameters: Parameters, measured: Measured) -> tuple[Unknown, ...]:
    """Those that are asked for, in the order given: each with the range that is given, or else with its own.

    Raises:
        UsageError: none is given, a name is given twice, is none of a real parameter or one that has no effect on this
            model, a range is none or leaves the parameter's own, or the value to start from lies outside of it.
    """
    asked = _asked(free)
    if not asked:
        raise UsageError("calibrate: no parameter is free; as --free contact.stiffness")
    used, known, values = used_parameters(parameters, measured), known_parameters(), all_values(parameters)
    found = []
    for name, ends in asked.items():
        _check_name(name, used, known, parameters, measured)
        found.append(_unknown(name, ends, known[name], float(values[name])))
    return tuple(found)


def used_parameters(parameters: Parameters, measured: Measured) -> list[str]:
    """The real parameters that the model of a compartment, driven as it was measured, depends on."""
    contact, femur, tibia = parameters.contact, parameters.femur, parameters.tibia
    names = [name for name in constants_of(contact.law) if isinstance(getattr(contact, name), float)]
    if contact.stiffness_from == "material" and "stiffness" in names:
        elastic = [name for stiffness, made_of in ELASTIC.items() if stiffness in names for name in made_of]
        names = [name for name in names if name not in (*ELASTIC, "exponent")] + [*elastic, *RADII]
    used = [f"contact.{name}" for name in dict.fromkeys(names)]
    if measured.height is None:
        used.append("femur.mass")
    used.append("femur.radius" if femur.geometry == "circle" else "femur.scale")
    used += {"plane": ["tibia.slope"], "circle": ["tibia.radius"], "profile": ["tibia.scale"]}.get(tibia.geometry, [])
    return [*used, *([SHARE] if measured.axial else [])]


def _asked(free: Free) -> dict[str, Ends | None]:
    """Names and ends of ranges."""
    if isinstance(free, str):
        free = [free]
    if isinstance(free, Mapping):
        return {str(name): None if ends is None else _ends(str(name), ends) for name, ends in free.items()}
    asked: dict[str, Ends | None] = {}
    for each in free:
        name, equals, told = str(each).partition("=")
        if name in asked:
            raise UsageError(f"--free {name}: it is given twice")
        asked[name] = _ends(name, told.split(":")) if equals else None
    return asked


def _ends(name: str, given: Sequence[float | str]) -> Ends:
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high:
        told = ":".join(map(str, given)) if isinstance(given, Sequence) else repr(given)
        raise UsageError(f"--free {name}: range {told!r} is not allowed; two numbers that grow, as 1000:20000")
    return low, high


def _check_name(
    name: str, used: Sequence[str], known: Mapping[str, Declaration], parameters: Parameters, measured: Measured
) -> None:
    if name in used:
        return
    if name == SHARE:
        raise UsageError(f"--free {name}: {measured.source} has no column axial_load, of which it is the share")
    if name in known and name.startswith(SECTIONS):
        if not isinstance(known[name].default, float):
            raise UsageError(f"--free {name}: it is no real number; allowed are {', '.join(used)}")
        how = f"law {parameters.contact.law}, femur {parameters.femur.geometry}, tibia {parameters.tibia.geometry}"
        if parameters.contact.stiffness_from == "material":
            how += ", stiffness from material"
        raise UsageError(f"--free {name}: nothing depends on it ({how}, drive {parameters.drive}); allowed are "
                         f"{', '.join(used)}")  # fmt: skip
    near = difflib.get_close_matches(name, used, n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(used)}"
    raise UsageError(f"--free {name or repr(name)}: it is no parameter that can be fitted; {hint}")


def _unknown(name: str, ends: Ends | None, declared: Declaration, start: float) -> Unknown:
    least, most, words = declared.limits
    low, high = ends or (least, most)
    if not least <= low < high <= most:
        raise UsageError(f"--free {name}: range {low:g}:{high:g} is not allowed; it must lie in {least:g} to {most:g}")
    if not low <= start <= high:
        raise UsageError(f"--free {name}: it starts from {start:g}, outside of {low:g} to {high:g}; give another value "
                         "or range")  # fmt: skip
    logarithmic = low > 0.0 or (low == 0.0 and f"> {least:g}" in words.split("; "))
    if low == least and f"> {least:g}" in words.split("; "):
        low = float(np.nextafter(low, high))
    if high == most and f"< {most:g}" in words.split("; "):
        high = float(np.nextafter(high, low))
    scale = abs(start) or abs(float(declared.default)) or 0.1 * (high - low)
    unit = UNIT.match(declared.description)
    return Unknown(name, start, low, high, unit[1] if unit else "", 0.0 if logarithmic else scale)
