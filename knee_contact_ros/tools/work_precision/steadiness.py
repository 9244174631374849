"""Time and memory of a long run, tick by tick: whether it stays as quick and as small as it began."""

from __future__ import annotations

import gc
import tracemalloc
from typing import NamedTuple

from knee_contact_ros.model.knee import Stream
from knee_contact_ros.tools.work_precision.ours import model_of
from knee_contact_ros.tools.work_precision.problems import find_problems
from knee_contact_ros.tools.work_precision.solver import Setting, stopwatch

TICKS = (1000, 3000, 10000)
"""Moments of a run, as numbers of ticks at 1 kHz"""
SETTING = Setting("1e-8", 1e-8)
WALKS = 3
"""Number of runs of each level; the quickest counts"""
MILLISECOND = 1_000_000
"""[ns]"""


class Moment(NamedTuple):
    """Time and memory of a run after a number of ticks."""

    level: str
    ticks: int
    microseconds_per_tick: float
    """Time per tick since the moment before"""
    kilobytes: float
    """Memory held by the run"""


def moments(level: str) -> list[Moment]:
    """Measure a level at every moment; the memory is that of a second run, because tracing takes time."""
    (problem,) = find_problems(("gait",))
    model, loads = model_of(problem, level, SETTING), problem.load[:-1].tolist()
    walks = [times(model.stream(), loads) for _ in range(WALKS)]
    quickest = [min(turns) for turns in zip(*walks, strict=True)]
    held = memory(model.stream(), loads)
    return [Moment(level, *each) for each in zip(TICKS, quickest, held, strict=True)]


def times(stream: Stream, loads: list[float]) -> list[float]:
    """Time per tick [µs] up to every moment."""
    microseconds, begin = [], 0
    for end in TICKS:
        with stopwatch() as watch:
            walk(stream, begin, end, loads)
        microseconds.append(1e6 * watch.seconds / (end - begin))
        begin = end
    return microseconds


def memory(stream: Stream, loads: list[float]) -> list[float]:
    """Memory that a run holds [kB] at every moment."""
    held, begin = [], 0
    tracemalloc.start()
    try:
        for end in TICKS:
            walk(stream, begin, end, loads)
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0] / 1024.0)
            begin = end
    finally:
        tracemalloc.stop()
    return held


def walk(stream: Stream, begin: int, end: int, loads: list[float]) -> None:
    """Advance a stream by the ticks from `begin` to `end`, with loads [N] over and over."""
    for i in range(begin, end):
        stream.tick_ns(i * MILLISECOND, 0.0, loads[i % len(loads)])
