"""diffrax: all knees at once through JAX, in 64 bits."""

from __future__ import annotations

import functools
import sys
from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from knee_contact_ros.tools.work_precision.motion import DEPTH_SCALE, RATE_UNIT
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "diffrax"
MOST_STEPS = 50_000
MOST_STEPS_IN_A_TICK = 200
FIRST_STEPS = {"Tsit5": 3, "Dopri5": 3, "Dopri8": 1, "Kvaerno5": 2}
"""Per tick, to begin with"""


def methods() -> list[Method]:
    """Equal steps; error control over the whole series, with its kinks as jumps, and anew in every tick."""
    found = [
        Method(TOOL, f"{solver}, equal steps", STEPS, partial(_equal_steps, solver=solver), COUNTS)
        for solver in ("Tsit5", "Dopri5", "Dopri8")
    ]
    found += [
        Method(TOOL, f"{solver}, tick by tick", TOLERANCE, partial(_anew, solver=solver), TOLERANCES)
        for solver in ("Tsit5", "Dopri8", "Kvaerno5")
    ]
    found += [
        Method(TOOL, f"Tsit5, {how}", TOLERANCE, partial(_whole, solver="Tsit5", jumps=jumps), TOLERANCES)
        for how, jumps in (("whole series", False), ("jumps told", True))
    ]
    return [method._replace(few=sys.maxsize) for method in found]  # every other number is compiled anew


def _rates(state: Any, load: Any, constants: Any) -> Any:
    depth, scaled = state
    stiffness, damping, inverse_mass = constants
    rate, inside = scaled / RATE_UNIT, jnp.maximum(depth, 0.0)
    force = jnp.maximum(stiffness * inside * jnp.sqrt(inside) + damping * rate, 0.0)
    return rate, (load - jnp.where(depth > 0.0, force, 0.0)) * inverse_mass * RATE_UNIT


def _in_series(time: Any, state: Any, given: Any) -> Any:
    """The motion along the series; times count from its begin."""
    constants, loads, tick = given
    ticks = time / tick
    i = jnp.clip(ticks.astype(int), 0, len(loads) - 2)
    return _rates(state, loads[i] + (loads[i + 1] - loads[i]) * (ticks - i), constants)


def _in_tick(time: Any, state: Any, given: Any) -> Any:
    """The motion in a tick; times count from its begin."""
    constants, begin, slope = given
    return _rates(state, begin + slope * time, constants)


def _depth(_time: Any, state: Any, _given: Any) -> Any:
    return state[0]


def _prepared(knees: Cohort, compiled: Any, tolerance: float) -> Run:
    """A call of the compiled function, which takes all numbers as arguments: one compilation does for all of them."""
    constants = tuple(jnp.array(column) for column in (knees.stiffness, knees.damping, 1.0 / knees.mass))
    start, loads, tick = jnp.array(knees.start), jnp.array(knees.load), jnp.array(knees.tick)

    def run() -> Floats:
        return np.asarray(compiled(start, constants, loads, tick, tolerance))

    return run


def _for_all(one: Any) -> Any:
    """One knee's run for all, compiled."""
    jax.config.update("jax_enable_x64", True)
    return jax.jit(jax.vmap(one, in_axes=(0, 0, None, None, None)))


def _equal_steps(knees: Cohort, count: float, _threads: int, *, solver: str) -> Run:
    return _prepared(knees, _compiled_equal_steps(solver, int(count)), 0.0)


@functools.cache
def _compiled_equal_steps(solver: str, count: int) -> Any:
    def one(start: Any, constants: Any, loads: Any, tick: Any, _tolerance: Any) -> Any:
        stamps = jnp.arange(len(loads)) * tick
        return diffrax.diffeqsolve(
            diffrax.ODETerm(_in_series), getattr(diffrax, solver)(), 0.0, stamps[-1], tick / count,
            (start, jnp.zeros_like(start)), (constants, loads, tick), saveat=diffrax.SaveAt(ts=stamps, fn=_depth),
            max_steps=count * len(loads) + 8, throw=False,
        ).ys  # fmt: skip

    return _for_all(one)


def _whole(knees: Cohort, tolerance: float, _threads: int, *, solver: str, jumps: bool) -> Run:
    return _prepared(knees, _compiled_whole(solver, jumps), tolerance)


@functools.cache
def _compiled_whole(solver: str, jumps: bool) -> Any:
    def one(start: Any, constants: Any, loads: Any, tick: Any, tolerance: Any) -> Any:
        stamps = jnp.arange(len(loads)) * tick
        control: Any = diffrax.PIDController(rtol=tolerance, atol=tolerance * DEPTH_SCALE)
        if jumps:
            control = diffrax.ClipStepSizeController(control, jump_ts=stamps[1:-1])
        return diffrax.diffeqsolve(
            diffrax.ODETerm(_in_series), getattr(diffrax, solver)(), 0.0, stamps[-1], tick / FIRST_STEPS[solver],
            (start, jnp.zeros_like(start)), (constants, loads, tick), saveat=diffrax.SaveAt(ts=stamps, fn=_depth),
            stepsize_controller=control, max_steps=MOST_STEPS, throw=False,
        ).ys  # fmt: skip

    return _for_all(one)


def _anew(knees: Cohort, tolerance: float, _threads: int, *, solver: str) -> Run:
    return _prepared(knees, _compiled_anew(solver), tolerance)


@functools.cache
def _compiled_anew(solver: str) -> Any:
    def one(start: Any, constants: Any, loads: Any, tick: Any, tolerance: Any) -> Any:
        control = diffrax.PIDController(rtol=tolerance, atol=tolerance * DEPTH_SCALE)

        def one_tick(state: Any, load: Any) -> Any:
            found = diffrax.diffeqsolve(
                diffrax.ODETerm(_in_tick), getattr(diffrax, solver)(), 0.0, tick, tick / FIRST_STEPS[solver], state,
                (constants, *load), saveat=diffrax.SaveAt(t1=True), stepsize_controller=control,
                max_steps=MOST_STEPS_IN_A_TICK, throw=False,
            )  # fmt: skip
            state = tuple(column[0] for column in found.ys)
            return state, state[0]

        _, depths = jax.lax.scan(one_tick, (start, jnp.zeros_like(start)), (loads[:-1], jnp.diff(loads) / tick))
        return jnp.concatenate([start[None], depths])

    return _for_all(one)
