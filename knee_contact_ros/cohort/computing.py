"""Compute many cases of one recording together: their outcomes, and on request all of their answers."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.knees import Floats, Knees, Recording, Side, Values
from knee_contact_ros.cohort.outcomes import OF_A_RUN, outcomes
from knee_contact_ros.compiled.choice import announcement_for, compiler_works, worth_compiling
from knee_contact_ros.core import ticks
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.types import ROW, Rows, Status
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import half_spacing, move_along_z
from knee_contact_ros.system.errors import UsageError

TOGETHER = 16_384
"""Number of answers that a thread holds at once: some 4 MB, which fit into processors' caches"""
LARGEST = 16 * TOGETHER
"""The largest such number for cases in lanes (`compiled/lanes.py`), where few cases would leave lanes empty"""


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


class _Case(NamedTuple):
    number: int
    parameters: Parameters
    sides: tuple[Side, ...]


class _Options(NamedTuple):
    series: bool
    threads: int
    compiled: bool


def compute(
    knees: Knees, cases: Sequence[Values], *, series: bool = False, threads: int = 1, in_all: int = 0
) -> list[Computed]:
    """Compute cases; their answers are the same bits as those of a run of each.

    The contact laws are checked against their contract where one of their constants is the least or the largest one.

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
    results: list[Computed | None] = [None] * len(cases)
    tried, ready = _at_an_end(cases), []
    for number, values in enumerate(cases):
        parameters = None
        try:
            parameters = knees.varied(values)
            ready.append(_Case(number, parameters, knees.sides(parameters, tried=number in tried)))
        except (UsageError, ValueError) as error:
            results[number] = Computed(parameters, (), (), str(error), 0.0)
    for together in _of_one_kind(ready):
        scene, ticks_in_all = together[0].sides[0].scene, max(in_all, len(together)) * len(knees.recording.steps)
        options = _Options(series, threads, worth_compiling(scene, ticks_in_all))
        for case, result in zip(together, _computed(knees.recording, together, options), strict=True):
            results[case.number] = result
    seconds = (time.perf_counter() - begun) / max(len(cases), 1)
    return [result._replace(seconds=seconds) for result in results if result]


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


def _at_an_end(cases: Sequence[Values]) -> set[int]:
    """Numbers of the first case, and of those in which a number of a contact law is the least or the largest one.

    Of each text (the name of a law, for instance) there is one case, too.
    """
    ends = {0}
    for name in {name for values in cases for name in values if "contact." in name}:
        column = [(values[name], i) for i, values in enumerate(cases) if isinstance(values.get(name), float | int)]
        ends |= {min(column)[1], max(column)[1]} if column else set()
    texts = {(name, text): number for number, values in enumerate(cases) for name, text in values.items()
             if isinstance(text, str)}  # fmt: skip
    return ends | set(texts.values())


def _of_one_kind(cases: Iterable[_Case]) -> list[list[_Case]]:
    """Group cases whose scenes differ in numbers alone."""
    kinds: dict[Any, list[_Case]] = {}
    for case in cases:
        kinds.setdefault(tuple(_kind(side) for side in case.sides), []).append(case)
    return list(kinds.values())


def _kind(side: Side) -> tuple[Any, ...]:
    scene = side.scene
    surfaces = type(scene.pair), type(scene.pair.femur), type(getattr(scene.pair, "tibia", None))
    return *surfaces, type(scene.mechanism), *(type(layer.formula) for layer in side.law.layers)


def _computed(recording: Recording, cases: list[_Case], options: _Options) -> list[Computed]:
    """Compute cases of one kind, as many at once as `_at_once` says."""
    count = min(_at_once(len(recording.steps), options) * max(options.threads, 1), len(cases))
    # Memory is used again for the next cases: the system takes long to give new one.
    memory = [np.zeros((count, len(recording.steps)), ROW) for _ in cases[0].sides]
    results = []
    for begin in range(0, len(cases), count):
        part = cases[begin : begin + count]
        kept: list[tuple[Rows, ...]] = []
        rows: list[NDArray[Any]] = []
        for sides, answers in zip(zip(*(case.sides for case in part), strict=True), memory, strict=True):
            own = _answers(recording, sides, answers[: len(part)], options)
            rows.append(outcomes(own, recording.steps, [side.law for side in sides], [side.patch for side in sides]))
            kept += [tuple(own.copy())] if options.series else []
        for i, case in enumerate(part):
            series, z = tuple(of_side[i] for of_side in kept), half_spacing(case.parameters)
            for answers, place in zip(series, (-z, z), strict=False):
                move_along_z(answers, place)
            results.append(Computed(case.parameters, tuple(row[i] for row in rows), series, "", 0.0))
    return results


def _at_once(answers: int, options: _Options) -> int:
    """Number of cases that a thread computes at once, if each has so many answers."""
    count = max(1, TOGETHER // answers)
    if not options.compiled:
        return count
    from knee_contact_ros.compiled.transposed import LANES  # imports Numba: a fifth of a second

    return count - count % LANES if count >= LANES else max(count, min(LANES, LARGEST // answers))


def _answers(recording: Recording, sides: Sequence[Side], answers: Rows, options: _Options) -> Rows:
    """Compute the answers of k compartments of one kind, into memory of shape (k, n): zeros, or answers of others."""
    loads = np.stack([side.loads for side in sides])
    for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
        ours, whole = slice(begin, end), end - begin == len(recording.steps)
        part = answers if whole else np.zeros((len(sides), end - begin), ROW)
        columns = recording.steps[ours], recording.angles[ours], np.ascontiguousarray(loads[:, ours])
        _run([side.scene for side in sides], (*columns, recording.heights[ours]), part, options)
        if not whole:
            answers[:, ours] = part
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    return answers


def _run(scenes: list[Scene], columns: tuple[Floats, ...], answers: Rows, options: _Options) -> None:
    """Fill the answers of k scenes from rest, shape (k, n)."""
    steps, angles, loads, heights = columns
    if options.compiled and compiler_works():
        from knee_contact_ros.compiled.batch import run_batch  # imports Numba: a fifth of a second

        announce = announcement_for(scenes[0])
        run_batch(scenes, steps, angles, loads, heights, answers, threads=options.threads, announce=announce)
        return
    for scene, load, own in zip(scenes, loads, answers, strict=True):
        ticks.run(scene, np.zeros(1, ticks.MEMORY), steps, angles, load, heights, own)
