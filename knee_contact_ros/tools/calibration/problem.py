"""A problem to be fitted: residuals of given parameters, answers of a model less measurements over their noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.calibration.unknowns import Unknown

Floats = NDArray[np.float64]
P = TypeVar("P", bound="Problem")
Noise = Mapping[str, float]
"""Standard deviation of each measured column, in its unit"""
STEP, LEAST_STEP, PART = 1e-3, 1e-7, 0.5
"""Steps of difference quotients, in coordinates: STEP at first; later the part PART of what the data resolve, at least
LEAST_STEP, where that is less, since within STEP an impact may come before a sample or after it"""
FAR = 1e8
"""Residual where parameters do not make a model"""


class Data(Protocol):
    """The measurements to which a model is fitted."""

    @property
    def source(self) -> str:
        """Name of the file, bag or table, for messages."""

    @property
    def digest(self) -> str:
        """SHA-256 of the file or bag; empty for a table in memory."""

    @property
    def answers(self) -> dict[str, Floats]:
        """Measured columns by name, shape (n,) each; not a number where nothing was measured."""

    @property
    def number(self) -> int:
        """Number of measured values."""


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

    def remarks(self, place: Floats) -> list[str]:  # noqa: ARG002
        """Give further remarks on a fit, a line each."""
        return []

    def also(self, place: Floats) -> dict[str, Any]:  # noqa: ARG002
        """Give parameters that follow from a fit, beside the fitted ones."""
        return {}

    @property
    def start(self) -> Floats:
        """The place from which a fit starts."""
        return np.array([unknown.coordinate(unknown.start) for unknown in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper ends of the coordinates, shape (p,) each."""
        low, high = zip(*(unknown.bounds for unknown in self.unknowns), strict=True)
        return np.array(low), np.array(high)

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
            return self.scaled(self.misfits(place), noise)
        except UsageError:
            return np.full(self.measured.number, FAR)

    def scaled(self, misfits: Mapping[str, Floats], noise: Noise) -> Floats:
        """Divide misfits by the noise, and join them, one column after another."""
        return np.concatenate([misfits[name] / noise[name] for name in misfits])

    def jacobian(self, place: Floats, noise: Noise, which: Floats | None = None) -> Floats:
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
        for each in range(len(place)) if which is None else which:
            index, sides = int(each), []
            step = float(self.steps[index])
            for end in (max(place[index] - step, low[index]), min(place[index] + step, high[index])):
                moved = place.copy()
                moved[index] = end
                sides.append((end, self.residuals(moved, noise)))
            (before, below), (behind, above) = [
                side if abs(side[1][0]) < FAR else (place[index], self.residuals(place, noise)) for side in sides
            ]
            columns.append((above - below) / (behind - before) if behind > before else np.zeros_like(above))
        return np.stack(columns, axis=1)

    def with_steps_for(self: P, place: Floats, noise: Noise) -> P:
        """Give the same problem with steps that fit what the data resolve around a place."""
        sizes = np.linalg.norm(self.jacobian(place, noise), axis=0)
        return replace(self, steps=np.clip(PART / np.maximum(sizes, 1.0), LEAST_STEP, STEP))
