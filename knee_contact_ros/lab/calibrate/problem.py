"""What is fitted: free parameters, measurements, and a model's answers less measurements over their noise."""

from __future__ import annotations

import difflib
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.parameters.files import all_values, known_parameters
from knee_contact_ros.parameters.schema import Declaration, NodeSection
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError

Ends = tuple[float, float]
Free = Mapping[str, Sequence[float] | None] | Iterable[str]
"""Names of parameters, or a mapping of names to the ends of narrower ranges"""
Noise = Mapping[str, float]
"""Standard deviation of each measured column, in its unit"""
P = TypeVar("P", bound="Problem")
UNIT = re.compile(r"\[([^\]]+)\]")
"""The unit with which a parameter's description begins, if it has one"""
STEP, LEAST_STEP, PART = 1e-3, 1e-7, 0.5
"""Steps of difference quotients, in coordinates: STEP at first; later the part PART of what the data resolve, at least
LEAST_STEP, where that is less, since within STEP an impact may come before a sample or after it"""
FAR = 1e8
"""Residual where parameters do not make a model"""


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

    def coordinate(self, value: float) -> float:
        """Give the coordinate of a value."""
        return value / self.scale if self.scale else math.log(value)

    def value(self, coordinate: float) -> float:
        """Give the value at a coordinate, within the range."""
        value = coordinate * self.scale if self.scale else math.exp(min(coordinate, 700.0))
        return min(max(value, self.least), self.most)


def unknowns_of(free: Free, names: Sequence[str], parameters: NodeSection, source: str) -> tuple[Unknown, ...]:
    """Give the free parameters in the order of their names, with the ranges that are given, or else with their own.

    Args:
        free: What the user wants to fit.
        names: Names of the parameters that may be free.
        parameters: All parameters, from which the fit starts.
        source: Name of the data, for messages.

    Raises:
        UsageError: no name is given, one is given twice or cannot be free, a range is no range or is not within the
            parameter's own, or the value to start from is outside of it.
    """
    pairs: Iterable[tuple[str, Any]]
    if isinstance(free, Mapping):
        pairs = free.items()
    else:
        words = [str(each).partition("=") for each in ([free] if isinstance(free, str) else free)]
        pairs = [(name, ends.split(":") if equals else None) for name, equals, ends in words]
    known, values = known_parameters(type(parameters)), all_values(parameters)
    found: dict[str, Unknown] = {}
    for name, ends in pairs:
        if name in found:
            raise UsageError(f"--free {name}: it is given twice")
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]}?" if near else f"allowed are {', '.join(names)}"
            raise UsageError(f"--free {name or repr(name)}: it is no parameter that can be fitted to {source}; {hint}")
        found[name] = _unknown(name, None if ends is None else _ends(name, ends), known[name], float(values[name]))
    if not found:
        raise UsageError(f"calibrate: no parameter is free; as --free {names[0]}")
    return tuple(found.values())


def _ends(name: str, given: Sequence[float | str]) -> Ends:
    try:
        low, high = (float(each) for each in given)
    except (TypeError, ValueError):
        low = high = math.nan
    if not low < high:
        text = ":".join(map(str, given)) if isinstance(given, Sequence) else repr(given)
        raise UsageError(f"--free {name}: range {text!r} is not allowed; two numbers that grow, as 1000:20000")
    return low, high


def _unknown(name: str, ends: Ends | None, declared: Declaration, start: float) -> Unknown:
    least, most, words = declared.limits
    low, high = ends or (least, most)
    if not least <= low < high <= most:
        raise UsageError(f"--free {name}: range {low:g}:{high:g} is not allowed; it must lie in {least:g} to {most:g}")
    if not low <= start <= high:
        raise UsageError(f"--free {name}: it starts from {start:g}, outside of {low:g} to {high:g}; give another value "
                         "or range")  # fmt: skip
    excluded = words.split("; ")  # ends of the range that are not allowed themselves
    logarithmic = low > 0.0 or (low == 0.0 and f"> {least:g}" in excluded)
    if low == least and f"> {least:g}" in excluded:
        low = float(np.nextafter(low, high))
    if high == most and f"< {most:g}" in excluded:
        high = float(np.nextafter(high, low))
    scale = abs(start) or abs(float(declared.default)) or 0.1 * (high - low)
    unit = UNIT.match(declared.description)
    return Unknown(name, start, low, high, unit[1] if unit else "", 0.0 if logarithmic else scale)


@dataclass(frozen=True)
class Data:
    """Measurements to which a model is fitted: from a table or from a bag."""

    source: str
    """Name of the file, bag or table, for messages"""
    digest: str
    """SHA-256 of the file or bag; empty for a table in memory"""
    answers: dict[str, Floats]
    """Measured columns by name, shape (n,) each; not a number where nothing was measured"""

    @property
    def number(self) -> int:
        """Number of measured values."""
        return sum(int(np.isfinite(column).sum()) for column in self.answers.values())


class Conclusions(NamedTuple):
    """What follows from a fit."""

    remarks: list[str]
    """Remarks, a line each"""
    also: dict[str, Any]
    """Parameters that follow from the fitted ones, by name"""
    warnings: list[str]
    """Doubts about them, a sentence each"""


@dataclass(frozen=True)
class Problem(ABC):
    """A model with free parameters, and measurements to which it is fitted.

    A place is a choice of the p free parameters: their coordinates, shape (p,), see `Unknown`.
    """

    measured: Data
    unknowns: tuple[Unknown, ...]
    """The free parameters"""
    steps: Floats
    """Steps of difference quotients, in coordinates, shape (p,)"""

    @abstractmethod
    def answers(self, place: Floats) -> Any:
        """Compute the model's answers at a place, by the names of the measured columns, shape (n,) each.

        Raises:
            UsageError: the parameters do not make a model.
        """

    @abstractmethod
    def predicted(self, place: Floats) -> Results | dict[str, Floats]:
        """Compute the answers at a place, with all that the caller of `calibrate` gets.

        Raises:
            UsageError: the parameters do not make a model, or inputs are too large for a knee.
        """

    @abstractmethod
    def doubts(self, place: Floats) -> list[str]:
        """Report what is doubtful in the answers at a place, a sentence each."""

    def conclusions(self, place: Floats, fitted: Callable[[Problem], Floats]) -> Conclusions:  # noqa: ARG002
        """Conclude from a fit; `fitted` fits other problems of the kind, and gives their places."""
        return Conclusions([], {}, [])

    @property
    def start(self) -> Floats:
        """The place from which a fit starts."""
        return np.array([unknown.coordinate(unknown.start) for unknown in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper ends of the coordinates, shape (p,) each."""
        low = [unknown.coordinate(unknown.least) for unknown in self.unknowns]
        return np.array(low), np.array([unknown.coordinate(unknown.most) for unknown in self.unknowns])

    def values(self, place: Floats) -> dict[str, float]:
        """Give the values of the parameters at a place, by name."""
        return {unknown.name: unknown.value(float(each)) for unknown, each in zip(self.unknowns, place, strict=True)}

    def misfits(self, place: Floats) -> dict[str, Floats]:
        """Compute answers less measurements in their units, by column, where something was measured.

        Raises:
            UsageError: see `answers`.
        """
        answers, measured = self.answers(place), self.measured.answers
        return {name: (answers[name] - column)[np.isfinite(column)] for name, column in measured.items()}

    def residuals(self, place: Floats, noise: Noise) -> Floats:
        """Compute all misfits in units of the noise, one column after another; `FAR` if there is no model."""
        try:
            return scaled(self.misfits(place), noise)
        except UsageError:
            return np.full(self.measured.number, FAR)

    def jacobian(self, place: Floats, noise: Noise, which: Iterable[int] | None = None) -> Floats:
        """Compute the slopes of the residuals over coordinates by central differences.

        Args:
            place: Where to compute them.
            noise: The noise of the columns.
            which: Indices of the coordinates; None: all.

        Returns:
            Slopes of shape (residuals, coordinates).
        """
        low, high = self.bounds
        columns = []
        for index in range(len(place)) if which is None else which:
            sides = []
            for step in (-self.steps[index], self.steps[index]):
                moved = place.copy()
                moved[index] = min(max(place[index] + step, low[index]), high[index])
                sides.append((moved[index], self.residuals(moved, noise)))
            (first, below), (last, above) = [
                side if abs(side[1][0]) < FAR else (place[index], self.residuals(place, noise)) for side in sides
            ]
            columns.append((above - below) / (last - first) if last > first else np.zeros_like(above))
        return np.stack(columns, axis=1)

    def with_steps_for(self: P, place: Floats, noise: Noise) -> P:
        """Give the same problem with steps that fit what the data resolve around a place."""
        sizes = np.linalg.norm(self.jacobian(place, noise), axis=0)
        return replace(self, steps=np.clip(PART / np.maximum(sizes, 1.0), LEAST_STEP, STEP))


def scaled(misfits: Mapping[str, Floats], noise: Noise) -> Floats:
    """Divide misfits by the noise, and join them, one column after another."""
    return np.concatenate([misfits[name] / noise[name] for name in misfits])
