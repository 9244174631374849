"""The free parameters of a fit: their names, ranges and coordinates."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.parameters.declared import Declaration
from knee_contact_ros.system.errors import UsageError

Ends = tuple[float, float]
Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names of parameters, or a mapping of names to the ends of narrower ranges"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""The unit with which a parameter's description begins, if it has one"""


class Unknown(NamedTuple):
    """A free parameter; its coordinate is the logarithm of a value that cannot be 0, else the value over `scale`."""

    name: str
    """Name of the parameter"""
    start: float
    """Value from which the fit starts"""
    least: float
    """Lower end of the range, which is allowed"""
    most: float
    """Upper end of the range, which is allowed"""
    unit: str
    """Unit of the parameter; empty if it has none"""
    scale: float
    """Change of the value over that of the coordinate, in the unit; 0 where the coordinate is the logarithm"""

    @property
    def bounds(self) -> Ends:
        """Lower and upper end of the coordinate."""
        return self.coordinate(self.least), self.coordinate(self.most)

    def coordinate(self, value: float) -> float:
        """Give the coordinate of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """Give the value at a coordinate, within the range."""
        if self.scale:
            return min(max(coordinate * self.scale, self.least), self.most)
        return min(max(math.exp(min(coordinate, 700.0)), self.least), self.most)


class Fittable(NamedTuple):
    """The parameters that may be free in a problem."""

    names: Sequence[str]
    """Names of these parameters"""
    known: Mapping[str, Declaration]
    """Declarations of all parameters, by name"""
    values: Mapping[str, Any]
    """Values of all parameters, by name, from which a fit starts"""
    example: str
    """One of the names"""
    why_not: Callable[[str], str]
    """Gives the reason why another name cannot be free; empty if there is no such parameter"""


def unknowns_of(free: Free, fittable: Fittable) -> tuple[Unknown, ...]:
    """Give the free parameters in the order of their names, with the ranges that are given, or else with their own.

    Raises:
        UsageError: no name is given, one is given twice or cannot be free, a range is no range or is not within the
            parameter's own, or the value to start from is outside of it.
    """
    ranges = _ranges(free)
    if not ranges:
        raise UsageError(f"calibrate: no parameter is free; as --free {fittable.example}")
    for name in ranges:
        _check_name(name, fittable)
    known, values = fittable.known, fittable.values
    return tuple(_unknown(name, ends, known[name], float(values[name])) for name, ends in ranges.items())


def nested(values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Group parameters named `section.name` by their sections."""
    sections: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        section, inner = name.split(".")
        sections.setdefault(section, {})[inner] = value
    return sections


def _ranges(free: Free) -> dict[str, Ends | None]:
    """Give the range of each free parameter, by name; None for its own."""
    if isinstance(free, str):
        free = [free]
    if isinstance(free, Mapping):
        return {str(name): None if ends is None else _ends(str(name), ends) for name, ends in free.items()}
    ranges: dict[str, Ends | None] = {}
    for each in free:
        name, equals, ends = str(each).partition("=")
        if name in ranges:
            raise UsageError(f"--free {name}: it is given twice")
        ranges[name] = _ends(name, ends.split(":")) if equals else None
    return ranges


def _ends(name: str, given: Sequence[float | str]) -> Ends:
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high:
        text = ":".join(map(str, given)) if isinstance(given, Sequence) else repr(given)
        raise UsageError(f"--free {name}: range {text!r} is not allowed; two numbers that grow, as 1000:20000")
    return low, high


def _check_name(name: str, fittable: Fittable) -> None:
    if name in fittable.names:
        return
    if reason := fittable.why_not(name):
        raise UsageError(f"--free {name}: {reason}")
    near = difflib.get_close_matches(name, fittable.names, n=1, cutoff=0.6)
    hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(fittable.names)}"
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
