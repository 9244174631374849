"""The gait runs that the report compares, each computed once, through the public interface only."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros import load_model
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from studies import gait as bags
from studies.gait import BODY_WEIGHT

CONFIG = Path(__file__).parents[2] / "config"
HEALTHY, ARTHRITIC, MRI = "healthy.yaml", "osteoarthritis.yaml", "mri_femur.yaml"
SPHERE_AND_CURVE = {"sphere": (HEALTHY,), "fitted curve": (HEALTHY, MRI)}
TOLERANCE = 1e-9
"""Tolerance of the depth [m]: the numbers are the model's, not the solver's"""
FINE = 1e-3
"""Step [s] of the runs that must show ringing; the input between two samples is linear either way."""
MM, PERCENT = 1e3, 1e2
N_MM = 1e-3**1.5
"""Factor from N/m^1.5 to N/mm^1.5"""

Changes = tuple[tuple[str, Any], ...]
"""Dotted names of parameters with their values."""
Series = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Time [s], flexion angle [rad] and load [N], shape (n,) each"""
DISPLACEMENT: Changes = (("drive", "displacement"),)
BOTH_LAYERS_DAMPED: Changes = (("contact.damp_first_layer", True),)
CURVED_TIBIAE: dict[str, Changes] = {
    "circle, 95 mm": (("tibia.geometry", "circle"),),
    "MRI": (("tibia.geometry", "profile"), ("tibia.profile", "tibia_medial.csv")),
}
MECHANISMS: dict[str, Changes] = {
    "hinge": (("translation.mechanism", "hinge"),),
    "parallel mechanism": (("translation.mechanism", "parallel_mechanism"),),
    "measured table": (("translation.mechanism", "table"), ("translation.table", "translation_medial.csv")),
}


@cache
def gait(side: str, step: float | None = None) -> Series:
    """Series of a bundled bag, with another step [s] if `step` is given."""
    time, angle, load = bags.gait(side)
    if step is None:
        return time, angle, load
    fine = np.linspace(time[0], time[-1], 1 + round((time[-1] - time[0]) / step))
    return fine, np.interp(fine, time, angle), np.interp(fine, time, load)


@cache
def parameters(*files: str) -> Parameters:
    """Load parameter files, of which later ones overrule earlier ones."""
    return load_parameters([CONFIG / file for file in files])


@cache
def model(*files: str, changes: Changes = ()) -> KneeModel:
    """Model of some parameter files with changes; compiled if it is the sphere on the plane, which most are."""
    asked = load_parameters({**parameters(*files).model_dump(), "fidelity.tolerance": TOLERANCE, **dict(changes)})
    curved = asked.femur.geometry != "circle" or asked.tibia.geometry != "plane"
    return load_model(asked, compiled=not curved and asked.translation.mechanism == "hinge")


@cache
def run(*files: str, side: str = "right", changes: Changes = (), step: float | None = None) -> np.recarray[Any, Any]:
    """Run a model over a bag with the load prescribed."""
    return model(*files, changes=changes).run(*gait(side, step))


@cache
def led_run(lost: float) -> np.recarray[Any, Any]:
    """The arthritic knee at the femoral heights of the healthy one, raised by a loss [m] of cartilage; fitted curve."""
    heights = run(HEALTHY, MRI).femoral_height + lost
    return model(ARTHRITIC, MRI, changes=DISPLACEMENT).run(*gait("right"), heights)


def static_depth(load: float, *files: str, changes: Changes = ()) -> float:
    """Depth at rest [m] under a load [N]: the first tick of a run is the static solution."""
    return model(*files, changes=changes).stream().tick(0.0, 0.0, load).penetration_depth


def static_force(depth: float, *files: str) -> float:
    """Force at rest [N] at a depth [m]."""
    return model(*files).law.static_force(depth)


def body_weights(force: float) -> float:
    """Format a force [N] in the paper's body weights."""
    return force / BODY_WEIGHT
