"""The geometries, each in both forms: the model's parameter files and the reference's surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from benchmarks import reference as femora
from studies.choosing.surfaces import OnPlane, OnPlateau, femur_through, plateau_through, read_points

CONFIG = Path(__file__).parents[2] / "config"
BASE = CONFIG / "healthy.yaml"
"""Parameter file with the law, the constants and the mass of all geometries"""
CIRCLE, MRI_FEMUR, MRI_KNEE = "circle", "MRI femur", "MRI knee"
ContactX = Callable[[float, float], float]
"""From flexion angle [rad] and the reference's depth or height [m] to x of the contact point on the tibia [m]"""


class Geometry(NamedTuple):
    """A femur and a tibia that touch."""

    name: str
    about: str
    files: Sequence[Path]
    """Parameter files"""
    femur: femora.Femur
    """Femur of the reference"""
    contact_x: ContactX
    relative_tolerance: float
    """Relative tolerance of the reference: a spline's curvature has a kink at every point, which costs steps"""


def geometries() -> list[Geometry]:
    """List the geometries, the most detailed last."""
    femur = femur_through(read_points(CONFIG / "femur_medial.csv"))
    on_plane, on_plateau = OnPlane(femur), OnPlateau(femur, plateau_through(read_points(CONFIG / "tibia_medial.csv")))
    return [
        Geometry(CIRCLE, "of 34 mm on a plane", (BASE,), femora.ByDepth(femora.circle), under_the_centre, 1e-12),
        Geometry(MRI_FEMUR, "a measured condyle on a plane (`mri_femur.yaml`)", (BASE, CONFIG / "mri_femur.yaml"),
                 femora.ByHeight(on_plane), on_plane.contact_x, 1e-10),
        Geometry(MRI_KNEE, "a measured condyle on a measured plateau (`mri_knee.yaml`)",
                 (BASE, CONFIG / "mri_knee.yaml"), femora.ByHeight(on_plateau), on_plateau.contact_x, 1e-10),
    ]  # fmt: skip


def under_the_centre(_angle: float, _depth: float) -> float:
    """Contact point of a circle about a fixed axis: below the axis, x = 0 [m]."""
    return 0.0
