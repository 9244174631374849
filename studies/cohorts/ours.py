"""This project's own run of a cohort. `prepared` is the one place that knows how: a batch kernel goes there."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from knee_contact_ros.parameters.build import load_model, retuned
from knee_contact_ros.parameters.reading import load_parameters
from studies.cohorts.method import TOLERANCE, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "knee-contact"
TOLERANCES = tuple(10.0 ** (-quarters / 4.0) for quarters in range(24, 41))
"""[m]"""
PROMISED = 1e-8
"""[m]: what a user asks for who knows no reference"""


def methods() -> list[Method]:
    """Both levels with the loosest tolerance that holds, and with the one that promises it."""
    asked = [
        Method(TOOL, f"one run per knee, {level}", TOLERANCE, partial(prepared, level=level), TOLERANCES)
        for level in ("auto", "dynamic")
    ]
    promised = Method(
        f"{TOOL}, as promised", "one run per knee, auto", TOLERANCE, partial(prepared, level="auto"), (PROMISED,)
    )
    return [*asked, promised]


def prepared(knees: Cohort, tolerance: float, _threads: int, *, level: str) -> Run:
    """Build a model for every knee; the run is one call of `run` for each."""
    base: list[str | Mapping[str, Any]] = ["healthy", {"fidelity.level": level, "fidelity.tolerance": tolerance}]
    model, parameters = load_model(base, compiled=True), load_parameters(base)
    models = []
    for i in range(knees.cases):
        contact = {"stiffness": float(knees.stiffness[i]), "damping": float(knees.damping[i])}
        its = parameters.model_copy(update={
            "contact": parameters.contact.model_copy(update=contact),
            "femur": parameters.femur.model_copy(update={"mass": float(knees.mass[i])}),
        })  # fmt: skip
        models.append(retuned(model, its))
    depths = np.empty((knees.cases, knees.ticks))

    def run() -> Floats:
        for depth, one in zip(depths, models, strict=True):
            answers = one.run(knees.time, knees.angle, knees.load)
            np.subtract(answers.penetration_depth, answers.gap, out=depth)
        return depths

    return run
