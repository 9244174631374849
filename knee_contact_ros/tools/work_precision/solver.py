"""The one form in which every solver of the study appears, ours included."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.tools.work_precision.problems import Problem


class Setting(NamedTuple):
    """A tolerance or a step, from coarse to fine."""

    label: str
    value: float


class Outcome(NamedTuple):
    """One run."""

    depth: NDArray[np.float64]
    """Signed depth [m] at every tick, shape (n,)"""
    seconds: float
    """Of the run alone: without set-up, compilation and the building of models"""
    evaluations: float = math.nan
    """Of the contact force; nan if the tool does not tell"""
    note: str = ""


Run = Callable[[Problem, Setting], Outcome]


class Solver(NamedTuple):
    """A way to solve a problem."""

    name: str
    peer: str
    """Whose it is"""
    law: str
    """How it expresses the contact law: one sentence"""
    settings: Sequence[Setting]
    whole: Run | None
    """The run in one call, if the tool can; output at every tick"""
    stream: Run | None
    """Every tick solved when its sample arrives: nothing later is known"""


class Stopwatch:
    """Seconds of processor time of the process: another process that takes the processor away does not count."""

    seconds = math.nan
    """Once it is over"""


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Time what happens inside."""
    watch = Stopwatch()
    begin = time.process_time_ns()
    yield watch
    watch.seconds = 1e-9 * (time.process_time_ns() - begin)


def tolerances(*exponents: int) -> list[Setting]:
    """Settings 1e-4 and the like."""
    return [Setting(f"1e-{exponent}", 10.0**-exponent) for exponent in exponents]


def steps_per_tick(*counts: int) -> list[Setting]:
    """Settings for steps of equal size."""
    return [Setting(f"{count} per tick", float(count)) for count in counts]
