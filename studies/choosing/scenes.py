"""What the study asks: loads and angles, and the geometries in both forms, the model's and the reference's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import reference
from benchmarks.gait import gait
from benchmarks.peers.problems import bump, thrown
from knee_contact_ros.parameters.files import load_parameters
from studies.accuracy import lift_off
from studies.choosing.surfaces import (
    OnPlane,
    OnPlateau,
    femur_through,
    plateau_through,
    read_points,
)

Floats = NDArray[np.float64]
SEED = 16
"""Seed of the running strides"""
STRIDE, STRIDES = 0.7, 2
"""Duration of a running stride [s], and number of strides"""
CONFIG = Path(__file__).parents[2] / "config"
BASE = CONFIG / "healthy.yaml"
"""Parameter file with the law, the constants and the mass of all geometries"""
CIRCLE, MRI_FEMUR, MRI_KNEE = "circle", "MRI femur", "MRI knee"
COARSER = 100.0
"""Ratio of the tolerance of a second reference solution, which shows the error of the first"""


class Scene(NamedTuple):
    """Time [s], flexion angle [rad] and load [N], shape (n,) each."""

    name: str
    about: str
    time: Floats
    angle: Floats
    load: Floats


def scenes() -> list[Scene]:
    """List the scenes, all of the knee of config/healthy.yaml."""
    fall = np.arange(401, dtype=np.float64) * 1e-3
    return [
        Scene(
            "gait",
            "the bag `gait2354_right`: recorded, 1.93 s at 200 Hz, flexion −1° to 70°, load 0.11 to 1.61 kN",
            *gait("right"),
        ),
        Scene(
            "running-like",
            f"{STRIDES} strides of {STRIDE:g} s at 1 kHz (random, seed {SEED}): an impact peak of "
            "1.6 kN and an active one of 3.3 kN, ± 10 % from stride to stride; 60 N and 95° of flexion in swing",
            *running(np.arange(int(1000 * STRIDE * STRIDES) + 1, dtype=np.float64) * 1e-3),
        ),
        Scene(
            "lift-off and landing",
            "0.5 s at 1 kHz, load 300 + 350 cos(8πt) N: let go of twice for some "
            "50 ms; flexion 0.4 + 0.4 sin 9t rad",
            *lift_off(),
        ),
        Scene(
            "impact",
            "0.4 s at 1 kHz: 300 N, 20 ms of pull with as much from 60 ms on, then pressed with 900 N; "
            "flexion 0.2 + t rad",
            fall,
            0.2 + fall,
            thrown(fall),
        ),
    ]


def running(time: Floats) -> tuple[Floats, Floats, Floats]:
    """Running strides with an impact peak, an active peak and a deep swing, each slightly different from the others."""
    random = np.random.default_rng(SEED)
    angle, load = np.full_like(time, 0.2), np.full_like(time, 60.0)
    for stride in range(STRIDES):
        phase = time - stride * STRIDE - 0.06
        impact, active, stance, swing = 1.0 + 0.1 * random.uniform(-1.0, 1.0, 4)
        load += impact * 1540.0 * bump(phase, 0.025, 0.012) + active * 3240.0 * bump(
            phase, 0.11, 0.05
        )
        angle += stance * math.radians(30.0) * bump(phase, 0.10, 0.07)
        angle += swing * math.radians(84.0) * bump(phase, 0.42, 0.11)
    return time, angle, load


class Geometry(NamedTuple):
    """A femur and a tibia that touch."""

    name: str
    files: Sequence[Path]
    """Parameter files"""
    femur: reference.Femur
    """Femur of the reference"""
    contact_x: Callable[[float, float], float]
    """From flexion angle [rad] and the reference's depth or height [m] to x of the contact point on the tibia [m]"""
    relative_tolerance: float
    """Relative tolerance of the reference: a spline's curvature has a kink at every point, which costs steps"""


def geometries() -> list[Geometry]:
    """List the geometries, the most detailed last."""
    femur = femur_through(read_points(CONFIG / "femur_medial.csv"))
    on_plane, on_plateau = (
        OnPlane(femur),
        OnPlateau(femur, plateau_through(read_points(CONFIG / "tibia_medial.csv"))),
    )
    by_height = reference.ByHeight
    return [
        Geometry(
            CIRCLE, (BASE,), reference.ByDepth(reference.circle), lambda _angle, _depth: 0.0, 1e-12
        ),
        Geometry(
            MRI_FEMUR,
            (BASE, CONFIG / "mri_femur.yaml"),
            by_height(on_plane),
            on_plane.contact_x,
            1e-10,
        ),
        Geometry(
            MRI_KNEE,
            (BASE, CONFIG / "mri_knee.yaml"),
            by_height(on_plateau),
            on_plateau.contact_x,
            1e-10,
        ),
    ]


class Answer(NamedTuple):
    """Outputs that a user reads at every tick, shape (n,) each."""

    depth: Floats
    """Signed depth [m]: penetration > 0, gap < 0"""
    force: Floats
    """Contact force [N]"""
    x: Floats
    """Position of the contact point along the plateau [m]"""


class Apart(NamedTuple):
    """Differences of two answers at the worst tick: of depth [m], force [N] and contact point [m]."""

    depth: float
    force: float
    x: float


def apart(one: Answer, other: Answer) -> Apart:
    """The largest differences of any tick."""
    return Apart(*(float(np.abs(a - b).max()) for a, b in zip(one, other, strict=True)))


def exact(geometry: Geometry, scene: Scene, coarser: float = 1.0) -> Answer:
    """Solve a scene with a geometry by the reference: Eq. 13 of the paper, by code that is not the model's."""
    parameters = load_parameters(BASE)
    contact = parameters.contact
    layers = reference.kelvin_voigt(contact.stiffness, contact.exponent, contact.damping)
    asked = reference.Scene(
        scene.time,
        scene.angle,
        scene.load,
        layers,
        parameters.femur.mass,
        geometry.femur,
        relative_tolerance=coarser * geometry.relative_tolerance,
    )
    found = reference.answers(asked)
    places = [
        geometry.contact_x(*each)
        for each in zip(scene.angle.tolist(), found.state.tolist(), strict=True)
    ]
    return Answer(found.depth, found.force, np.array(places))


def answer_of(series: np.recarray[Any, Any]) -> Answer:
    """Outputs that a user reads of the model's records."""
    return Answer(
        series.penetration_depth - series.gap, series.contact_force, series.contact_point["x"]
    )
