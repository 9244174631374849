"""diffrax, in 64 bits: runs of one knee as functions that JAX compiles (`jit`).

The state is the depth [m] and its rate [m/s] times `RATE_UNIT` [s]. The constants of a knee are stiffness, damping and
1 / mass; of a second layer also its begin [m], the force there [N], stiffness and damping. Options of a run are those
of `diffrax.diffeqsolve`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.measure import Outcome, Setting, Solver, half_decades, stopwatch
from benchmarks.peers.problems import DEPTH_SCALE, RATE_UNIT, Problem, start_depth

jax.config.update("jax_enable_x64", True)

FIRST_STEPS = {"Tsit5": 3, "Dopri8": 1}
"""Steps per tick that a method begins with"""


def rates(state: Any, load: Any, constants: Any) -> Any:
    """Rates of change [m/s] of the depth and of the scaled rate under a load [N]; d^1.5 is d sqrt(d)."""
    depth, scaled = state
    stiffness, damping, inverse_mass, *second = constants
    rate = scaled / RATE_UNIT
    inside = jnp.maximum(depth, 0.0)
    force = stiffness * inside * jnp.sqrt(inside) + damping * rate
    if second:
        begin, base, stiffness_2, damping_2 = second
        below = jnp.maximum(depth - begin, 0.0)
        deep = base + stiffness_2 * below * jnp.sqrt(below) + damping_2 * rate
        force = jnp.where(depth > begin, deep, force)
    pressing = jnp.where(depth > 0.0, jnp.maximum(force, 0.0), 0.0)
    return rate, (load - pressing) * inverse_mass * RATE_UNIT


def in_series(time: Any, state: Any, arguments: Any) -> Any:
    """Right-hand side over the series; times [s] count from its begin, and the load is found by index."""
    constants, loads, tick = arguments
    ticks = time / tick
    i = jnp.clip(ticks.astype(int), 0, len(loads) - 2)
    return rates(state, loads[i] + (loads[i + 1] - loads[i]) * (ticks - i), constants)


def in_tick(time: Any, state: Any, arguments: Any) -> Any:
    """Right-hand side over a tick; times [s] count from its begin."""
    constants, begin, slope = arguments
    return rates(state, begin + slope * time, constants)


def control(tolerance: Any) -> Any:
    """Control the error by a relative tolerance."""
    return diffrax.PIDController(rtol=tolerance, atol=tolerance * DEPTH_SCALE)


def series(method: str, **options: Any) -> Callable[..., Any]:
    """Build a run over the whole series.

    It takes start [m], constants, loads [N], a tick's duration [s] and a relative tolerance; returns the depths [m].
    """

    def solve(start: Any, constants: Any, loads: Any, tick: Any, value: Any) -> Any:
        stamps = jnp.arange(len(loads)) * tick
        return diffrax.diffeqsolve(
            diffrax.ODETerm(in_series),
            getattr(diffrax, method)(),
            0.0,
            stamps[-1],
            tick / FIRST_STEPS[method],
            (start, jnp.zeros_like(start)),
            (constants, loads, tick),
            saveat=diffrax.SaveAt(ts=stamps, fn=lambda _time, state, _arguments: state[0]),
            stepsize_controller=control(value),
            throw=False,
            **options,
        ).ys

    return solve


def one_tick(method: str, **options: Any) -> Callable[..., Any]:
    """Build a run over one tick.

    It takes a state, constants, the loads [N] at both ends, the duration [s] and a relative tolerance, and returns the
    state at the end.
    """

    def step(state: Any, constants: Any, ramp: Any, tick: Any, value: Any) -> Any:
        before, load = ramp
        answer = diffrax.diffeqsolve(
            diffrax.ODETerm(in_tick),
            getattr(diffrax, method)(),
            0.0,
            tick,
            tick / FIRST_STEPS[method],
            state,
            (constants, before, (load - before) / tick),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=control(value),
            throw=False,
            **options,
        )
        return tuple(column[0] for column in answer.ys)

    return step


def tick_by_tick(step: Callable[..., Any]) -> Callable[..., Any]:
    """Build a run over the whole series from a run over one tick, with `lax.scan`; arguments are those of `series`."""

    def solve(start: Any, constants: Any, loads: Any, tick: Any, value: Any) -> Any:
        def one(state: Any, ramp: Any) -> Any:
            state = step(state, constants, ramp, tick, value)
            return state, state[0]

        _, depths = jax.lax.scan(one, (start, jnp.zeros_like(start)), (loads[:-1], loads[1:]))
        return jnp.concatenate([start[None], depths])

    return solve


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
        Solver(
            f"diffrax {method}",
            "diffrax",
            LAW,
            settings,
            *(partial(run, method) for run in (whole, stream, loop)),
        )
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
    step = compiled(method).tick
    start, constants, _, tick = arguments_of(problem)
    loads = problem.load.tolist()
    value = setting.value
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
    options: dict[str, Any] = {"max_steps": MOST_STEPS, "adjoint": diffrax.ForwardMode()}
    step = one_tick(method, **options)
    runs = series(method, **options), tick_by_tick(step), step
    return Compiled(*map(jax.jit, runs))


def arguments_of(problem: Problem) -> tuple[Any, ...]:
    """Start [m], the law's constants, loads [N] and the duration of a tick [s] as arrays of JAX."""
    constants = [problem.stiffness, problem.first_damping, 1.0 / problem.mass]
    if problem.layered:
        constants += [
            problem.layer_depth,
            problem.layer_force,
            problem.stiffness_2,
            problem.damping,
        ]
    tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
    return (
        jnp.array(start_depth(problem)),
        tuple(map(jnp.array, constants)),
        jnp.array(problem.load),
        jnp.array(tick),
    )
