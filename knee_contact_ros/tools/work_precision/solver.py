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
"""Modes of a run: all samples known; one after another, in the tool's loop or a compiled one; when each arrives"""
MODES = (WHOLE, LOOP, STREAM)


class Setting(NamedTuple):
    """A tolerance, or a number of steps per tick."""

    label: str
    value: float


class Outcome(NamedTuple):
    """Answer and time of one run."""

    depth: NDArray[np.float64]
    """Signed depth [m] at every tick, shape (n,)"""
    seconds: float
    """Processor time [s] of the run alone, without set-up, compilation and the building of models"""
    evaluations: float = math.nan
    """Evaluations of the contact force; nan if the tool does not count them"""
    note: str = ""
    """Why the run failed; empty if it did not"""


Run = Callable[[Problem, Setting], Outcome]


class Solver(NamedTuple):
    """A way to solve a problem."""

    name: str
    peer: str
    """Name of the tool that it belongs to"""
    law: str
    """How it expresses the contact law: one sentence"""
    settings: Sequence[Setting]
    """Settings to be tried, from coarse to fine"""
    whole: Run | None
    """Run of the whole series in one call, with output at every tick; None if the tool has none"""
    stream: Run | None
    """Run that solves every tick when its sample arrives, by a call from Python for each: nothing later is known"""
    loop: Run | None = None
    """Run that solves tick after tick as `stream` does, but in compiled code, with the samples in memory"""

    def run_in(self, mode: str) -> Run | None:
        """The run in one of the `MODES`, if there is one."""
        run: Run | None = getattr(self, mode)
        return run


class Stopwatch:
    """Seconds of processor time of the process: another process that takes the processor away does not count."""

    seconds = math.nan
    """Time [s], once it is over"""


@contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Time what happens inside a `with` statement."""
    watch = Stopwatch()
    begin = time.process_time_ns()
    yield watch
    watch.seconds = 1e-9 * (time.process_time_ns() - begin)


def tolerances(*exponents: int) -> list[Setting]:
    """Tolerances 1e-4, 1e-5 and so on, from their exponents 4, 5 and so on."""
    return [Setting(f"1e-{exponent}", 10.0**-exponent) for exponent in exponents]


def half_decades(first: int, last: int) -> list[Setting]:
    """Tolerances half a decade apart: 1e-4, 3e-5, 1e-5 and so on, from the first exponent (4) to the last."""
    labels = [f"{digit}e-{exponent}" for exponent in range(first, last + 1) for digit in (3, 1)]
    return [Setting(label, float(label)) for label in labels[1:]]


def steps_per_tick(*counts: int) -> list[Setting]:
    """Settings for solvers with steps of equal size."""
    return [Setting(f"{count} per tick", float(count)) for count in counts]
