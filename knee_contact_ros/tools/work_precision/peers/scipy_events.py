"""SciPy's `solve_ivp`, stopped at every event of the law (touch, layer, pull) and started again behind it."""

from __future__ import annotations

from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import Load, Ramp, State, absolute_tolerances, load_at, ticks
from knee_contact_ros.tools.work_precision.piecewise import End, Piece, Pieces, Value
from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, stopwatch, tolerances
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: one smooth right-hand side per piece of the law, `events` for their ends; one call per piece, tick by tick "
    "one per tick and piece"
)
METHOD = "DOP853"
"""LSODA with events is slower than without, at every error"""
EVENTS_PER_CALL = 10_000


def solvers() -> list[Solver]:
    """The one solver, by the method that is quickest with events."""
    return [Solver(f"SciPy {METHOD}, events", "SciPy", LAW, tolerances(*range(4, 14)), whole, stream)]


def whole(problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with one call per piece of the law, and output at every tick."""
    course = Course(problem, load_at(problem), setting.value)
    with stopwatch() as watch:
        depths = [course.depth, *course.advance(problem.time[0], problem.time[-1], problem.time[1:])]
    return Outcome(np.array(depths), watch.seconds, course.evaluations)


def stream(problem: Problem, setting: Setting) -> Outcome:
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
        self._options = {"method": METHOD, "rtol": tolerance, "atol": absolute_tolerances(tolerance)}

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
