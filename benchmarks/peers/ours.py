"""This package's solvers in the form in which every solver is measured."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.measure import Outcome, Setting, Solver, half_decades, stopwatch
from benchmarks.peers.problems import EXPONENT, Problem
from knee_contact_ros import load_model
from knee_contact_ros.model.knee import KneeModel

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
        Solver(
            solver_name(level),
            NAME,
            LAW,
            settings,
            *(partial(run, level) for run in (whole, stream, loop)),
        )
        for level in LEVELS
    ]


def solver_name(level: str) -> str:
    """Name of a level in the tables."""
    return f"{NAME} {level}"


def whole(level: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with `KneeModel.run`."""
    model = model_of(problem, level, setting)
    angle = np.zeros_like(problem.time)
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
    evaluations = model.stream().advance_all(
        stamps, np.zeros_like(problem.time), problem.load, None
    )["evaluations"]
    return Outcome(np.array(depths), watch.seconds, float(evaluations.sum()))


def loop(level: str, problem: Problem, setting: Setting) -> Outcome:
    """Solve the problem with `Stream.advance_all`, which gives the records that `Stream.advance` gives."""
    model = model_of(problem, level, setting)
    stamps = stamps_of(problem)
    angle = np.zeros_like(problem.time)
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
    return load_model(
        {"femur": {"mass": problem.mass}, "contact": law, "fidelity": fidelity}, compiled=True
    )
