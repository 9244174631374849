"""diffrax: one knee through JAX, in 64 bits, compiled by XLA."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE, RATE_UNIT
from knee_contact_ros.tools.work_precision.problems import EXPONENT, Problem
from knee_contact_ros.tools.work_precision.solver import Outcome, Run, Setting, Solver, half_decades, stopwatch
from knee_contact_ros.tools.work_precision.start import start_depth

LAW = (
    "exact: `diffeqsolve` under `jit`; one call with the load found by index, or one per tick, which Python calls for "
    "every sample or `lax.scan` for all of them"
)
METHODS = ("Tsit5", "Dopri8")
"""Kvaerno5 takes 7 times as long and more; equal steps, and the ticks told as jumps, save nothing with one knee"""
FIRST_STEPS = {"Tsit5": 3, "Dopri8": 1}
"""Per tick, to begin with"""
MOST_STEPS = 1_000_000


def solvers() -> list[Solver]:
    """One per method."""
    settings = half_decades(3, 12)
    return [
        Solver(f"diffrax {method}", "diffrax", LAW, settings, whole(method), stream(method), loop(method))
        for method in METHODS
    ]


def whole(method: str) -> Run:
    """One call, output at every tick."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        return in_one_call(compiled_series(method), problem, setting)

    return run


def loop(method: str) -> Run:
    """One call with `lax.scan`, which takes the samples one by one."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        return in_one_call(compiled_ticks(method)[1], problem, setting)

    return run


def in_one_call(solve: Any, problem: Problem, setting: Setting) -> Outcome:
    """Call it once to compile it, and once to time it."""
    given = *given_to(problem), setting.value
    np.asarray(solve(*given))
    with stopwatch() as watch:
        depths = np.asarray(solve(*given))  # waits for it
    return Outcome(depths, watch.seconds)


def stream(method: str) -> Run:
    """A compiled call for every sample."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        step = compiled_ticks(method)[0]
        start, constants, _, tick = given_to(problem)
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

    return run


def given_to(problem: Problem) -> tuple[Any, ...]:
    """Start [m], the law's constants, loads [N] and the tick's duration [s], where the tool has them."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    damping = problem.damping if problem.damp_first_layer or not problem.layered else 0.0
    constants = [problem.stiffness, damping, 1.0 / problem.mass]
    if problem.layered:
        base = problem.stiffness * problem.layer_depth**EXPONENT
        constants += [problem.layer_depth, base, problem.stiffness_2, problem.damping]
    tick = (problem.time[-1] - problem.time[0]) / (len(problem.time) - 1)
    return jnp.array(start_depth(problem)), tuple(map(jnp.array, constants)), jnp.array(problem.load), jnp.array(tick)


def rates(state: Any, load: Any, constants: Any) -> Any:
    """Rates of change of the depth and of the scaled rate."""
    import jax.numpy as jnp

    depth, scaled = state
    stiffness, damping, inverse_mass, *second = constants
    rate, inside = scaled / RATE_UNIT, jnp.maximum(depth, 0.0)
    force = stiffness * inside * jnp.sqrt(inside) + damping * rate
    if second:
        begin, base, stiffness_2, damping_2 = second
        below = jnp.maximum(depth - begin, 0.0)
        deep = base + stiffness_2 * below * jnp.sqrt(below) + damping_2 * rate
        force = jnp.where(depth > begin, deep, force)
    pressing = jnp.where(depth > 0.0, jnp.maximum(force, 0.0), 0.0)
    return rate, (load - pressing) * inverse_mass * RATE_UNIT


def control(value: Any) -> Any:
    """Error control by a relative tolerance."""
    import diffrax

    return diffrax.PIDController(rtol=value, atol=value * DEPTH_SCALE)


@functools.cache
def compiled_series(method: str) -> Any:
    """From what `given_to` gives, and the tolerance, to the depths."""
    import diffrax
    import jax
    import jax.numpy as jnp

    def motion(time: Any, state: Any, given: Any) -> Any:
        constants, loads, tick = given
        ticks = time / tick
        i = jnp.clip(ticks.astype(int), 0, len(loads) - 2)
        return rates(state, loads[i] + (loads[i + 1] - loads[i]) * (ticks - i), constants)

    def solve(start: Any, constants: Any, loads: Any, tick: Any, value: Any) -> Any:
        stamps = jnp.arange(len(loads)) * tick
        return diffrax.diffeqsolve(
            diffrax.ODETerm(motion), getattr(diffrax, method)(), 0.0, stamps[-1],
            tick / FIRST_STEPS[method], (start, jnp.zeros_like(start)), (constants, loads, tick),
            saveat=diffrax.SaveAt(ts=stamps, fn=lambda _time, state, _given: state[0]),
            stepsize_controller=control(value), max_steps=MOST_STEPS, throw=False,
            adjoint=diffrax.ForwardMode(),
        ).ys  # fmt: skip

    return jax.jit(solve)


@functools.cache
def compiled_ticks(method: str) -> tuple[Any, Any]:
    """A tick's function, and one for all ticks."""
    import diffrax
    import jax
    import jax.numpy as jnp

    def motion(time: Any, state: Any, given: Any) -> Any:
        constants, begin, slope = given
        return rates(state, begin + slope * time, constants)

    def step(state: Any, constants: Any, ramp: Any, tick: Any, value: Any) -> Any:
        before, load = ramp
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(motion), getattr(diffrax, method)(), 0.0, tick, tick / FIRST_STEPS[method],
            state, (constants, before, (load - before) / tick), saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=control(value), max_steps=MOST_STEPS, throw=False,
            adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        return tuple(column[0] for column in found.ys)

    def solve(start: Any, constants: Any, loads: Any, tick: Any, value: Any) -> Any:
        def one(state: Any, ramp: Any) -> Any:
            state = step(state, constants, ramp, tick, value)
            return state, state[0]

        _, depths = jax.lax.scan(one, (start, jnp.zeros_like(start)), (loads[:-1], loads[1:]))
        return jnp.concatenate([start[None], depths])

    return jax.jit(step), jax.jit(solve)
