"""SciPy: `solve_ivp` and the solver objects behind it, `odeint`, and `solve_ivp` stopped at every event."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.measure import Outcome, Setting, Solver, stopwatch, tolerances
from benchmarks.peers.motion import (
    End,
    Load,
    Piece,
    Pieces,
    Ramp,
    State,
    Value,
    absolute_tolerances,
    jacobian,
    load_at,
    motion,
    ticks,
)
from benchmarks.peers.problems import Problem, start_depth

IVP = "exact: right-hand side in plain Python{}; one call with the load in tables, or a fresh solver for every tick"
METHODS = ("LSODA", "Radau", "DOP853", "RK45")
IMPLICIT = ("LSODA", "Radau")


def solvers() -> list[Solver]:
    """One solver per method of `solve_ivp`, `odeint`, and the method that is quickest with events."""
    settings = tolerances(*range(4, 14))
    by_method = [
        Solver(f"SciPy {method}", "SciPy", IVP.format(" with its Jacobian" if method in IMPLICIT else ""), settings,
               partial(ivp_whole, method), partial(ivp_stream, method))
        for method in METHODS
    ]  # fmt: skip
    return [
        *by_method,
        Solver("SciPy odeint", "SciPy", ODEINT, settings, odeint_whole, odeint_stream),
        Solver(f"SciPy {WITH_EVENTS}, events", "SciPy", EVENTS, settings, events_whole, events_stream),
    ]


def ivp_whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem by `solve_ivp` with output at every tick."""
    from scipy.integrate import solve_ivp

    function, state, time = motion(problem, load_at(problem)), [start_depth(problem), 0.0], problem.time
    options = ivp_options(problem, method, setting.value)
    with stopwatch() as watch:
        answer = solve_ivp(function, (time[0], time[-1]), state, method=method, t_eval=time, **options)
    return Outcome(answer.y[0], watch.seconds, answer.nfev, "" if answer.success else answer.message)


def ivp_stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a solver object per tick, which begins with the last step of the one before."""
    from scipy import integrate

    make: Callable[..., Any] = getattr(integrate, method)
    ramp, state, depths, evaluations = Ramp(), np.array([start_depth(problem), 0.0]), [start_depth(problem)], 0
    function, options, step = motion(problem, ramp), ivp_options(problem, method, setting.value), None
    samples = ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            first = None if step is None else min(step, tick.end - tick.begin)
            solver = make(function, tick.begin, state, tick.end, first_step=first, **options)
            while solver.status == "running":
                solver.step()
            state, step = solver.y, solver.step_size or None
            evaluations += solver.nfev
            depths.append(float(state[0]))
    return Outcome(np.array(depths), watch.seconds, evaluations)


def ivp_options(problem: Problem, method: str, tolerance: float) -> dict[str, Any]:
    """Options of a method: tolerances, and the Jacobian if it takes one."""
    options: dict[str, Any] = {"rtol": tolerance, "atol": absolute_tolerances(tolerance)}
    return options | ({"jac": jacobian(problem)} if method in IMPLICIT else {})


ODEINT = (
    "exact: right-hand side and Jacobian in plain Python; one call with the load in tables, or one call per tick, "
    "which restarts"
)
FINE_STEPS = 100_000
SUCCESS = "Integration successful."


def odeint_whole(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    from scipy.integrate import odeint

    state, options = [start_depth(problem), 0.0], odeint_options(problem, setting)
    function = motion(problem, load_at(problem))
    with stopwatch() as watch:
        answer, info = odeint(function, state, problem.time, full_output=True, **options)
    depth: NDArray[np.float64] = answer[:, 0]
    return Outcome(depth, watch.seconds, int(info["nfe"][-1]), "" if info["message"] == SUCCESS else info["message"])


def odeint_stream(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per tick, which does not step beyond it."""
    from scipy.integrate import odeint

    depth, options, ramp = start_depth(problem), odeint_options(problem, setting), Ramp()
    function, state, depths, samples = motion(problem, ramp), np.array([depth, 0.0]), [depth], ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            state = odeint(function, state, (tick.begin, tick.end), tcrit=(tick.end,), **options)[1]
            depths.append(float(state[0]))
    return Outcome(np.array(depths), watch.seconds, math.nan)


def odeint_options(problem: Problem, setting: Setting) -> dict[str, Any]:
    """Options of a call: tolerances, Jacobian, and as many steps as it takes."""
    return {
        "Dfun": jacobian(problem),
        "tfirst": True,
        "rtol": setting.value,
        "atol": absolute_tolerances(setting.value),
        "mxstep": FINE_STEPS,
    }


EVENTS = (
    "exact: one smooth right-hand side per piece of the law, `events` for their ends; one call per piece, tick by tick "
    "one per tick and piece"
)
WITH_EVENTS = "DOP853"
"""LSODA with events is slower than without, at every error"""
EVENTS_PER_CALL = 10_000


def events_whole(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per piece of the law, and output at every tick."""
    course = Course(problem, load_at(problem), setting.value)
    with stopwatch() as watch:
        depths = [course.depth, *course.advance(problem.time[0], problem.time[-1], problem.time[1:])]
    return Outcome(np.array(depths), watch.seconds, course.evaluations)


def events_stream(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per tick and piece."""
    ramp = Ramp()
    course = Course(problem, ramp, setting.value)
    depths, samples = [course.depth], ticks(problem)
    with stopwatch() as watch:
        for tick in samples:
            ramp.set(tick)
            course.advance(tick.begin, tick.end)
            depths.append(course.depth)
    return Outcome(np.array(depths), watch.seconds, course.evaluations)


class Course:
    """The state of a run, which is advanced from piece to piece."""

    def __init__(self, problem: Problem, load: Load, tolerance: float) -> None:
        depth = start_depth(problem)
        self.evaluations = 0
        self._state: Any = np.array([depth, 0.0])
        self._pieces = Pieces(problem, load)
        self._piece: Piece = self._pieces.start(depth)
        self._options = {"method": WITH_EVENTS, "rtol": tolerance, "atol": absolute_tolerances(tolerance)}

    @property
    def depth(self) -> float:
        """Signed depth [m] now."""
        return float(self._state[0])

    def advance(self, begin: float, end: float, output: Any = None) -> list[float]:
        """Advance from a time to another [s]; return the depths [m] at the output times [s], which increase, if any."""
        from scipy.integrate import solve_ivp

        depths: list[float] = []
        for _ in range(EVENTS_PER_CALL):
            function, ends = self._pieces.motion(self._piece), self._pieces.ends(self._piece)
            events = [event(end) for end in ends]
            stamps = None if output is None else output[len(depths) :]
            answer = solve_ivp(function, (begin, end), self._state, t_eval=stamps, events=events, **self._options)
            self.evaluations += answer.nfev
            depths += answer.y[0].tolist() if output is not None and len(answer.y) else []
            if answer.status == 1:
                begin = self._pass(ends, answer)
                if begin < end:
                    continue
            elif output is None:
                self._state = answer.y[:, -1]
            return depths
        raise RuntimeError(f"more than {EVENTS_PER_CALL} events")

    def _pass(self, ends: list[End], answer: Any) -> float:
        """Change to the piece behind an event; return the time of the event [s]."""
        hit = next(i for i, times in enumerate(answer.t_events) if len(times))
        self._state = answer.y_events[hit][-1]
        self._piece = ends[hit].behind(*self._state.tolist())
        return float(answer.t_events[hit][-1])


def event(end: End) -> Value:
    """The end of a piece as an event of `solve_ivp`."""

    def value(time: float, state: State) -> float:
        return end.value(time, state)

    value.terminal, value.direction = True, end.direction  # type: ignore[attr-defined]
    return value
