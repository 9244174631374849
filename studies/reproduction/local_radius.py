"""What the depth would be if the stiffness followed the femur's local radius of curvature."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.report import Section
from knee_contact_ros.model.laws import relative_radius
from studies.gait import BODY_WEIGHT
from studies.reproduction.loads import PAPER_PEAKS
from studies.reproduction.phases import at, second_stance
from studies.reproduction.scenes import HEALTHY, MM, MRI, gait, model, parameters, static_depth

WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Flexion angles [deg] at which the fitted part of the profile touches."""
AROUND = 10.0
"""Flexion [deg] on both sides of a load peak's angle at which the fitted part touches"""
NOMINAL, TIBIA, PLANE = 0.034, 0.095, math.inf
"""Radii [m] to which the 2500 N/mm^1.5 are taken to belong."""
REDUCED = 0.994
"""Ratio of the depths of curve and sphere in the paper"""


def section() -> Section:
    """Section on static depths at 2.19 BW over the radius."""
    reference = static_depth(PAPER_PEAKS[1] * BODY_WEIGHT, HEALTHY)
    rows = [["sphere", f"{MM * NOMINAL:.1f} mm", *2 * (f"{MM * reference:.4f} mm (reference)",)]]
    for low, high, name in windows():
        radius = fitted_radius(low, high)
        depths = [depth_with(radius, tibia) for tibia in (PLANE, TIBIA)]
        part = f"fitted curve, touching at {low:.0f}° to {high:.0f}°{name}"
        compared = (f"{MM * depth:.4f} mm ({100 * (depth / reference - 1):+.1f} %)" for depth in depths)
        rows.append([part, f"{MM * radius:.1f} mm", *compared])
    plane, concave = radius_needed()
    text = (
        "### A stiffness from the local radius\n\n"
        "Hertz gives K ~ √R, hence δ ~ R^(-1/3) at a given force. Taking the 2500 N/mm^1.5 for the sphere of 34 mm, "
        "the static depth at 2.19 BW with the circles through parts of the MRI profile would be as below, with R of "
        "the femur on a plane and in the concave 95 mm. The profile is no circle, so its radius depends on the part "
        "that is fitted: on average near extension it is the sphere's, but around both peaks' angles of flexion it "
        "is smaller, and the depth would be larger and not smaller than the sphere's. The paper's reduction of "
        f"0.6 % would need a femoral radius of {MM * plane:.1f} mm on the plane or {MM * concave:.1f} mm in the "
        "concave tibia at the second peak: not implausible for another profile, but not what the text describes, and "
        "not part of our model."
    )
    return Section("", text, ("femur", "radius", "depth, plane", "depth, concave tibia"), rows)


def windows() -> list[tuple[float, float, str]]:
    """Ranges of flexion [deg] with their names."""
    angle = gait("right")[1]
    peaks = [np.degrees(at(time, angle)) for time in second_stance()]
    around = [(round(peak - AROUND), round(peak + AROUND), f" ({name} peak)") for name, peak in
              zip(("first", "second"), peaks, strict=True)]  # fmt: skip
    return [*((low, high, "") for low, high in WINDOWS), *around]


def fitted_radius(low: float, high: float) -> float:
    """Radius [m] of the circle through the part of the MRI profile that touches in a range of flexion [deg]."""
    points = model(HEALTHY, MRI).pair.femur.outline()
    tangent = np.gradient(points, axis=0)
    touches = np.degrees(np.arctan2(-tangent[:, 1], tangent[:, 0]))
    part = points[(touches >= low) & (touches <= high)]
    columns = np.column_stack([2.0 * part, np.ones(len(part))])
    x, y, rest = np.linalg.lstsq(columns, (part * part).sum(axis=1), rcond=None)[0]
    return float(np.sqrt(rest + x * x + y * y))


def depth_with(radius: float, tibia: float) -> float:
    """Static depth [m] at 2.19 BW with the stiffness of a femoral radius [m]."""
    ratio = math.sqrt(relative_radius(radius, tibia) / relative_radius(NOMINAL, tibia))
    stiffness = ratio * parameters(HEALTHY).contact.stiffness
    return static_depth(PAPER_PEAKS[1] * BODY_WEIGHT, HEALTHY, changes=(("contact.stiffness", stiffness),))


def radius_needed() -> tuple[float, float]:
    """Femoral radius [m] that reduces the depth as the paper says, on the plane and in the concave tibia."""
    plane = NOMINAL / REDUCED**3
    relative = relative_radius(NOMINAL, TIBIA) / REDUCED**3
    return plane, 1.0 / (1.0 / relative + 1.0 / TIBIA)
