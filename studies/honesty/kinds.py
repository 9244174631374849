"""The studies: each is a function that yields the rows of one number, by which its runs can be repeated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from studies.honesty import budgets, changes, cut, long_runs, measured
from studies.honesty.judging import judge
from studies.honesty.ours import model
from studies.honesty.scenes import draw
from studies.honesty.study import Row, row
from studies.honesty.truth import reference

LEVELS = ("quasi_static", "dynamic")
"""Levels that are judged; `auto` is `dynamic`"""
SETTINGS = ((1e-4, 0.0), (1e-5, 0.0), (1e-6, 0.0), (1e-8, 0.0), (1e-4, 1.0), (1e-6, 0.1))
"""Tolerances of depth [m] and of force [N]; 0: none"""
TIGHT = ((1e-8, 0.0), (1e-9, 0.0), (1e-10, 0.0))


def scenes(seed: int, settings: tuple[tuple[float, float], ...] = SETTINGS) -> Iterator[Row]:
    """Answer and judge a random scene at both levels and at all tolerances."""
    scene = draw(seed)
    truth = reference(scene)
    for level in LEVELS:
        for tolerance, force in settings:
            series = model(scene, level, tolerance, force_tolerance=force)
            asked = f"{tolerance:g} m" + (f", {force:g} N" if force else "")
            groups = (f"{scene.family}, {level}, {asked}", f"{scene.law}, {level}")
            yield row(groups, f"{level}, {asked}", series, judge(series, truth, tolerance, force))


STUDIES: dict[str, tuple[Callable[[int], Iterator[Row]], int]] = {
    "scenes": (scenes, 2000),
    "tight": (partial(scenes, settings=TIGHT), 2000),
    "changes": (changes.rows, 2000),
    "measured": (measured.rows, 250),
    "cut": (cut.rows, 100_000),
    "budgets": (budgets.rows, budgets.COUNT),
    "long_runs": (long_runs.rows, long_runs.COUNT),
}
"""The studies, and how many numbers each of them has"""


def found(study: str, part: float, seed: int) -> tuple[int, list[Row]]:
    """Return a number and its rows; `part` is that of the duration of long runs."""
    return seed, list(
        long_runs.rows(seed, part) if study == "long_runs" else STUDIES[study][0](seed)
    )
