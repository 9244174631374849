"""The kernel `ticks.run`, plain or compiled: when compiling pays, and what it is compiled for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np

from knee_contact_ros.model import ticks
from knee_contact_ros.model.compiler import COMPILING, compiled, kept_files_of
from knee_contact_ros.model.contact import KneeConstants
from knee_contact_ros.model.laws import hertz
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.profiles import Circle
from knee_contact_ros.model.run_state import STATE_SIZE
from knee_contact_ros.model.surfaces import ContactPair, Plane
from knee_contact_ros.model.types import ROW, Bytes, Counts, Floats, Rows, blank_answers

PLAIN_TICK = 0.3e-3
"""Processor time [s] of an uncompiled tick in gait"""
LOADING = 0.7
"""Processor time [s] of loading the kept file, with Numba's import"""
kept_files = partial(kept_files_of, ticks.run)
"""Return the files in which the compiled kernel is kept, for any processor, without importing Numba."""


def kernel_views(rows: Rows) -> tuple[Floats, Bytes, Counts]:
    """Return views of contiguous rows of answers as words, bytes and half words, each of shape (n, k)."""
    count, size = len(rows), ROW.itemsize
    return (
        rows.view(np.float64).reshape(count, size // 8),
        rows.view(np.uint8).reshape(count, size),
        rows.view(np.uint32).reshape(count, size // 4),
    )


def example_call() -> tuple[Any, ...]:
    """Return arguments of `ticks.run`; a knee of any law, surface and mechanism has the types of this one."""
    knee = KneeConstants(
        surfaces=ContactPair(Circle(0.034), Plane(0.0), MECHANISMS["hinge"]()).surfaces,
        law=hertz(stiffness=1e7, exponent=1.5).rows,
        mass=1.0,
        per_mass=1.0,
        tolerance=1e-6,
        force_tolerance=0.0,
        budget=1,
        level=ticks.DYNAMIC,
        allow_tension=False,
        remembers_impact=False,
        plausible_depth=1e-3,
    )
    return knee, np.zeros(STATE_SIZE), np.zeros((1, 4)), *kernel_views(blank_answers(1))


def worth_compiling(number: int | None) -> bool:
    """Return whether compiling is faster for a number of ticks; None (unknown): whether the compiled kernel is kept."""
    if compiled_run.cache_info().currsize:
        return compiled_run() is not None
    plain = COMPILING if number is None else number * PLAIN_TICK
    return plain > LOADING and (plain > COMPILING or bool(kept_files()))


@cache
def compiled_run() -> Callable[..., None] | None:
    """Return the compiled `ticks.run`, ready for its first call; None, with a warning, if Numba cannot be used."""
    return compiled(ticks.run, example_call())
