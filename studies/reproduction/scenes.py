"""Runs of the bundled gait that the page compares, moments of the gait, and cells of the tables."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from benchmarks import gait as bags
from benchmarks.gait import BODY_WEIGHT, HEEL_STRIKE
from knee_contact_ros import load_model
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters

CONFIG = Path(__file__).parents[2] / "config"
HEALTHY, ARTHRITIC, MRI = "healthy.yaml", "osteoarthritis_as_printed.yaml", "mri_femur.yaml"
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
    "measured table": (
        ("translation.mechanism", "table"),
        ("translation.table", "translation_medial.csv"),
    ),
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
    """Compiled model of some parameter files with changes."""
    asked = load_parameters(
        [parameters(*files), {"fidelity.tolerance": TOLERANCE, **dict(changes)}]
    )
    return load_model(asked, compiled=True)


@cache
def run(
    *files: str, side: str = "right", changes: Changes = (), step: float | None = None
) -> np.recarray[Any, Any]:
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


FLEXED = np.radians(55.0)
CYCLE = HEEL_STRIKE["right"]
"""Start and end [s] of the one complete gait cycle"""
APART = 0.2
"""Least time [s] between two load peaks"""
AROUND_PEAK = 0.05
"""Largest time [s] between a peak of the contact and that of the load"""


class Moment(NamedTuple):
    """A named time [s]."""

    name: str
    time: float


def load_peaks(side: str) -> list[float]:
    """Times [s] of the load's peaks: above one body weight, the largest within `APART` on both sides."""
    time, _, load = gait(side)
    found, _ = find_peaks(load, height=BODY_WEIGHT, distance=APART / (time[1] - time[0]))
    return [float(t) for t in time[found]]


def second_stance() -> tuple[float, float]:
    """Times [s] of the two load peaks after the right leg's second heel strike."""
    first, second = (time for time in load_peaks("right") if time > CYCLE[1])
    return first, second


def phases() -> tuple[Moment, ...]:
    """The four phases of the right leg, in the paper's order, which is also their order in time."""
    first, second = second_stance()
    return (
        Moment("55° flexion", passages()[-1]),
        Moment("heel strike", CYCLE[1]),
        Moment("first peak", first),
        Moment("second peak", second),
    )


def passages() -> list[float]:
    """Times [s] at which the right leg's swing passes through 55 degrees."""
    time, angle, _ = gait("right")
    return [crossing for crossing in crossings(time, angle, FLEXED) if crossing < CYCLE[1]]


def crossings(time: NDArray[np.float64], values: NDArray[np.float64], level: float) -> list[float]:
    """Times [s] at which a piecewise linear series passes through a level."""
    above = values - level
    left = np.flatnonzero(above[:-1] * above[1:] < 0.0)
    part = above[left] / (above[left] - above[left + 1])
    return [float(t) for t in time[left] + part * (time[left + 1] - time[left])]


def at(moment: float, values: NDArray[Any], side: str = "right") -> float:
    """Value of a series at a time [s]."""
    return float(np.interp(moment, gait(side)[0], values))


def peak(moment: float, values: NDArray[Any], side: str = "right") -> float:
    """Largest value of a series around a load peak."""
    return float(values[np.abs(gait(side)[0] - moment) <= AROUND_PEAK].max())


def within(start: float, end: float, step: float | None = None) -> NDArray[np.bool_]:
    """Mask of the samples of the right leg in a time range [s]."""
    time = gait("right", step)[0]
    return np.asarray((time >= start) & (time <= end))


Table = tuple[tuple[str, ...], list[list[str]]]
"""Header and rows"""


def compare(
    quantity: str, paper: float, ours: float, unit: str, digits: int, why: str
) -> list[str]:
    """Row of a comparison; the paper's number keeps its digits."""
    difference = ours - paper
    shown = f"{signed(difference, digits)} {unit}"
    if unit != "%":
        shown += f" ({signed(100.0 * difference / abs(paper), 1)} %)"
    return [quantity, f"{paper:g} {unit}", f"{ours:.{digits}f} {unit}", shown, why]


def signed(value: float, digits: int) -> str:
    """Format a number with its sign, and without one if it rounds to zero."""
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}" if rounded else f"{0.0:.{digits}f}"


def unprinted(quantity: str, ours: str, why: str) -> list[str]:
    """Row about something that the paper gives no number for."""
    return [quantity, "-", ours, "-", why]


def thousands(value: float, digits: int = 0) -> str:
    """Format a number with thin groups of three digits."""
    return f"{value:,.{digits}f}".replace(",", " ")
