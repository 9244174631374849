"""A femur with a closed-form support, so that no spline's error is measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from knee_contact_ros.model.profiles import (
    CELL_CHECKS,
    CELL_NODES,
    CELLS,
    DEGREE,
    NO_TABLE,
    Circle,
    KernelTable,
    cell_polynomials,
)
from knee_contact_ros.model.types import Floats

CLOSE_ENOUGH = 1e-12
"""Error [m] of a polynomial of the support beyond which a callable is not smooth"""


class Ellipse(NamedTuple):
    """An ellipse about the reference point."""

    a: float
    """Half axis, anterior [m]"""
    b: float
    """Half axis, superior [m]"""

    def support(self, angle: float) -> tuple[float, float]:
        """Return the support [m] at a flexion angle [rad], and its slope [m/rad]."""
        a, b = self.a, self.b
        sine, cosine = math.sin(angle), math.cos(angle)
        h = math.sqrt(a * a * sine * sine + b * b * cosine * cosine)
        return h, (a * a - b * b) * sine * cosine / h


@dataclass(frozen=True)
class SmoothFemur(Circle):
    """A convex femur in closed form, for a plane tibia only."""

    radius: float = 0.0
    """0: it is no circle"""
    closed_form: Callable[[float], tuple[float, float]] = Ellipse(0.034, 0.034).support
    """Function of the angle [rad] to h [m] and h' [m/rad]"""

    def support(self, angle: float) -> tuple[float, float]:
        """Return h [m] and h' [m/rad] at an angle [rad]."""
        return self.closed_form(angle)

    @property
    def largest_radius(self) -> float:
        """Upper bound of the distance [m] of the surface's points from the reference point."""
        return float(np.hypot(*self.outline().T).max()) * (1.0 + 1e-3)

    def outline(self) -> Floats:
        """Return points around the femur, shape (n, 2) [m]."""
        angles = np.linspace(0.0, math.tau, 181)
        h, slope = np.array([self.support(angle) for angle in angles.tolist()]).T
        sine, cosine = np.sin(angles), np.cos(angles)
        return -np.stack([sine * h + cosine * slope, cosine * h - sine * slope], axis=1)

    @cached_property
    def on_plane(self) -> KernelTable:
        """The support function for the kernel.

        Raises:
            ValueError: it is not smooth.
        """

        def values(t: Floats) -> Floats:
            angles = (np.arange(CELLS)[:, None] + 0.5 + t) * (math.tau / CELLS)
            return np.array([self.support(angle) for angle in angles.ravel().tolist()]).reshape(
                CELLS, -1, 2
            )

        tried = values(CELL_CHECKS)
        cells, error = cell_polynomials(
            values(np.zeros(1))[:, 0, 0], values(CELL_NODES)[..., 1], tried[..., 1]
        )
        wrong = np.abs(
            cells @ np.vander(CELL_CHECKS, DEGREE + 1, increasing=True).T - tried[..., 0]
        ).max()
        if not max(error.max(), wrong) <= CLOSE_ENOUGH:
            raise ValueError(
                "the support function is not smooth, or its slope is not its derivative"
            )
        return NO_TABLE._replace(cells=cells)
