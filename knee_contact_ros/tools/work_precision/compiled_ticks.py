"""Tick after tick with a solver that compiled code calls: from Python for every sample, or in a compiled loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.compiled_motion import motions, set_ramp
from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Run, Setting, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

Knee = NDArray[np.float64]
"""All that a tick needs, in one array, because every argument of a call costs: see the places below"""
SPAN, LOAD, RTOL, ATOL, NUMBERS = 2, 4, 5, 6, 7
"""Behind the state (2): a tick's begin, 0, and end [s]; last sample's load [N]; tolerances; the motion's numbers"""


class Ticker(NamedTuple):
    """Compiled functions."""

    tick: Callable[[Knee, int, float, float], float]
    """Knee, right-hand side, duration [s] and load [N] at its end to the depth [m]; nan if the solver failed"""
    loop: Callable[[Knee, int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]], None]
    """Knee, right-hand side, durations and loads of the ticks, and where their depths go"""


def ticker(advance: Any) -> Ticker:
    """Both forms of a solver.

    `advance(function, state, span, numbers, rtol, atol)` is compiled, moves a state on in place and says whether it
    could.
    """

    @njit
    def tick(knee: Any, function: int, duration: float, load: float) -> float:
        numbers = knee[NUMBERS:]
        set_ramp(numbers, knee[LOAD], (load - knee[LOAD]) / duration)
        knee[SPAN + 1], knee[LOAD] = duration, load
        moved = advance(function, knee[:SPAN], knee[SPAN:LOAD], numbers, knee[RTOL], knee[ATOL])
        return knee[0] if moved else np.nan

    @njit
    def loop(knee: Any, function: int, durations: Any, loads: Any, depths: Any) -> None:
        for i in range(len(durations)):
            depths[i] = tick(knee, function, durations[i], loads[i])

    return Ticker(tick, loop)


def knee_of(problem: Problem, tolerance: float) -> Knee:
    """At rest under the first load."""
    numbers = motions(problem).tick_numbers
    head = start_depth(problem), 0.0, 0.0, 0.0, problem.load[0], tolerance, tolerance * DEPTH_SCALE
    return np.concatenate([head, numbers])


def stream(make: Callable[[Problem], tuple[Ticker, int]]) -> Run:
    """A call from Python for every sample; `make` gives compiled functions and the right-hand side's address."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        (tick, _), function = make(problem)
        samples = list(zip(np.diff(problem.time).tolist(), problem.load[1:].tolist(), strict=True))
        tick(knee_of(problem, setting.value), function, *samples[0])  # compiles
        knee = knee_of(problem, setting.value)
        depths = [float(knee[0])]
        with stopwatch() as watch:
            for duration, load in samples:
                depths.append(tick(knee, function, duration, load))
        return Outcome(np.array(depths), watch.seconds)

    return run


def loop(make: Callable[[Problem], tuple[Ticker, int]]) -> Run:
    """One call for all samples, each of which is looked at when its tick comes."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        (_, all_ticks), function = make(problem)
        durations, loads = np.diff(problem.time), problem.load[1:].copy()
        depths = np.empty_like(problem.time)
        all_ticks(knee_of(problem, setting.value), function, durations[:1], loads[:1], depths[1:2])  # compiles
        knee = knee_of(problem, setting.value)
        depths[0] = knee[0]
        with stopwatch() as watch:
            all_ticks(knee, function, durations, loads, depths[1:])
        return Outcome(depths, watch.seconds)

    return run
