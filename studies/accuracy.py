"""Largest error of the penetration depth against the reference, scene by scene and tolerance by tolerance.

python -m studies.accuracy [--output FILE]
"""

from __future__ import annotations

import math
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks import reference
from benchmarks.gait import gait
from benchmarks.report import Section, machine, save
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw
from knee_contact_ros.model.mechanisms import hinge, translation_table
from knee_contact_ros.model.profiles import Circle
from knee_contact_ros.model.surfaces import ContactPair, Cup, Plane
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.model.types import Status
from studies.ellipse import Ellipse, SmoothFemur
from studies.reference import LAWS

TOLERANCES = (1e-6, 1e-8, 1e-10)
K1, K2, EXPONENT, DAMPING, LAYER, MASS = 7.905694e7, 3.112e9, 1.5, 5000.0, 5e-4, 9.3014
A, B, TIBIAL_RADIUS, SLOPE, TRANSLATION = 0.034, 0.028, 0.095, 0.12, 0.008
HEADER = (
    "scene",
    "tolerance [m]",
    "largest error [m]",
    "where the tolerance is said to be met [m]",
    "said to be missed",
    "covered by the estimate",
    "median estimate / error",
    "evaluations per tick",
)
TEXT = (
    "Errors of the signed depth (penetration, or gap) at every tick against SciPy's DOP853 (stiff scenes: Radau) at a "
    "relative tolerance of 1e-12, split at every event (`benchmarks/reference.py`). The estimate's share "
    "is of all ticks, its median ratio of those with an error above 1e-12 m."
)
IMPACT_DAMPED = [
    name for name, make in CONTACT_LAWS.items() if "restitution" in signature(make).parameters
]
"""Names of the laws whose damping follows from a coefficient of restitution"""
Series = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""Time [s], flexion angle [rad] and load [N], shape (n,) each"""


class Knee(NamedTuple):
    """A femur on a tibia in both forms: the model's and the reference's."""

    pair: ContactPair
    femur: reference.Femur


TURN = np.linspace(-math.pi, math.pi, 1501)
FORWARDS = translation_table(TURN, TRANSLATION * np.sin(TURN))
"""Mechanism that carries the femur forwards by `TRANSLATION` x sin(angle); the spline is 5e-14 m off"""
SMOOTH = SmoothFemur(closed_form=Ellipse(A, B).support)
CIRCLE = Knee(ContactPair(Circle(A), Plane(0.0), hinge()), reference.ByDepth(reference.circle))
ELLIPSE = Knee(
    ContactPair(SMOOTH, Plane(0.0), hinge()), reference.ByDepth(reference.ellipse(A, B))
)
SLOPED = Knee(
    ContactPair(SMOOTH, Plane(SLOPE), FORWARDS),
    reference.ByHeight(reference.ellipse_on_slope(A, B, SLOPE, TRANSLATION)),
)
CONCAVE = Knee(
    ContactPair(Circle(A), Cup(TIBIAL_RADIUS), FORWARDS),
    reference.ByHeight(reference.circle_in_circle(A, TIBIAL_RADIUS, TRANSLATION)),
)


class Study(NamedTuple):
    """A scene in both forms: the model's and the reference's."""

    name: str
    series: Series
    law: ContactLaw
    layers: reference.Layers
    mass: float = MASS
    knee: Knee = CIRCLE
    stiff: bool = False


def studies() -> list[Study]:
    """List all scenes of the study."""
    spring = {"stiffness": K1, "exponent": EXPONENT}
    layered = spring | {"layer_depth": LAYER, "stiffness_2": K2, "damping": DAMPING}
    kelvin_voigt = CONTACT_LAWS["kelvin_voigt"](**spring, damping=DAMPING)
    right, left = gait("right"), gait("left")
    ours = CONTACT_LAWS["two_layer_viscoelastic"]
    theirs = reference.kelvin_voigt(K1, EXPONENT, DAMPING)
    impact = spring | {"restitution": 0.5, "least_impact_speed": 0.1}
    return [
        Study("gait, right", right, kelvin_voigt, theirs),
        Study("gait, left", left, kelvin_voigt, theirs),
        Study("gait, right, ellipse", right, kelvin_voigt, theirs, knee=ELLIPSE),
        Study(
            "gait, right, ellipse carried forwards on a slope",
            right,
            kelvin_voigt,
            theirs,
            knee=SLOPED,
        ),
        Study(
            "gait, right, circle carried forwards in a concave circle",
            right,
            kelvin_voigt,
            theirs,
            knee=CONCAVE,
        ),
        Study(
            "gait, right, Hertz (undamped)",
            right,
            CONTACT_LAWS["hertz"](**spring),
            reference.kelvin_voigt(K1, EXPONENT, 0.0),
        ),
        Study(
            "gait, right, two layers as printed",
            right,
            ours(**layered, damp_first_layer=False),
            reference.two_layer(K1, EXPONENT, DAMPING, LAYER, K2, damped=False),
        ),
        Study(
            "gait, right, two layers damped",
            right,
            ours(**layered, damp_first_layer=True),
            reference.two_layer(K1, EXPONENT, DAMPING, LAYER, K2, damped=True),
        ),
        Study(
            "gait, right, two layers elastic",
            right,
            CONTACT_LAWS["two_layer_elastic"](**spring, layer_depth=LAYER, stiffness_2=K2),
            reference.two_layer(K1, EXPONENT, 0.0, LAYER, K2, damped=False),
        ),
        Study("lift-off and landing", lift_off(), kelvin_voigt, theirs),
        Study("lift-off and landing, ellipse", lift_off(), kelvin_voigt, theirs, knee=ELLIPSE),
        Study(
            "lift-off and landing, circle in a concave circle",
            lift_off(),
            kelvin_voigt,
            theirs,
            knee=CONCAVE,
        ),
        Study(
            "lift-off and landing, two layers",
            lift_off(),
            ours(**layered, damp_first_layer=False),
            reference.two_layer(K1, EXPONENT, DAMPING, LAYER, K2, damped=False),
        ),
        *(
            Study(
                f"lift-off and landing, {name}",
                lift_off(),
                CONTACT_LAWS[name](**impact),
                reference.impact_damped(K1, EXPONENT, LAWS[name](**impact).loss, 0.1),
            )
            for name in IMPACT_DAMPED
        ),
        Study(
            "stiff: K 1e10, C 1e6, 0.1 kg",
            right,
            CONTACT_LAWS["kelvin_voigt"](stiffness=1e10, exponent=1.5, damping=1e6),
            reference.kelvin_voigt(1e10, 1.5, 1e6),
            mass=0.1,
            stiff=True,
        ),
        Study(
            "stiff: K 1e12, C 2e3, 0.1 kg, lift-off and landing",
            cut(lift_off(), 60, 200),
            CONTACT_LAWS["kelvin_voigt"](stiffness=1e12, exponent=1.5, damping=2e3),
            reference.kelvin_voigt(1e12, 1.5, 2e3),
            mass=0.1,
        ),
        Study(
            "stiff and overdamped: C 1e7, 1 g",
            right,
            CONTACT_LAWS["kelvin_voigt"](stiffness=K1, exponent=1.5, damping=1e7),
            reference.kelvin_voigt(K1, 1.5, 1e7),
            mass=1e-3,
            stiff=True,
        ),
    ]


def lift_off() -> Series:
    """A knee that is let go of once in a quarter of a second, and lands; it bends and stretches meanwhile."""
    time = np.arange(501, dtype=np.float64) * 1e-3
    return time, 0.4 + 0.4 * np.sin(9.0 * time), 300.0 + 350.0 * np.cos(math.tau * time / 0.25)


def cut(series: Series, first: int, last: int) -> Series:
    """Part of a series between two times [s]."""
    time, angle, load = series
    return time[first:last], angle[first:last], load[first:last]


def ours(study: Study, tolerance: float) -> np.recarray[Any, Any]:
    """Answers of the model to a scene, one per tick."""
    pair, level = study.knee.pair, LEVELS["dynamic"]
    return KneeModel(
        pair, study.law, study.mass, tolerance, budget=0, level=level, compiled=None
    ).run(*study.series)


def theirs(study: Study) -> NDArray[np.float64]:
    """Signed depth [m] by the reference, shape (n,)."""
    return reference.solve(
        reference.Scene(*study.series, study.layers, study.mass, study.knee.femur, study.stiff)
    )


def row(study: Study, tolerance: float, exact: NDArray[np.float64]) -> list[str]:
    """Row of the table for a scene and a tolerance [m]."""
    series = ours(study, tolerance)
    error = np.abs(series.penetration_depth - series.gap - exact)
    said = series.status & Status.NOT_CONVERGED != 0
    covered = np.mean(error <= series.error_estimate + 1e-15)
    large = error > 1e-12
    padding = np.median(series.error_estimate[large] / error[large]) if large.any() else math.nan
    return [
        study.name,
        f"{tolerance:.0e}",
        f"{error.max():.1e}",
        f"{error[~said].max():.1e}",
        f"{100 * said.mean():.1f} %",
        f"{100 * covered:.1f} %",
        f"{padding:.0f}" if large.any() else "-",
        f"{series.evaluations.mean():.0f}",
    ]


@click.command()
@click.option(
    "--output", type=click.Path(path_type=Path), default=Path("docs/studies/accuracy.md")
)
def main(output: Path) -> None:
    """Measure and write the table."""
    rows = []
    for study in studies():
        exact = theirs(study)
        for tolerance in TOLERANCES:
            rows.append(row(study, tolerance, exact))
            click.echo(" | ".join(rows[-1]), err=True)
    save(
        output,
        "Accuracy",
        "python -m studies.accuracy",
        [Section("", TEXT, HEADER, rows)],
        machine(),
    )


if __name__ == "__main__":
    main()
