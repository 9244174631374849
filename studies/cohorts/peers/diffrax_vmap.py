"""diffrax: all knees at once through JAX, in 64 bits."""

from __future__ import annotations

import functools
import sys
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.diffrax import (
    FIRST_STEPS,
    by_tolerance,
    by_tolerance_with_jumps,
    equal_steps,
    one_tick,
    series,
    tick_by_tick,
)
from studies.cohorts.method import COUNTS, STEPS, TOLERANCE, TOLERANCES, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "diffrax"
MOST_STEPS = 50_000
MOST_STEPS_IN_A_TICK = 200


def methods() -> list[Method]:
    """List runs with equal steps, and with error control anew in every tick and over the series, kinks told or not."""
    runs = {f"{solver}, tick by tick": tick_by_tick(one_tick(solver, max_steps=MOST_STEPS_IN_A_TICK))
            for solver in ("Tsit5", "Dopri8", "Kvaerno5")}  # fmt: skip
    runs |= {f"Tsit5, {how}": series("Tsit5", FIRST_STEPS["Tsit5"], control, max_steps=MOST_STEPS)
             for how, control in (("whole series", by_tolerance), ("jumps told", by_tolerance_with_jumps))}  # fmt: skip
    found = [
        Method(TOOL, f"{solver}, equal steps", STEPS, partial(_with_equal_steps, solver=solver), COUNTS)
        for solver in ("Tsit5", "Dopri5", "Dopri8")
    ]
    found += [
        Method(TOOL, name, TOLERANCE, partial(_prepared, compiled=_for_all(run)), TOLERANCES)
        for name, run in runs.items()
    ]
    return [method._replace(few=sys.maxsize) for method in found]  # every other number is compiled anew


def _with_equal_steps(knees: Cohort, count: float, threads: int, *, solver: str) -> Run:
    return _prepared(knees, count, threads, compiled=_equal_steps(solver, int(count), knees.ticks))


@functools.cache
def _equal_steps(solver: str, count: int, ticks: int) -> Any:
    return _for_all(series(solver, count, equal_steps, max_steps=count * ticks + 8))


def _for_all(one: Any) -> Any:
    """Compile a run of one knee for all knees."""
    return jax.jit(jax.vmap(one, in_axes=(0, 0, None, None, None)))


def _prepared(knees: Cohort, setting: float, _threads: int, *, compiled: Any) -> Run:
    """Prepare a call of a compiled run, which takes all numbers as arguments: one compilation does for all of them."""
    constants = tuple(jnp.array(column) for column in (knees.stiffness, knees.damping, 1.0 / knees.mass))
    start, loads, tick = jnp.array(knees.start), jnp.array(knees.load), jnp.array(knees.tick)

    def run() -> Floats:
        return np.asarray(compiled(start, constants, loads, tick, setting))

    return run
