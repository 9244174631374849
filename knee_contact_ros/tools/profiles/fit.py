"""Fit a profile to a slice of a surface, with circles, thickness of cartilage, and remarks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.profiles.charts import Chart, Flat, Polar, circle
from knee_contact_ros.tools.profiles.shape import FittedCircle, Shape, femoral_circles, shape_of, tibial_circles
from knee_contact_ros.tools.profiles.slices import slices
from knee_contact_ros.tools.profiles.smooth import Smoothed, smooth
from knee_contact_ros.tools.profiles.surface import Surface
from knee_contact_ros.tools.profiles.thickness import Thickness, thickness

TOLERANCE, SLAB = 0.05e-3, 2e-3
"""Defaults of the tolerance and of the slab's half thickness [m]"""
FLATTEST_FEMUR = 0.35
"""Smallest ratio of height and width of a femur's slice: a condyle has some 0.8, a plateau 0.1 to 0.2"""
NOTABLE = 0.5e-3
"""Deviation of the slice from the profile [m] from which on it is reported"""
GAIT, LEAST_REACH = (0.0, 60.0), 0.5
"""Directions of the normal [deg] that are in contact in gait, and the least share of them that a condyle has"""
WORST = 1e-3
"""Largest roughness [m] of a slice that counts as a condyle or plateau"""


class Fit(NamedTuple):
    """Profile in the mesh's frame, with its circles, thickness of cartilage, and remarks."""

    femur: bool
    """Whether it is a femur's profile, and not a tibia's"""
    z: float
    """Place of the slice [m]"""
    slab: float
    """Half thickness of the slab [m]"""
    tolerance: float
    """RMS distance from the slice that smoothing may add [m]"""
    smoothed: Smoothed
    shape: Shape
    circles: list[FittedCircle]
    thickness: Thickness | None
    remarks: tuple[str, ...]


def fit(
    surface: Surface, z: float, *, femur: bool = True, bone: Surface | None = None,
    tolerance: float = TOLERANCE, slab: float = SLAB,
) -> Fit:  # fmt: skip
    """Fit a femur's or a tibia's profile to the slice of a surface at `z` [m]; see `smooth` for `tolerance` [m].

    Raises:
        UsageError: the slice is empty, or no femur's or tibia's.
    """
    chart_of: type[Chart] = Polar if femur else Flat
    slab_points = slices(surface, z, slab, chart_of)
    check_side(surface, slab_points.raw, femur)
    chart = chart_of.around(slab_points.raw)
    smoothed = smooth(slab_points, chart, tolerance)
    if smoothed.roughness > WORST:
        worst = smoothed.raw[int(np.abs(smoothed.deviations).argmax())]
        kind = "convex condyle" if femur else "plateau"
        raise UsageError(
            f"{surface.path}: the slice at z = {1e3 * z:g} mm is no {kind}: no profile comes closer to it than "
            f"{1e3 * smoothed.roughness:.1f} mm RMS ({1e3 * smoothed.largest:.1f} mm at x = {1e3 * worst[0]:.1f}, "
            f"y = {1e3 * worst[1]:.1f} mm); cut off what is no articular surface, or see --slice, --side and --axes"
        )
    shape = shape_of(smoothed.points)
    if femur:
        check_reach(surface, z, shape)
    cartilage = thickness(shape, chart, bone, z, femur) if bone is not None else None
    circles = femoral_circles(shape) if femur else tibial_circles(shape)
    remarks = (*slab_points.remarks, *far_off(smoothed))
    return Fit(femur, z, slab, tolerance, smoothed, shape, circles, cartilage, remarks)


def check_reach(surface: Surface, z: float, shape: Shape) -> None:
    """Refuse a profile that cannot be in contact in most of a gait, as of a slice through the intercondylar notch."""
    low, high = np.degrees([shape.normal.min(), shape.normal.max()])
    if min(high, GAIT[1]) - max(low, GAIT[0]) < LEAST_REACH * (GAIT[1] - GAIT[0]):
        raise UsageError(
            f"{surface.path}: the slice at z = {1e3 * z:g} mm has outward normals of {low:.0f}° to {high:.0f}° "
            f"(0 down, > 0 posterior), and in gait those of {GAIT[0]:g}° to {GAIT[1]:g}° touch: --slice through a "
            "condyle, or see --axes"
        )


def far_off(smoothed: Smoothed) -> list[str]:
    """Report where the slice lies far from the profile, which is more than the noise of a mesh."""
    at = int(np.abs(smoothed.deviations).argmax())
    off = float(smoothed.deviations[at])
    if abs(off) < NOTABLE:
        return []
    x, y = 1e3 * smoothed.raw[at]
    where = "outside of" if off > 0.0 else "behind"
    return [
        f"the slice lies {1e3 * abs(off):.1f} mm {where} the profile at x = {x:.1f}, y = {y:.1f} mm: a dent or a step?"
    ]


def check_side(surface: Surface, raw: Floats, femur: bool) -> None:
    """Refuse a tibia as a femur, a femur as a tibia, and a femur upside down."""
    width, height = np.ptp(raw, axis=0)
    flatness = height / max(width, 1e-9)
    if femur and flatness < FLATTEST_FEMUR:
        raise UsageError(
            f"--side femur: the slice of {surface.path} is {1e3 * width:.1f} mm wide and {1e3 * height:.1f} mm high, "
            "as flat as a tibial plateau: --side tibia? (or see --axes and --slice)"
        )
    if not femur and flatness > FLATTEST_FEMUR:
        raise UsageError(
            f"--side tibia: the slice of {surface.path} is {1e3 * width:.1f} mm wide and {1e3 * height:.1f} mm high, "
            "as round as a femoral condyle: --side femur? (or see --axes and --slice)"
        )
    if femur and (raw - circle(raw)[0]).mean(axis=0)[1] > 0.0:
        raise UsageError(
            f"--side femur: the condyle of {surface.path} looks up, not down: see --axes (x,-y,z turns it over)"
        )
