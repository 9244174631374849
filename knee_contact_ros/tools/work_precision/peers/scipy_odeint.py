"""SciPy's `odeint`: LSODA, with its loop in C."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.motion import Ramp, absolute_tolerances, jacobian, load_at, motion, ticks
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, stopwatch, tolerances
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: right-hand side and Jacobian in plain Python; one call with the load in tables, or one call per tick, "
    "which restarts"
)
FINE_STEPS = 100_000
SUCCESS = "Integration successful."


def solvers() -> list[Solver]:
    """The one solver, LSODA."""
    return [Solver("SciPy odeint", "SciPy", LAW, tolerances(*range(4, 14)), whole, stream)]


def whole(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    from scipy.integrate import odeint

    state, options = [start_depth(problem), 0.0], options_of(problem, setting)
    function = motion(problem, load_at(problem))
    with stopwatch() as watch:
        answer, info = odeint(function, state, problem.time, full_output=True, **options)
    depth: NDArray[np.float64] = answer[:, 0]
    return Outcome(depth, watch.seconds, int(info["nfe"][-1]), "" if info["message"] == SUCCESS else info["message"])


def stream(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per tick, which does not step beyond it."""
    from scipy.integrate import odeint

    depth, options, ramp = start_depth(problem), options_of(problem, setting), Ramp()
    function, state, depths, samples = motion(problem, ramp), np.array([depth, 0.0]), [depth], ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            state = odeint(function, state, (tick.begin, tick.end), tcrit=(tick.end,), **options)[1]
            depths.append(float(state[0]))
    return Outcome(np.array(depths), watch.seconds, math.nan)


def options_of(problem: Problem, setting: Setting) -> dict[str, Any]:
    """Options of a call: tolerances, Jacobian, and as many steps as it takes."""
    return {
        "Dfun": jacobian(problem),
        "tfirst": True,
        "rtol": setting.value,
        "atol": absolute_tolerances(setting.value),
        "mxstep": FINE_STEPS,
    }
