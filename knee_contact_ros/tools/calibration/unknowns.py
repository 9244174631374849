"""The parameters that are fitted: their names, ranges and coordinates."""

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
"""Names, or names to the ends of a narrower range"""
UNIT = re.compile(r"\[([^\]]+)\]")
"""What a parameter's meaning begins with, if it has a unit"""


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


class Fittable(NamedTuple):
    """What may be free."""

    names: Sequence[str]
    known: Mapping[str, Declaration]
    """Of every parameter by its name"""
    values: Mapping[str, Any]
    """Likewise; a fit starts from them"""
    example: str
    """One of the names"""
    why_not: Callable[[str], str]
    """Why another name cannot be free; empty: it is none that is known"""


def unknowns_of(free: Free, fittable: Fittable) -> tuple[Unknown, ...]:
    """Those that are asked for, in the order given: each with the range that is given, or else with its own.

    Raises:
        UsageError: none is given, a name is given twice or is none of these, a range is none or leaves the parameter's
            own, or the value to start from lies outside of it.
    """
    asked = _asked(free)
    if not asked:
        raise UsageError(f"calibrate: no parameter is free; as --free {fittable.example}")
    for name in asked:
        _check_name(name, fittable)
    known, values = fittable.known, fittable.values
    return tuple(_unknown(name, ends, known[name], float(values[name])) for name, ends in asked.items())


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
