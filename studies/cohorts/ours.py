"""This project's own run of a cohort: the batch kernel of `sweep`, which gives all answers with their error bounds."""

from __future__ import annotations

from functools import partial

import numpy as np

from knee_contact_ros.cohort.knees import Files, Knees, Recording
from knee_contact_ros.compiled.batch import run_batch
from knee_contact_ros.core.types import ROW
from knee_contact_ros.parameters.reading import load_parameters
from studies.cohorts.method import TOLERANCE, Method, Run
from studies.cohorts.problem import Cohort, Floats

TOOL = "knee-contact"
TOLERANCES = tuple(10.0 ** (-quarters / 4.0) for quarters in range(24, 41))
"""[m]"""
PROMISED = 1e-8
"""Tolerance [m] of a user who knows no reference"""
TOGETHER = 40
"""Knees whose answers are held at once, as `cohort/computing.py` does with this many ticks"""


def methods() -> list[Method]:
    """List both levels with the loosest tolerance that holds, and one with the tolerance that promises the limit."""
    searched = [
        Method(TOOL, f"batch, {level}", TOLERANCE, partial(prepared, level=level), TOLERANCES, threads=True)
        for level in ("auto", "dynamic")
    ]
    promised = Method(
        f"{TOOL}, as promised", "batch, auto", TOLERANCE, partial(prepared, level="auto"), (PROMISED,), threads=True
    )
    return [*searched, promised]


def prepared(knees: Cohort, tolerance: float, threads: int, *, level: str) -> Run:
    """Build a scene for every knee, and prepare a run that solves them in blocks."""
    parameters = load_parameters(["healthy", {"fidelity.level": level, "fidelity.tolerance": tolerance}])
    stamps = np.rint(knees.time * 1e9).astype(np.int64)
    steps, none = np.diff(stamps, prepend=stamps[:1]) * 1e-9, np.full(knees.ticks, np.nan)
    recording = Recording(stamps, steps, knees.angle, knees.load, np.zeros(knees.ticks), none)
    maker = Knees(recording, parameters, Files())
    scenes = []
    for i in range(knees.cases):
        values = {"contact.stiffness": float(knees.stiffness[i]), "contact.damping": float(knees.damping[i]),
                  "femur.mass": float(knees.mass[i])}  # fmt: skip
        (side,) = maker.sides(maker.varied(values), tried=False)
        scenes.append(side.scene)
    depths, size = np.empty((knees.cases, knees.ticks)), TOGETHER * max(threads, 1)
    loads, answers = np.tile(knees.load, (size, 1)), np.zeros((size, knees.ticks), ROW)

    def run() -> Floats:
        for begin in range(0, knees.cases, size):
            own = scenes[begin : begin + size]
            rows = answers[: len(own)]
            run_batch(own, steps, knees.angle, loads[: len(own)], none, rows, threads=threads)
            np.subtract(rows["penetration_depth"], rows["gap"], out=depths[begin : begin + size])
        return depths

    return run
