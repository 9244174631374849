"""This project's own run of a cohort, by the compiled model as in `sweep`: all answers with their error estimates."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from knee_contact_ros.lab.sweep import Files, Knees, Recording
from knee_contact_ros.model.types import ROW
from knee_contact_ros.parameters.files import load_parameters
from studies.cohorts.method import TOLERANCE, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "knee-contact"
TOLERANCES = tuple(10.0 ** (-quarters / 4.0) for quarters in range(24, 41))
"""[m]"""
PROMISED = 1e-8
"""Tolerance [m] of a user who knows no reference"""


def methods() -> list[Method]:
    """List the level with the loosest tolerance that holds, and one with the tolerance that promises the limit."""
    searched = Method(TOOL, "dynamic", TOLERANCE, prepared, TOLERANCES, threads=True)
    return [searched, Method(f"{TOOL}, as promised", "dynamic", TOLERANCE, prepared, (PROMISED,), threads=True)]


def prepared(knees: Cohort, tolerance: float, threads: int) -> Run:
    """Build a model for every knee, and prepare a run that solves them one by one."""
    parameters = load_parameters(["healthy", {"fidelity.level": "dynamic", "fidelity.tolerance": tolerance}])
    stamps = np.rint(knees.time * 1e9).astype(np.int64)
    steps, none = np.diff(stamps, prepend=stamps[:1]) * 1e-9, np.full(knees.ticks, np.nan)
    recording = Recording(stamps, steps, knees.angle, knees.load, np.zeros(knees.ticks), none)
    maker = Knees(recording, parameters, Files())
    models = []
    for i in range(knees.cases):
        values = {"contact.stiffness": float(knees.stiffness[i]), "contact.damping": float(knees.damping[i]),
                  "femur.mass": float(knees.mass[i])}  # fmt: skip
        (side,) = maker.sides(maker.varied(values), compiled=True)
        models.append(side.model)
    depths = np.empty((knees.cases, knees.ticks))
    samples = np.column_stack([steps, knees.angle, knees.load, none])

    def some(first: int) -> None:
        answers = np.zeros(knees.ticks, ROW)
        for i in range(first, knees.cases, max(threads, 1)):
            models[i].compute(samples, answers)
            np.subtract(answers["penetration_depth"], answers["gap"], out=depths[i])

    def run() -> Floats:
        with ThreadPoolExecutor(max(threads, 1)) as pool:
            list(pool.map(some, range(max(threads, 1))))
        return depths

    return run
