"""Free parameters of a fit: their names, ranges and coordinates."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...parameters.files import all_values, known_parameters
from ...parameters.sections import Declaration, NodeSection
from ...system.errors import UsageError, suggest

Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names of parameters, or a mapping of names to the ends of narrower ranges"""


class Unknown(NamedTuple):
    """A free parameter; its coordinate is the logarithm of the value if it cannot be 0, else the value over `scale`."""

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

    def coordinate(self, value: float) -> float:
        """Return the coordinate of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """Return the value at a coordinate, within the range."""
        value = coordinate * self.scale if self.scale else math.exp(min(coordinate, 700.0))
        return min(max(value, self.least), self.most)


def unknowns_of(
    free: Free, names: Sequence[str], parameters: NodeSection, source: str
) -> tuple[Unknown, ...]:
    """Return the free parameters in the order of their names, each with the given range or else its own.

    Args:
        free: What the user wants to fit.
        names: Names of the parameters that may be free.
        parameters: All parameters, from which the fit starts.
        source: Name of the data, for messages.

    Raises:
        UsageError: no name is given, one is given twice or cannot be free, a range is invalid or not within the
            parameter's own, or it does not contain the start.
    """
    if isinstance(free, Mapping):
        pairs: list[tuple[str, Any]] = list(free.items())
    else:
        words = [str(each).partition("=") for each in ([free] if isinstance(free, str) else free)]
        pairs = [(name, ends.split(":") if equals else None) for name, equals, ends in words]
    known = known_parameters(type(parameters))
    values = all_values(parameters)
    found: dict[str, Unknown] = {}
    for name, ends in pairs:
        if name in found:
            raise UsageError(f"--free {name}: it is given twice")
        if name not in names:
            what = f"--free {name or repr(name)}: it is not a parameter that can be fitted to {source}"
            raise UsageError(f"{what}; {suggest(name, names)}")
        found[name] = _unknown(name, ends, known[name], float(values[name]))
    if not found:
        raise UsageError(f"calibrate: no parameter is free; name one, such as --free {names[0]}")
    return tuple(found.values())


def _unknown(name: str, ends: Any, declared: Declaration, start: float) -> Unknown:
    least, most = declared.least, declared.most
    try:
        low, high = (least, most) if ends is None else map(float, ends)
    except (TypeError, ValueError):
        low = high = math.nan
    if not least <= low < high <= most:
        given = ":".join(map(str, ends)) if isinstance(ends, Sequence) else repr(ends)
        raise UsageError(
            f"--free {name}: range {given} is not allowed; two increasing numbers within {least:g} to "
            f"{most:g}, as {least:g}:{most:g}"
        )
    if not low <= start <= high:
        raise UsageError(
            f"--free {name}: it starts from {start:g}, outside of {low:g} to {high:g}; give another value "
            "or range"
        )
    # Ends of the parameter's own range may be excluded; then the next number inside is the end.
    excluded = declared.words.split("; ")
    logarithmic = low > 0.0 or (low == 0.0 and f"> {least:g}" in excluded)
    if low == least and f"> {least:g}" in excluded:
        low = float(np.nextafter(low, high))
    if high == most and f"< {most:g}" in excluded:
        high = float(np.nextafter(high, low))
    scale = abs(start) or abs(float(declared.default)) or 0.1 * (high - low)
    return Unknown(name, start, low, high, declared.unit, 0.0 if logarithmic else scale)
