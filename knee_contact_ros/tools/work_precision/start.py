"""Start and reference solution of a problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision import reference
from knee_contact_ros.tools.work_precision import reference_laws as laws
from knee_contact_ros.tools.work_precision.problems import EXPONENT, Problem
from knee_contact_ros.tools.work_precision.reference_femur import ByDepth, circle


def scene(problem: Problem) -> reference.Scene:
    """Describe a problem in the form that the reference solver takes."""
    layers = (
        laws.two_layer(problem.stiffness, EXPONENT, problem.damping, problem.layer_depth, problem.stiffness_2,
                       problem.damp_first_layer)
        if problem.layered
        else laws.kelvin_voigt(problem.stiffness, EXPONENT, problem.damping)
    )  # fmt: skip
    return reference.Scene(
        problem.time, np.zeros_like(problem.time), problem.load, layers, problem.mass, ByDepth(circle)
    )


def start_depth(problem: Problem) -> float:
    """Depth [m] of a problem at rest under the first load."""
    return reference.static_depth(scene(problem))


def exact_depth(problem: Problem) -> NDArray[np.float64]:
    """Signed depth [m] of a problem at every tick by the reference solver, shape (n,)."""
    return reference.solve(scene(problem))
