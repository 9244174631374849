"""The problems: a femur pressed onto the plateau by a load that is known at the ticks, and their reference solutions.

All are a circle on a level plane at rest in flexion, so that one coordinate is left: the depth d [m]. With the load L,
linear between the ticks, and the force F of the contact, which never pulls: m d'' = L(t) - F(d, d').
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import reference
from benchmarks.gait import gait

DEPTH_SCALE, RATE_SCALE = 1e-3, 1e-1
"""Depth [m] and rate [m/s] to which absolute tolerances are relative: those that occur"""
RATE_UNIT = DEPTH_SCALE / RATE_SCALE
"""Time [s] that scales rates to depths, for tools that take one absolute tolerance for all of the state"""
EXPONENT = 1.5
K1, K2 = 7.905694e7, 3.112e9
BASE, PEAK = 150.0, 1615.0
SMOOTH = ("gait", "gait, 1 kg", "bag, right", "bag, left")
"""Problems that stay in contact, in one layer"""
EVENTFUL = ("lift-off", "osteoarthritis", "impact")
"""Problems that lift off and land, or go from layer to layer"""


class Problem(NamedTuple):
    """A knee and its load; the solution is the signed depth at every tick, from rest under the first load."""

    name: str
    about: str
    time: NDArray[np.float64]
    """[s], shape (n,), increasing"""
    load: NDArray[np.float64]
    """[N], shape (n,), > 0 when it presses; linear between the ticks"""
    mass: float = 9.3014
    """[kg]"""
    stiffness: float = K1
    """[N/m^1.5] of the first layer"""
    damping: float = 5000.0
    """[N s/m]"""
    layer_depth: float = math.inf
    """[m] at which the second layer begins; infinite: there is none"""
    stiffness_2: float = K2
    """[N/m^1.5] of the second layer"""
    damp_first_layer: bool = True
    """Whether the dashpot also acts in the first of two layers; with one layer it always does"""

    @property
    def layered(self) -> bool:
        """Whether there is a second layer."""
        return math.isfinite(self.layer_depth)

    @property
    def first_damping(self) -> float:
        """Damping of the first layer [N s/m]."""
        return self.damping if self.damp_first_layer or not self.layered else 0.0

    @property
    def layer_force(self) -> float:
        """Force of the first layer's spring [N] where the second layer begins; infinite if there is none."""
        return float(self.stiffness * self.layer_depth**EXPONENT)


def problems() -> list[Problem]:
    """List the problems of the study."""
    one_second = np.arange(1001, dtype=np.float64) * 1e-3
    walk = gait_like(one_second)
    return [
        Problem("gait", "always in contact, two peaks a second", one_second, walk),
        Problem("gait, 1 kg", "the same with less inertia", one_second, walk, mass=1.0),
        Problem(
            "lift-off",
            "gait with a tensile dip: the femur lifts off and lands",
            one_second,
            tensile(one_second),
        ),
        Problem(
            "osteoarthritis",
            "two layers, as printed undamped in the first: the load crosses the jump eight times",
            one_second,
            crossing(one_second),
            layer_depth=5e-4,
            damp_first_layer=False,
        ),
        Problem(
            "impact",
            "pulled off, thrown back, hardly damped: it bounces",
            one_second[:401],
            thrown(one_second[:401]),
            damping=200.0,
        ),
        *(
            Problem(f"bag, {side}", "recorded gait, 200 Hz", *recorded(side))
            for side in ("right", "left")
        ),
    ]


def find_problems(names: tuple[str, ...] = ()) -> list[Problem]:
    """List the problems with these names, or all problems if there are no names.

    Raises:
        KeyError: no such name.
    """
    known = {problem.name: problem for problem in problems()}
    return [known[name] for name in names or known]


def gait_like(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Load [N], shape (n,), with two peaks over a base, the second one larger, at any times [s], shape (n,)."""
    return BASE + 1100.0 * bump(time, 0.28, 0.09) + (PEAK - BASE) * bump(time, 0.66, 0.11)


def tensile(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Load [N] of gait with a dip to -80 N between the peaks, shape (n,)."""
    return gait_like(time) - 302.0 * bump(time, 0.46, 0.025)


def crossing(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Load [N] from 300 to 1500 N and back four times a second, shape (n,); bone begins at 884 N."""
    return 900.0 - 600.0 * np.cos(8.0 * math.pi * time)


def thrown(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Load [N] of 300 N, then a pull as large for 20 ms, then 900 N, shape (n,)."""
    return np.interp(
        time, (0.0, 0.05, 0.06, 0.08, 0.09, 1.0), (300.0, 300.0, -300.0, -300.0, 900.0, 900.0)
    )


def bump(time: NDArray[np.float64], centre: float, width: float) -> NDArray[np.float64]:
    """Gaussian of height 1 with a centre and a width [s], at times [s], shape (n,)."""
    bell: NDArray[np.float64] = np.exp(-(((time - centre) / width) ** 2))
    return bell


def recorded(side: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time since the first stamp [s] and load [N] of the bundled bag of a side, shape (n,) each."""
    time, _, load = gait(side)
    return np.round(time - time[0], 9), load


def scene(problem: Problem) -> reference.Scene:
    """Describe a problem in the form that the reference solver takes."""
    layers = (
        reference.two_layer(
            problem.stiffness,
            EXPONENT,
            problem.damping,
            problem.layer_depth,
            problem.stiffness_2,
            problem.damp_first_layer,
        )
        if problem.layered
        else reference.kelvin_voigt(problem.stiffness, EXPONENT, problem.damping)
    )
    return reference.Scene(
        problem.time,
        np.zeros_like(problem.time),
        problem.load,
        layers,
        problem.mass,
        reference.ByDepth(reference.circle),
    )


def start_depth(problem: Problem) -> float:
    """Depth [m] of a problem at rest under the first load."""
    return reference.static_depth(scene(problem))


def exact_depth(problem: Problem) -> NDArray[np.float64]:
    """Signed depth [m] of a problem at every tick by the reference solver, shape (n,)."""
    return reference.solve(scene(problem))
