"""Cases of one recording, computed together: rows of a table, and whole series where they are asked for."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.cohort.knees import Floats, Knees, Recording, Side, Values
from knee_contact_ros.cohort.outcomes import OF_A_RUN, outcomes
from knee_contact_ros.compiled.choice import compiler_works, telling_of, worth_compiling
from knee_contact_ros.core import ticks
from knee_contact_ros.core.types import ROW, Rows, Status
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import aside, put_aside
from knee_contact_ros.system.errors import UsageError

TOGETHER = 16_384
"""Answers that are held at once: some 4 MB, for processors' caches"""
LARGEST = 16 * TOGETHER
"""The same of cases in step (`compiled/lanes.py`), where fewer would leave lanes empty"""


class Computed(NamedTuple):
    """What a case comes to."""

    parameters: Parameters | None
    """None: they are not allowed"""
    sides: tuple[NDArray[Any], ...]
    """Outcomes of each compartment, shape ()"""
    series: tuple[Rows, ...]
    """Their answers, shape (n,), if they are asked for"""
    failed: str
    """Why there are none; empty if there are"""
    seconds: float
    """That it took"""


class _Case(NamedTuple):
    number: int
    parameters: Parameters
    sides: tuple[Side, ...]


class _How(NamedTuple):
    series: bool
    threads: int
    compiled: bool


def compute(
    knees: Knees, cases: Sequence[Values], *, series: bool = False, threads: int = 1, in_all: int = 0
) -> list[Computed]:
    """Compute cases: the same bits as a run of each, in their order; of a study of so many `in_all`.

    The laws are tried against their contract where a value of theirs is the least or the largest one.
    """
    begun = time.perf_counter()
    found: list[Computed | None] = [None] * len(cases)
    tried, ready = _at_an_end(cases), []
    for number, values in enumerate(cases):
        parameters = None
        try:
            parameters = knees.varied(values)
            ready.append(_Case(number, parameters, knees.sides(parameters, tried=number in tried)))
        except (UsageError, ValueError) as error:
            found[number] = Computed(parameters, (), (), str(error), 0.0)
    for together in _of_one_kind(ready):
        scene, number = together[0].sides[0].scene, max(in_all, len(together)) * len(knees.recording.steps)
        how = _How(series, threads, worth_compiling(scene, number))
        for case, answer in zip(together, _computed(knees.recording, together, how), strict=True):
            found[case.number] = answer
    seconds = (time.perf_counter() - begun) / max(len(cases), 1)
    return [one._replace(seconds=seconds) for one in found if one]


def outcomes_of(computed: Sequence[Computed], side: int) -> NDArray[Any]:
    """Outcomes of all cases in a compartment (0: the only or the medial one), rows of `OF_A_RUN`, shape (k,).

    Not a number where a case has none.
    """
    rows = np.full(len(computed), np.nan, OF_A_RUN)
    for i, one in enumerate(computed):
        if side < len(one.sides):
            rows[i] = one.sides[side]
    return rows


def _at_an_end(cases: Sequence[Values]) -> set[int]:
    """The first case, and those in which a number of a contact law is the least or the largest one."""
    ends = {0}
    for name in {name for values in cases for name in values if "contact." in name}:
        own = [(values[name], number) for number, values in enumerate(cases) if _is_number(values.get(name))]
        ends |= {min(own)[1], max(own)[1]} if own else set()
    texts = {(name, text): number for number, values in enumerate(cases) for name, text in values.items()
             if isinstance(text, str)}  # fmt: skip
    return ends | set(texts.values())


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int)


def _of_one_kind(cases: Iterable[_Case]) -> list[list[_Case]]:
    """Cases whose scenes differ in numbers alone, together."""
    kinds: dict[Any, list[_Case]] = {}
    for case in cases:
        kinds.setdefault(tuple(_kind(side) for side in case.sides), []).append(case)
    return list(kinds.values())


def _kind(side: Side) -> tuple[Any, ...]:
    scene = side.scene
    surfaces = type(scene.pair), type(scene.pair.femur), type(getattr(scene.pair, "tibia", None))
    return *surfaces, type(scene.mechanism), *(type(layer.formula) for layer in side.law.layers)


def _computed(recording: Recording, cases: list[_Case], how: _How) -> list[Computed]:
    """Cases of one kind, in blocks."""
    count = min(_at_once(len(recording.steps), how) * max(how.threads, 1), len(cases))
    memory = [np.zeros((count, len(recording.steps)), ROW) for _ in cases[0].sides]  # new one takes long to be had
    found = []
    for begin in range(0, len(cases), count):
        part = cases[begin : begin + count]
        sides = [list(own) for own in zip(*(case.sides for case in part), strict=True)]
        answers = [_answers(recording, own, rows[: len(part)], how) for own, rows in zip(sides, memory, strict=True)]
        rows = [
            outcomes(of_side, recording.steps, [side.law for side in own], [side.patch for side in own])
            for of_side, own in zip(answers, sides, strict=True)
        ]
        for i, case in enumerate(part):
            kept = tuple(of_side[i].copy() for of_side in answers) if how.series else ()
            z = aside(case.parameters)
            for rows_of_side, place in zip(kept, (-z, z), strict=False):
                put_aside(rows_of_side, place)
            found.append(Computed(case.parameters, tuple(row[i] for row in rows), kept, "", 0.0))
    return found


def _at_once(answers: int, how: _How) -> int:
    """Cases with so many answers each that a thread computes at once."""
    count = max(1, TOGETHER // answers)
    if not how.compiled:
        return count
    from knee_contact_ros.compiled.transposed import LANES  # half a second to import

    return count - count % LANES if count >= LANES else max(count, min(LANES, LARGEST // answers))


def _answers(recording: Recording, sides: list[Side], answers: Rows, how: _How) -> Rows:
    """The answers of k compartments of one kind, shape (k, n), in memory for them: zeros, or answers of others."""
    loads = np.stack([side.loads for side in sides])
    for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
        ours, whole = slice(begin, end), end - begin == len(recording.steps)
        part = answers if whole else np.zeros((len(sides), end - begin), ROW)
        columns = recording.steps[ours], recording.angles[ours], np.ascontiguousarray(loads[:, ours])
        _run(sides, (*columns, recording.heights[ours]), part, how)
        if not whole:
            answers[:, ours] = part
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    return answers


def _run(sides: list[Side], columns: tuple[Floats, ...], answers: Rows, how: _How) -> None:
    """Fill the answers of k compartments from rest, shape (k, n)."""
    scenes, (steps, angles, loads, heights) = [side.scene for side in sides], columns
    if how.compiled and compiler_works():
        from knee_contact_ros.compiled.batch import run_batch  # half a second to import

        run_batch(
            scenes, steps, angles, loads, heights, answers, threads=how.threads, told=telling_of(scenes[0])
        )  # fmt: skip
        return
    for scene, load, own in zip(scenes, loads, answers, strict=True):
        ticks.run(scene, np.zeros(1, ticks.MEMORY), steps, angles, load, heights, own)
