"""Contact points in the tibia frame at the paper's four phases (Figs. 10 and 12)."""

from __future__ import annotations

from itertools import product

import numpy as np

from benchmarks.report import Section
from studies.reproduction.page import figure
from studies.reproduction.phases import Moment, at, passages, phases
from studies.reproduction.scenes import (
    CURVED_TIBIAE,
    MECHANISMS,
    MM,
    SPHERE_AND_CURVE,
    body_weights,
    gait,
    run,
)

CAPTION = (
    "Contact point on the plateau over time and over flexion, right leg. Markers: the four phases. A sphere on a hinge "
    "stays at 0."
)


def section() -> Section:
    """Section on the contact points: phases by geometry, over the mechanisms."""
    header = ("phase", "time [s]", "flexion [°]", "load [BW]", "femur", "depth [mm]",
              *(f"x, {name} [mm]" for name in MECHANISMS))  # fmt: skip
    rows = [_line(moment, femur, files) for femur, files in SPHERE_AND_CURVE.items() for moment in phases()]
    text = (
        "The text gives no numbers for the contact points; these are ours. x is anterior in the tibia frame, whose "
        "origin lies below the femoral reference point at full extension. The swing passes through 55° twice, at "
        f"{' and '.join(f'{time:.3f} s' for time in passages())}; the table takes the later one, so that the four "
        "phases follow each other as in the paper. Values between two samples are linear. On the flat plateau the "
        "depth does not depend on the mechanism. In the plane, hinge and ball-and-socket are one fixed axis: a "
        "sphere then touches in one point for ever, and the MRI curve rolls. The parallel mechanism carries x(θ) of "
        "the medial sphere's centre of another, published knee; the table has the mean of 20 knees, of the "
        "condyles' geometric centre axis. Neither was measured on the knee that the profile comes from, nor about "
        "its reference point, so combining them is an approximation.\n\n" + figure("contact_points", CAPTION)
    )
    return Section("5. Contact points at four phases (Figs. 10, 12)", text, header, rows)


def curved_section() -> Section:
    """Section on the general two-body case: a tibia that is curved."""
    header = ("phase", "tibia", "femur", "x [mm]", "y [mm]", "depth [mm]", "depth against the plane [%]")
    rows = [
        _curved_line(moment, tibia, femur)
        for tibia, femur in product(CURVED_TIBIAE, SPHERE_AND_CURVE)
        for moment in phases()
    ]
    text = (
        "### A curved tibia\n\n"
        "The general two-body case (Eqs. 1 to 6), hinge, all else equal: the tibia as a concave circle of 95 mm with "
        "its lowest point in the tibia frame's origin, and as the medial cartilage of the MRI knee that the fitted "
        "curve comes from, in that knee's own place. A sphere on a hinge sits in the bottom of the circle. The fitted "
        "curve, whose circle near extension has its centre in front of the reference point, touches further from the "
        "origin than on the plane, where the normal is inclined: but for inertia the normal force is the load over "
        "n_y, and the depth grows with it. Where the reference point lies over the circle is an assumption. The MRI "
        "plateau rises to the front, and near extension the femur touches on that slope."
    )
    return Section("", text, header, rows)


def _line(moment: Moment, femur: str, files: tuple[str, ...]) -> list[str]:
    _, angle, load = gait("right")
    runs = [run(*files, changes=changes) for changes in MECHANISMS.values()]
    return [
        moment.name, f"{moment.time:.3f}", f"{np.degrees(at(moment.time, angle)):.1f}",
        f"{body_weights(at(moment.time, load)):.3f}", femur, f"{MM * at(moment.time, runs[0].penetration_depth):.4f}",
        *(_signed(MM * at(moment.time, series.contact_point.x)) for series in runs),
    ]  # fmt: skip


def _curved_line(moment: Moment, tibia: str, femur: str) -> list[str]:
    files = SPHERE_AND_CURVE[femur]
    plane, curved = run(*files), run(*files, changes=CURVED_TIBIAE[tibia])
    depth, flat = (at(moment.time, series.penetration_depth) for series in (curved, plane))
    x, y = (MM * at(moment.time, curved.contact_point[axis]) for axis in "xy")
    change = _signed(100.0 * (depth / flat - 1.0))
    return [moment.name, tibia, femur, _signed(x), _signed(y), f"{MM * depth:.4f}", change]


def _signed(value: float) -> str:
    """Format a number with two decimals, without a negative zero."""
    return f"{round(value, 2) + 0.0:.2f}"
