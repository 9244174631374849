"""This package in the form in which the study takes every solver."""

from __future__ import annotations

from typing import Any

import numpy as np

from knee_contact_ros.build import load_model
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.trade.problems import EXPONENT, Problem
from knee_contact_ros.trade.solver import Outcome, Run, Setting, Solver, stopwatch, tolerances

NAME = "knee-contact"
LEVELS = ("dynamic",)
"""Values of `fidelity.level` to measure"""
LAW = "exact; `KneeModel.run`, or `Stream.tick_ns` for every sample"


def solvers() -> list[Solver]:
    """One per level."""
    settings = tolerances(*range(4, 13))
    return [Solver(solver_name(level), NAME, LAW, settings, whole(level), stream(level)) for level in LEVELS]


def solver_name(level: str) -> str:
    """As it appears in the tables."""
    return f"{NAME} {level}"


def whole(level: str) -> Run:
    """`KneeModel.run`."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        model, angle = model_of(problem, level, setting), np.zeros_like(problem.time)
        with stopwatch() as watch:
            series = model.run(problem.time, angle, problem.load)
        depth = np.asarray(series.penetration_depth - series.gap)
        return Outcome(depth, watch.seconds, float(series.evaluations.sum()))

    return run


def stream(level: str) -> Run:
    """`Stream.tick_ns`."""

    def run(problem: Problem, setting: Setting) -> Outcome:
        ticks = model_of(problem, level, setting).stream()
        samples = list(zip(np.round(problem.time * 1e9).astype(np.int64).tolist(), problem.load.tolist(), strict=True))
        with stopwatch() as watch:
            contacts = [ticks.tick_ns(stamp, 0.0, load) for stamp, load in samples]
        depths = np.array([contact.penetration_depth - contact.gap for contact in contacts])
        return Outcome(depths, watch.seconds, sum(contact.evaluations for contact in contacts))

    return run


def model_of(problem: Problem, level: str, setting: Setting) -> KneeModel:
    """The problem as a parameter file would describe it."""
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
    return load_model({"femur": {"mass": problem.mass}, "contact": law, "fidelity": fidelity})
