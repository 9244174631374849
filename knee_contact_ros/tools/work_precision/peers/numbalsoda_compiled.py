"""numbalsoda: LSODA in C++ and DOP853 in Fortran, called in code that Numba compiles."""

from __future__ import annotations

from knee_contact_ros.tools.work_precision.compiled.runs import modes
from knee_contact_ros.tools.work_precision.solver import Solver, half_decades

LAW = (
    "exact: right-hand side compiled by Numba, called by its address; one call with the load found by index, or one "
    "call per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
METHODS = ("LSODA", "DOP853")
"""As in `compiled.numbalsoda`, which cannot be imported without the tool"""


def solvers() -> list[Solver]:
    """One solver per method."""
    settings = half_decades(3, 13)
    return [
        Solver(f"numbalsoda {name}", "numbalsoda", LAW, settings, *modes("numbalsoda", number))
        for number, name in enumerate(METHODS)
    ]
