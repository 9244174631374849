"""This package's solvers in the form in which every solver is measured, and how steady they stay in a long run."""

from __future__ import annotations

import gc
import tracemalloc
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.measure import Outcome, Setting, Solver, half_decades, stopwatch
from benchmarks.peers.problems import EXPONENT, Problem, find_problems
from knee_contact_ros.model.knee import KneeModel, Stream
from knee_contact_ros.parameters.build import load_model

NAME = "knee-contact"
LEVELS = ("dynamic", "quasi_static")
"""Values of `fidelity.level` to measure"""
LAW = (
    "exact; `KneeModel.run`, `Stream.advance` for every sample, or `Stream.advance_all` with samples that lie in "
    "memory; compiled"
)


def solvers() -> list[Solver]:
    """One solver per level."""
    settings = half_decades(4, 12)
    return [
        Solver(solver_name(level), NAME, LAW, settings, *(partial(run, level) for run in (whole, stream, loop)))
        for level in LEVELS
    ]


def solver_name(level: str) -> str:
    """Name of a level in the tables."""
    return f"{NAME} {level}"


def whole(level: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with `KneeModel.run`."""
    model, angle = model_of(problem, level, setting), np.zeros_like(problem.time)
    model.run(problem.time[:2], angle[:2], problem.load[:2])  # compiles
    with stopwatch() as watch:
        series = model.run(problem.time, angle, problem.load)
    depth = np.asarray(series.penetration_depth - series.gap)
    return Outcome(depth, watch.seconds, float(series.evaluations.sum()))


def stream(level: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with a call of `Stream.advance` for every sample."""
    model = model_of(problem, level, setting)
    ticks = model.stream()  # compiles
    stamps = stamps_of(problem)
    samples = list(zip(stamps.tolist(), problem.load.tolist(), strict=True))
    depths: list[float] = []
    depth, gap = (ticks.answer[name] for name in ("penetration_depth", "gap"))
    with stopwatch() as watch:
        for stamp, load in samples:
            ticks.advance(stamp, 0.0, load)
            depths.append(depth.item() - gap.item())
    evaluations = model.stream().advance_all(stamps, np.zeros_like(problem.time), problem.load, None)["evaluations"]
    return Outcome(np.array(depths), watch.seconds, float(evaluations.sum()))


def loop(level: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with `Stream.advance_all`, which gives the records that `Stream.advance` gives."""
    model, stamps, angle = model_of(problem, level, setting), stamps_of(problem), np.zeros_like(problem.time)
    model.stream().advance_all(stamps[:2], angle[:2], problem.load[:2], None)  # compiles
    ticks = model.stream()
    with stopwatch() as watch:
        answers = ticks.advance_all(stamps, angle, problem.load, None)
        depth = answers["penetration_depth"] - answers["gap"]
    return Outcome(depth, watch.seconds, float(answers["evaluations"].sum()))


def stamps_of(problem: Problem) -> NDArray[np.int64]:
    """Stamps of a problem in whole nanoseconds, as ROS has them, shape (n,)."""
    return np.round(problem.time * 1e9).astype(np.int64)


def model_of(problem: Problem, level: str, setting: Setting) -> KneeModel:
    """Build the model of a problem from the parameters that a file would hold."""
    law: dict[str, Any] = {"law": "kelvin_voigt"}
    if problem.layered:
        law = {
            "law": "two_layer_viscoelastic",
            "layer_depth": problem.layer_depth,
            "stiffness_2": problem.stiffness_2,
            "damp_first_layer": problem.damp_first_layer,
        }
    law |= {"stiffness": problem.stiffness, "exponent": EXPONENT, "damping": problem.damping}
    fidelity = {"level": level, "tolerance": setting.value}
    return load_model({"femur": {"mass": problem.mass}, "contact": law, "fidelity": fidelity}, compiled=True)


TICKS = (1000, 3000, 10000)
"""Moments of a run, as numbers of ticks at 1 kHz"""
SETTING = Setting("1e-8", 1e-8)
WALKS = 3
"""Number of runs of each level; the quickest counts"""
MILLISECOND = 1_000_000
"""[ns]"""
OWN = [tracemalloc.Filter(True, "*/knee_contact_ros/*"), tracemalloc.Filter(True, __file__)]
"""Files whose memory is a run's; other threads of a process allocate, too"""


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
            own = tracemalloc.take_snapshot().filter_traces(OWN)
            held.append(sum(trace.size for trace in own.traces) / 1024.0)
            begin = end
    finally:
        tracemalloc.stop()
    return held


def walk(stream: Stream, begin: int, end: int, loads: list[float]) -> None:
    """Advance a stream by the ticks from `begin` to `end`, with loads [N] over and over."""
    for i in range(begin, end):
        stream.tick_ns(i * MILLISECOND, 0.0, loads[i % len(loads)])
