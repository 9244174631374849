"""CyRK: solvers in C++, called in code that Numba compiles (`nbsolve2_ivp`)."""

from __future__ import annotations

from functools import partial

from knee_contact_ros.tools.work_precision.compiled.runs import equal_steps, modes
from knee_contact_ros.tools.work_precision.solver import Solver, half_decades, steps_per_tick

LAW = (
    "exact: right-hand side compiled by Numba, called by its address; one `nbsolve2_ivp` with the load found by index, "
    "or one per tick in a compiled function, which Python calls for every sample or a compiled loop for all of them"
)
EQUAL = "exact: the same with steps of equal size, without error control, over the whole series"
METHODS = ("RK45", "Tsit5", "DOP853", "Vern7", "LSODA", "RADAU")
EQUAL_STEPS = ("RK45", "DOP853")


def solvers() -> list[Solver]:
    """One solver per method, and two with equal steps; `nbsolve_ivp`, in Numba itself, is slower than these."""
    settings, counts = half_decades(3, 13), steps_per_tick(1, 2, 3, 4, 6, 10, 20, 50, 100)
    return [
        *(Solver(f"CyRK {method}", "CyRK", LAW, settings, *modes("cyrk", method)) for method in METHODS),
        *(Solver(f"CyRK {method}, equal steps", "CyRK", EQUAL, counts, partial(equal_steps, "cyrk", method), None)
          for method in EQUAL_STEPS),
    ]  # fmt: skip
