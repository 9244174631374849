"""Compute many cases of one recording together: their outcomes, and on request all of their answers."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.knees import Knees, Recording, Side, Values
from knee_contact_ros.cohort.outcomes import OF_A_RUN, outcomes
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.types import ROW, Rows, Status
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import half_spacing, move_along_z
from knee_contact_ros.system.errors import UsageError

TOGETHER = 16_384
"""Number of answers that a thread holds at once: some 4 MB, which fit into processors' caches"""


class Computed(NamedTuple):
    """Result of a case."""

    parameters: Parameters | None
    """All parameters of the case; None if they are not allowed"""
    sides: tuple[NDArray[Any], ...]
    """Outcomes of each compartment, records of `OF_A_RUN` of shape ()"""
    series: tuple[Rows, ...]
    """Answers of each compartment, shape (n,), if they were requested"""
    failed: str
    """Why there are no outcomes; empty if there are"""
    seconds: float
    """Time [s] that the case took: that of all cases computed together, over their number"""


class _Run(NamedTuple):
    """A compartment of a case."""

    number: int
    """Number of the case"""
    side: Side
    z: float
    """Place of the compartment in the tibia frame [m]"""


def compute(
    knees: Knees, cases: Sequence[Values], *, series: bool = False, threads: int = 1, in_all: int = 0
) -> list[Computed]:
    """Compute cases; their answers are the same bits as those of a run of each.

    Args:
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        series: Whether to keep all answers.
        threads: Number of threads; 0: one for each processor.
        in_all: Number of cases of the whole study, by which it is decided whether compiling is worthwhile.

    Returns:
        The results, in the order of the cases.
    """
    begun = time.perf_counter()
    results, runs, ticks = list[Computed](), list[_Run](), len(knees.recording.steps)
    compiled = worth_compiling(max(in_all, len(cases)) * ticks)
    for number, values in enumerate(cases):
        try:
            parameters = knees.varied(values)
            z, sides = half_spacing(parameters), knees.sides(parameters, compiled=compiled)
        except (UsageError, ValueError) as error:
            results.append(Computed(None, (), (), str(error), 0.0))
            continue
        runs += [_Run(number, side, place) for side, place in zip(sides, (-z, z), strict=False)]
        results.append(Computed(parameters, (), (), "", 0.0))
    for run in runs[:1]:
        run.side.model.kernel()  # threads find it made
    count = max(1, TOGETHER // ticks)
    together = [runs[begin : begin + count] for begin in range(0, len(runs), count)]
    with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
        computed = pool.map(partial(_computed, knees.recording, series=series), together)
        for part, (rows, answers) in zip(together, computed, strict=True):
            for i, run in enumerate(part):
                one = results[run.number]
                kept = (*one.series, answers[i]) if series else ()
                results[run.number] = one._replace(sides=(*one.sides, rows[i]), series=kept)
    seconds = (time.perf_counter() - begun) / max(len(cases), 1)
    return [result._replace(seconds=seconds) for result in results]


def outcomes_of(computed: Sequence[Computed], side: int) -> NDArray[Any]:
    """Collect the outcomes of all cases in a compartment.

    Args:
        computed: Results of k cases.
        side: 0: the only or the medial compartment; 1: the lateral one.

    Returns:
        Records of `OF_A_RUN`, shape (k,); not a number where a case has no outcomes.
    """
    rows = np.full(len(computed), np.nan, OF_A_RUN)
    for i, one in enumerate(computed):
        if side < len(one.sides):
            rows[i] = one.sides[side]
    return rows


def _computed(recording: Recording, runs: Sequence[_Run], *, series: bool) -> tuple[NDArray[Any], Sequence[Rows]]:
    """Compute k runs; give their outcomes, shape (k,), and their answers, if they are to be kept."""
    answers = np.zeros((len(runs), len(recording.steps)), ROW)
    samples = np.column_stack([recording.steps, recording.angles, np.zeros_like(recording.steps), recording.heights])
    for run, own in zip(runs, answers, strict=True):
        samples[:, 2] = run.side.loads
        for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
            run.side.model.compute(samples[begin:end], own[begin:end])
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    models = [run.side.model for run in runs]
    rows = outcomes(answers, recording.steps, [model.law for model in models], [model.patch for model in models])
    for run, own in zip(runs, answers if series else (), strict=False):
        move_along_z(own, run.z)
    return rows, tuple(answers) if series else ()
