"""Time per tick of all combinations, measured in turns, in one process on one processor."""

from __future__ import annotations

import gc
import random
from collections.abc import Callable, Hashable, Mapping
from typing import TypeVar

from benchmarks.peers.measure import Times, runs_for, stopwatch, summed_up

Key = TypeVar("Key", bound=Hashable)
SEED = 16
"""Seed of the order within the turns"""


def costs(
    runs: Mapping[Key, Callable[[], object]], turns: int, advance: Callable[[int], None] = lambda _turn: None
) -> dict[Key, Times]:
    """Processor time [s] of every run: in a turn, all runs in random order, of each the fastest of a few.

    `advance` is told the number of every turn that is over.
    """
    for run in runs.values():
        run()  # compiles
    found: dict[Key, list[float]] = {key: [] for key in runs}
    keys, order = list(runs), random.Random(SEED)  # noqa: S311 - no secret
    for turn in range(turns):
        order.shuffle(keys)
        for key in keys:
            found[key].append(fastest(runs[key]))
        advance(turn + 1)
    return {key: summed_up(times) for key, times in found.items()}


def fastest(run: Callable[[], object]) -> float:
    """Time [s] of the fastest of some runs, one after another."""
    gc.collect()
    gc.disable()
    try:
        seconds = timed(run)
        for _ in range(runs_for(seconds) - 1):
            seconds = min(seconds, timed(run))
    finally:
        gc.enable()
    return seconds


def timed(run: Callable[[], object]) -> float:
    """Time [s] of one run."""
    with stopwatch() as watch:
        run()
    return watch.seconds
