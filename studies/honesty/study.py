"""Many scenes at all levels, in worker processes."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.model import compiler
from studies.honesty.judging import Judged, Verdict, judge
from studies.honesty.ours import model
from studies.honesty.scenes import Scene, draw
from studies.honesty.tally import Tally
from studies.honesty.truth import reference

SETTINGS = ((1e-4, 0.0), (1e-5, 0.0), (1e-6, 0.0), (1e-8, 0.0), (1e-4, 1.0), (1e-6, 0.1))
"""Tolerances of depth [m] and of force [N]; 0: none"""
LEVELS = ("quasi_static", "dynamic")
"""Levels that are judged; `auto` is `dynamic`"""
WORST = 15
"""Number of worst ticks that are kept"""
WORKERS = 2
CHUNK = 5
"""Number of scenes that a worker takes at a time"""


class Key(NamedTuple):
    """Key by which runs are counted."""

    family: str
    loads: str
    law: str
    level: str
    tolerance: float
    force_tolerance: float


class BadTick(NamedTuple):
    """A tick to look at, with all that is needed to compute it again."""

    severity: float
    """Ratio of error to tolerance, or to estimate"""
    quantity: str
    seed: int
    tick: int
    key: Key
    fidelity: int
    error: float
    estimate: float
    said_right: bool


class Outcome(NamedTuple):
    """Results of a study."""

    tallies: dict[Key, Tally]
    wrong: list[BadTick]
    """Ticks said right and wrong, the worst first"""
    uncovered: list[BadTick]
    """Ticks whose error is beyond the estimate, the worst first"""


def study(
    seeds: Iterable[int],
    levels: Sequence[str] = LEVELS,
    settings: Sequence[tuple[float, float]] = SETTINGS,
    told: Callable[[int], None] = lambda _: None,
) -> Outcome:
    """Judge all levels on the scenes of all seeds; `told` hears how many scenes are done."""
    outcome, wanted, done = Outcome({}, [], []), list(seeds), 0
    chunks = [wanted[i : i + CHUNK] for i in range(0, len(wanted), CHUNK)]
    compiler.compiled_run()  # once, so that the workers do not both compile it
    with ProcessPoolExecutor(WORKERS, multiprocessing.get_context("spawn")) as workers:
        count = len(chunks)
        for chunk, part in zip(
            chunks, workers.map(_judge_all, chunks, [levels] * count, [settings] * count), strict=True
        ):
            merge(outcome, part)
            done += len(chunk)
            told(done)
    return outcome


def merge(outcome: Outcome, part: Outcome) -> None:
    """Add what other scenes gave."""
    for key, tally in part.tallies.items():
        outcome.tallies.setdefault(key, Tally()).add(tally)
    for mine, theirs in ((outcome.wrong, part.wrong), (outcome.uncovered, part.uncovered)):
        mine[:] = worst_of([*mine, *theirs])


def worst_of(bad: list[BadTick]) -> list[BadTick]:
    """The worst, one of each scene, level and quantity."""
    kept: dict[tuple[int, str, str], BadTick] = {}
    for one in sorted(bad, reverse=True):
        kept.setdefault((one.seed, one.key.level, one.quantity), one)
    return list(kept.values())[:WORST]


def runs(
    scene: Scene, levels: Sequence[str], settings: Sequence[tuple[float, float]]
) -> dict[Key, tuple[np.recarray[Any, Any], Judged]]:
    """All answers to a scene, and what they are worth."""
    truth, found = reference(scene), {}
    for level in levels:
        for tolerance, force_tolerance in settings:
            series = model(scene, level, tolerance, force_tolerance=force_tolerance)
            key = Key(scene.family, scene.loads, scene.law, level, tolerance, force_tolerance)
            found[key] = series, judge(series, truth, tolerance, force_tolerance)
    return found


def _judge_all(seeds: list[int], levels: Sequence[str], settings: Sequence[tuple[float, float]]) -> Outcome:
    outcome = Outcome({}, [], [])
    for seed in seeds:
        scene = draw(seed)
        merge(outcome, _judge_scene(scene, levels, settings))
    return outcome


def _judge_scene(scene: Scene, levels: Sequence[str], settings: Sequence[tuple[float, float]]) -> Outcome:
    outcome = Outcome({}, [], [])
    found = {key: judged for key, (_, judged) in runs(scene, levels, settings).items()}
    for key, judged in found.items():
        tally = outcome.tallies.setdefault(key, Tally())
        tally.count(judged)
        for name, verdict, tolerance in (
            ("depth", judged.depth, key.tolerance),
            ("force", judged.force, key.force_tolerance),
        ):
            if verdict is not None:
                outcome.wrong.extend(_worst(scene, key, judged, name, verdict, verdict.wrong, tolerance))
                missed = verdict.known & ~verdict.covered
                outcome.uncovered.extend(_worst(scene, key, judged, name, verdict, missed, None))
    for kept in (outcome.wrong, outcome.uncovered):
        kept[:] = worst_of(kept)
    return outcome


def _worst(
    scene: Scene, key: Key, judged: Judged, name: str, verdict: Verdict, bad: Any, tolerance: float | None
) -> list[BadTick]:
    """The worst of a run's bad ticks, as one."""
    if not bad.any():
        return []
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = verdict.estimate if tolerance is None else tolerance
        severity = np.where(bad, np.nan_to_num(verdict.error / allowed, nan=np.inf), -1.0)
    tick = int(np.argmax(severity))
    return [
        BadTick(
            float(severity[tick]), name, scene.seed, tick, key, int(judged.fidelity[tick]), float(verdict.error[tick]),
            float(verdict.estimate[tick]), bool(judged.said_right[tick]),
        )
    ]  # fmt: skip
