"""diffrax: one knee through JAX, in 64 bits, compiled by XLA."""

from __future__ import annotations

import functools
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.tools.work_precision.problems import Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Setting, Solver, half_decades, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: `diffeqsolve` under `jit`; one call with the load found by index, or one per tick, which Python calls for "
    "every sample or `lax.scan` for all of them"
)
METHODS = ("Tsit5", "Dopri8")
"""Kvaerno5 takes 7 times as long and more; equal steps, and the ticks told as jumps, save nothing with one knee"""
MOST_STEPS = 1_000_000


def solvers() -> list[Solver]:
    """One solver per method."""
    settings = half_decades(3, 12)
    return [
        Solver(f"diffrax {method}", "diffrax", LAW, settings, *(partial(run, method) for run in (whole, stream, loop)))
        for method in METHODS
    ]


def whole(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call, with output at every tick."""
    return in_one_call(compiled(method).series, problem, setting)


def loop(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem in one call with `lax.scan`, which takes the samples one by one."""
    return in_one_call(compiled(method).ticks, problem, setting)


def in_one_call(solve: Any, problem: Problem, setting: Setting) -> Outcome:
    """Call a compiled run once to compile it, and once to time it."""
    arguments = *arguments_of(problem), setting.value
    np.asarray(solve(*arguments))
    with stopwatch() as watch:
        depths = np.asarray(solve(*arguments))  # waits for it
    return Outcome(depths, watch.seconds)


def stream(method: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a compiled call for every sample."""
    step, (start, constants, _, tick) = compiled(method).tick, arguments_of(problem)
    loads, value = problem.load.tolist(), setting.value
    state = start, start * 0.0
    step(state, constants, (loads[0], loads[1]), tick, value)  # compiles
    depths = [float(start)]
    with stopwatch() as watch:
        before = loads[0]
        for load in loads[1:]:
            state = step(state, constants, (before, load), tick, value)
            depths.append(float(state[0]))
            before = load
    return Outcome(np.array(depths), watch.seconds)


class Compiled(NamedTuple):
    """Runs of a method that XLA compiles at their first call."""

    series: Any
    ticks: Any
    tick: Any


@functools.cache
def compiled(method: str) -> Compiled:
    """Runs of a method over the series, tick by tick over the series, and over one tick."""
    import diffrax
    import jax

    from knee_contact_ros.tools.work_precision.compiled.diffrax import FIRST_STEPS, one_tick, series, tick_by_tick

    options: dict[str, Any] = {"max_steps": MOST_STEPS, "adjoint": diffrax.ForwardMode()}
    step = one_tick(method, **options)
    runs = series(method, FIRST_STEPS[method], **options), tick_by_tick(step), step
    return Compiled(*map(jax.jit, runs))


def arguments_of(problem: Problem) -> tuple[Any, ...]:
    """Start [m], the law's constants, loads [N] and the duration of a tick [s] as arrays of JAX."""
    import jax.numpy as jnp

    constants = [problem.stiffness, problem.first_damping, 1.0 / problem.mass]
    if problem.layered:
        constants += [problem.layer_depth, problem.layer_force, problem.stiffness_2, problem.damping]
    tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
    return jnp.array(start_depth(problem)), tuple(map(jnp.array, constants)), jnp.array(problem.load), jnp.array(tick)
