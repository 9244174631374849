"""The cohort in plain numbers, as every tool takes it, and its reference solution."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from studies.gait import gait
from studies.honesty.scenes import FEMUR, HEALTHY, KNEE, Scene
from studies.honesty.truth import reference

Floats = NDArray[np.float64]
RADIUS = 0.034
"""[m] of the femur's circle, as in config/healthy.yaml"""
SPREAD = 0.3
"""Stiffness, damping and mass are drawn evenly within this part of the healthy knee's"""
SEED = 22


class Cohort(NamedTuple):
    """Knees of one kind under one load.

    The motion, with the depth d = radius - y of a circle on a plane: M d'' = L(t) - max(0, K d^1.5 + C d') while
    d > 0, M d'' = L(t) while d <= 0; L is linear between the samples. It starts at rest in balance with the load.
    """

    time: Floats
    """[s], shape (ticks,), evenly spaced"""
    angle: Floats
    """Flexion [rad], shape (ticks,); on a circle it does not count"""
    load: Floats
    """[N], shape (ticks,)"""
    stiffness: Floats
    """K [N/m^1.5], shape (cases,)"""
    damping: Floats
    """C [N s/m], shape (cases,)"""
    mass: Floats
    """M [kg], shape (cases,)"""

    @property
    def cases(self) -> int:
        """Number of knees."""
        return len(self.mass)

    @property
    def ticks(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def tick(self) -> float:
        """Time between two samples [s]."""
        return float(self.time[-1] - self.time[0]) / (self.ticks - 1)

    @property
    def start(self) -> Floats:
        """Depth [m] in balance with the first load, shape (cases,)."""
        depth: Floats = (self.load[0] / self.stiffness) ** (2.0 / 3.0)
        return depth

    def first(self, cases: int) -> Cohort:
        """The first knees of the cohort, as many as `cases`."""
        return self._replace(**{name: getattr(self, name)[:cases] for name in ("stiffness", "damping", "mass")})


def cohort(cases: int, side: str = "right") -> Cohort:
    """Draw knees like the healthy one under the gait of a side; a small cohort is the beginning of a large one."""
    drawn = np.random.default_rng(SEED).uniform(1.0 - SPREAD, 1.0 + SPREAD, (cases, 3))
    stiffness, damping, mass = (drawn * (KNEE["stiffness"], KNEE["damping"], FEMUR)).T.copy()
    return Cohort(*gait(side), stiffness, damping, mass)


def truth(knees: Cohort) -> Floats:
    """Signed depth [m] by the independent reference, shape (cases, ticks), known to 1e-12 m.

    Raises:
        ArithmeticError: the reference is less sure of a depth.
    """
    depths = np.empty((knees.cases, knees.ticks))
    for i in range(knees.cases):
        arguments = {"stiffness": float(knees.stiffness[i]), "exponent": 1.5, "damping": float(knees.damping[i])}
        scene = Scene(
            i, HEALTHY, "kelvin_voigt", arguments, float(knees.mass[i]), (RADIUS, RADIUS), 0.0, False, "gait",
            knees.time, knees.angle, knees.load,
        )  # fmt: skip
        solution = reference(scene)
        if not np.max(solution.depth_bound) < BOUND:
            raise ArithmeticError(f"the reference knows case {i} only to {np.max(solution.depth_bound):.0e} m")
        depths[i] = solution.depth
    return depths


BOUND = 1e-12
"""[m] that the reference must be sure of"""
