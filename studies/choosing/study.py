"""The whole study: references, errors, costs, and effects of the inputs."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.peers.measure import Times, pin
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import Status
from studies.choosing.costs import costs
from studies.choosing.errors import COARSER, Answer, Apart, answer_of, apart, exact, model_of, run
from studies.choosing.geometries import MRI_KNEE, Geometry, geometries
from studies.choosing.inputs import Effect, effects
from studies.choosing.scenes import Scene, scenes

LEVELS = ("quasi_static", "dynamic")
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-8)
Say = Callable[[str], None]
Key = tuple[str, str, float, str]
"""Geometry, level, tolerance and scene"""


class Row(NamedTuple):
    """Error and cost of one geometry at one level and tolerance on one scene."""

    geometry: str
    level: str
    tolerance: float
    """Tolerance [m]"""
    scene: str
    error: Apart
    """Error against the same geometry solved exactly"""
    flagged: float
    """Share of the ticks flagged NOT_CONVERGED"""
    wrong: int
    """Number of unflagged ticks whose depth is off by more than the tolerance"""
    ticks: int
    microseconds: float = math.nan
    """Time per tick: the median of all turns"""
    spread_percent: float = math.nan
    """Time between the fastest and the slowest turn, as a part of the median"""


class Left(NamedTuple):
    """Error of a simpler geometry on a scene, and how well that is known."""

    geometry: str
    scene: str
    error: Apart
    """Difference of the exact solution from that of the measured knee"""
    own: Apart
    """Upper bound of the reference's own error"""


class Study(NamedTuple):
    """All that the page shows."""

    scenes: list[Scene]
    geometries: list[Geometry]
    rows: list[Row]
    left: list[Left]
    effects: list[Effect]
    turns: int


def measure(turns: int, say: Say) -> Study:
    """Measure all parts of the study; `say` prints the progress."""
    pin()
    all_scenes, all_geometries = scenes(), geometries()
    answers: dict[tuple[str, str], Answer] = {}
    own: dict[tuple[str, str], Apart] = {}
    for geometry in all_geometries:
        for scene in all_scenes:
            key = geometry.name, scene.name
            answers[key] = exact(geometry, scene)
            own[key] = apart(answers[key], exact(geometry, scene, COARSER))
            say(f"reference, {geometry.name}, {scene.name}: good to {own[key].depth:.0e} m")
    rows = level_rows(all_scenes, all_geometries, answers, turns, say)
    left = [Left(geometry, scene, apart(answer, answers[MRI_KNEE, scene]), own[geometry, scene])
            for (geometry, scene), answer in answers.items()]  # fmt: skip
    found = []
    for scene in all_scenes:
        found += effects(scene)
        say(f"inputs, {scene.name}")
    return Study(all_scenes, all_geometries, rows, left, found, turns)


def level_rows(
    all_scenes: list[Scene],
    all_geometries: list[Geometry],
    answers: dict[tuple[str, str], Answer],
    turns: int,
    say: Say,
) -> list[Row]:
    """Measure errors and costs of every geometry, level, tolerance and scene."""
    runs: dict[Key, Callable[[], object]] = {}
    rows = []
    for geometry in all_geometries:
        for level in LEVELS:
            for tolerance in TOLERANCES:
                model = model_of(geometry, level, tolerance)
                for scene in all_scenes:
                    row = error_row(geometry, level, tolerance, scene, model, answers[geometry.name, scene.name])
                    runs[key_of(row)] = partial(run, model, scene)
                    rows.append(row)
            say(f"errors, {geometry.name}, {level}")
    times = costs(runs, turns, lambda turn: say(f"costs, turn {turn} of {turns}"))
    return [with_cost(row, times[key_of(row)]) for row in rows]


def error_row(geometry: Geometry, level: str, tolerance: float, scene: Scene, model: KneeModel, right: Answer) -> Row:
    """Row with the errors of a model on a scene; its cost is not known yet."""
    series = run(model, scene)
    found, said = answer_of(series), series.status & Status.NOT_CONVERGED != 0
    wrong = ~said & (np.abs(found.depth - right.depth) > tolerance)
    return Row(geometry.name, level, tolerance, scene.name, apart(found, right), float(said.mean()),
               int(wrong.sum()), len(wrong))  # fmt: skip


def key_of(row: Row) -> Key:
    """Key of a row in the costs."""
    return row.geometry, row.level, row.tolerance, row.scene


def with_cost(row: Row, times: Times) -> Row:
    """Copy of a row with its cost."""
    return row._replace(microseconds=1e6 * times.median / row.ticks, spread_percent=times.spread_percent)
