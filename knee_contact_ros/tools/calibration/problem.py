"""The residuals of a choice of parameters: what a model says less what was measured, in units of the noise."""

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
"""Of a difference quotient, in coordinates: a part in a thousand at first, and later so much of what the data resolve
where that is less: an impact may meet a sample or not within a thousandth"""
FAR = 1e8
"""Residual where parameters make no model"""


class Data(Protocol):
    """What was measured."""

    @property
    def source(self) -> str:
        """What it is called."""

    @property
    def digest(self) -> str:
        """SHA-256; empty of what is in memory."""

    @property
    def answers(self) -> dict[str, Floats]:
        """What a model is held against, by name, shape (n,) each; not a number where it was not measured."""

    @property
    def number(self) -> int:
        """How many values were measured."""


@dataclass(frozen=True)
class Problem(ABC):
    """A model, what is free of it, and what it is held against."""

    measured: Data
    unknowns: tuple[Unknown, ...]
    steps: Floats
    """Of difference quotients, in coordinates, shape (p,)"""

    @abstractmethod
    def answers(self, place: Floats) -> Any:
        """What the model says at a place, by the names of what was measured, shape (n,) each.

        Raises:
            UsageError: parameters make no model.
        """

    @abstractmethod
    def predicted(self, place: Floats) -> Results | dict[str, Floats]:
        """The same with all there is to results.

        Raises:
            UsageError: parameters make no model, or inputs are none of a knee.
        """

    @abstractmethod
    def doubts(self, place: Floats) -> list[str]:
        """What of the answers speaks against a fit, a sentence each."""

    def remarks(self, place: Floats) -> list[str]:  # noqa: ARG002
        """What else there is to say of a fit, a line each."""
        return []

    def also(self, place: Floats) -> dict[str, Any]:  # noqa: ARG002
        """Parameters that follow from a fit, beside the fitted ones."""
        return {}

    @property
    def start(self) -> Floats:
        """Coordinates to start from, shape (p,)."""
        return np.array([unknown.coordinate(unknown.start) for unknown in self.unknowns])

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Ends of the coordinates, shape (p,) each."""
        low, high = zip(*(unknown.bounds for unknown in self.unknowns), strict=True)
        return np.array(low), np.array(high)

    def values(self, place: Floats) -> dict[str, float]:
        """Parameters at a place, coordinates of shape (p,)."""
        return {unknown.name: unknown.value(float(each)) for unknown, each in zip(self.unknowns, place, strict=True)}

    def misfits(self, place: Floats) -> dict[str, Floats]:
        """Answers less measurements in their unit, of each column where it was measured.

        Raises:
            UsageError: as `answers`.
        """
        answers, measured = self.answers(place), self.measured.answers
        return {name: (answers[name] - column)[np.isfinite(column)] for name, column in measured.items()}

    def residuals(self, place: Floats, noise: Noise) -> Floats:
        """The same in units of the noise, one column after another; `FAR` where there is no model."""
        try:
            return self.scaled(self.misfits(place), noise)
        except UsageError:
            return np.full(self.measured.number, FAR)

    def scaled(self, misfits: Mapping[str, Floats], noise: Noise) -> Floats:
        """Misfits in units of the noise, one column after another."""
        return np.concatenate([misfits[name] / noise[name] for name in misfits])

    def jacobian(self, place: Floats, noise: Noise, which: Floats | None = None) -> Floats:
        """Slopes of the residuals over the coordinates `which` (all of them by default), by central differences."""
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
        """The same with steps that fit what the data resolve around a place."""
        sizes = np.linalg.norm(self.jacobian(place, noise), axis=0)
        return replace(self, steps=np.clip(PART / np.maximum(sizes, 1.0), LEAST_STEP, STEP))
