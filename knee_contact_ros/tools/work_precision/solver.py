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

WHOLE, LOOP, STREAM = "whole", "loop", "stream"
"""Ways to run: all samples known; one after another, in a loop of the tool's or of compiled code; when each arrives"""
MODES = (WHOLE, LOOP, STREAM)


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
    """Every tick solved when its sample arrives, a call from Python for each: nothing later is known"""
    loop: Run | None = None
    """Likewise, but the samples lie in memory and compiled code takes them one after another"""

    def way(self, mode: str) -> Run | None:
        """Its run in a mode, if there is one."""
        return {WHOLE: self.whole, LOOP: self.loop, STREAM: self.stream}[mode]


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


def half_decades(first: int, last: int) -> list[Setting]:
    """Settings 1e-4, 3e-5, 1e-5 and so on."""
    halves = [(f"{digit}e-{exponent}", float(f"{digit}e-{exponent}")) for exponent in range(first, last + 1)
              for digit in ((1,) if exponent == first else (3, 1))]  # fmt: skip
    return [Setting(*each) for each in halves]


def steps_per_tick(*counts: int) -> list[Setting]:
    """Settings for steps of equal size."""
    return [Setting(f"{count} per tick", float(count)) for count in counts]
