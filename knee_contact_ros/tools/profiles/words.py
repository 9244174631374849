"""Texts on a fit: the report on the terminal, the profile's CSV file and the parameter file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.tools.profiles.fit import Fit
from knee_contact_ros.tools.profiles.shape import concave, dented

MM = 1e3


def report(fit: Fit, name: str, origin: Floats) -> list[str]:
    """Lines of the report on the terminal; `name` is the mesh's, `origin` the profile's origin [m], shape (2,)."""
    smoothed = fit.smoothed
    rows = [
        ("profile", f"{side(fit)} of {name}, slice at z = {MM * fit.z:g} mm, {len(smoothed.points)} points"),
        ("origin", f"x = {MM * origin[0]:.5f}, y = {MM * origin[1]:.5f} mm of the mesh"),
        ("tolerance", tolerance(fit)),
        ("deviation", f"{MM * smoothed.rms:.3f} mm RMS, {MM * smoothed.largest:.3f} mm at most, of the "
                      f"{len(smoothed.raw)} points of the slice"),
        ("curvature", curvature(fit)),
        *[("circle", f"radius {MM * c.radius:.2f} mm over {window(fit, c.window)}") for c in fit.circles],
        *[("cartilage", text) for text in cartilage(fit)],
        *[("note", remark) for remark in fit.remarks],
    ]  # fmt: skip
    return [f"{label:<10} {text}" for label, text in rows]


def side(fit: Fit) -> str:
    """Name of the bone."""
    return "femur" if fit.femur else "tibia"


def tolerance(fit: Fit) -> str:
    """Describe the tolerance, the roughness and the resulting deviation."""
    smoothed = fit.smoothed
    allowed = math.hypot(smoothed.roughness, fit.tolerance)
    where = f"slab of ±{MM * fit.slab:g} mm" if fit.slab else "slice"
    return (
        f"{MM * fit.tolerance:.3g} mm RMS beyond the roughness of {MM * smoothed.roughness:.3f} mm: "
        f"at most {MM * allowed:.3f} mm; {MM * smoothed.deviation:.3f} mm in the {where}"
    )


def curvature(fit: Fit) -> str:
    """Describe the radii of curvature, and where the profile is convex or concave."""
    low, high = float(fit.shape.curvature.min()), float(fit.shape.curvature.max())
    if not fit.femur:
        places = [f"x = {MM * a:.1f} to {MM * b:.1f} mm" for a, b in concave(fit.shape)]
        return f"concave from {', '.join(places)}; convex elsewhere" if places else "convex everywhere"
    dents = [f"{np.degrees(b):.0f}° to {np.degrees(a):.0f}°" for a, b in dented(fit.shape)]
    if dents:
        return f"not convex at normals of {', '.join(dents)}"
    begin, end = sorted(np.degrees(fit.shape.normal[[0, -1]]))
    return (
        f"convex everywhere; radius {MM / high:.1f} to {f'{MM / low:.1f}' if low > 0.0 else 'infinite'} mm; "
        f"normals from {begin:.0f}° to {end:.0f}°"
    )


def window(fit: Fit, ends: tuple[float, float]) -> str:
    """Describe the window of a fitted circle."""
    low, high = ends
    return f"normals of {low:.0f}° to {high:.0f}°" if fit.femur else f"x = {low:.1f} to {high:.1f} mm"


def cartilage(fit: Fit) -> list[str]:
    """Describe the thickness of the cartilage and its use; no lines if it was not measured."""
    if fit.thickness is None:
        return []
    along = MM * fit.thickness.along
    zone = "normals of -15° to 70°" if fit.femur else "the middle half of the width"
    other = "tibia" if fit.femur else "femur"
    return [
        f"{MM * fit.thickness.mean:.2f} mm on average where gait touches ({zone}); {along.mean():.2f} mm over the "
        f"whole profile, {along.max():.2f} mm at most",
        f"this cartilage alone; as the depth at which bone begins, of both together: add the {other}'s and say",
        f"thickness: {fit.thickness.mean:.6f}   (m, so far) in a subject file, or -p contact.layer_depth:=...",
    ]


def csv(fit: Fit, name: str, points: Floats) -> str:
    """Write a profile as CSV text for `femur.profile` or `tibia.profile`; `points`, shape (n, 2) [m], are its own."""
    header = [
        f"{side(fit).capitalize()} profile, sagittal slice at z = {MM * fit.z:g} mm, from posterior to anterior.",
        f"Made by knee-contact fit-profile from {name}.",
        f"Smoothed: {tolerance(fit)}.",
        f"Slice to profile: {MM * fit.smoothed.rms:.3f} mm RMS, {MM * fit.smoothed.largest:.3f} mm at most.",
        "x anterior, y superior [m].",
    ]
    rows = [f"{x:.8f},{y:.8f}" for x, y in points]
    return "\n".join([*[f"# {' '.join(line.split())}" for line in header], "x,y", *rows, ""])


def fragment(fit: Fit, csv_path: Path) -> str:
    """Write a parameter file, as YAML text, that puts the profile into a model and changes nothing else."""
    quoted = str(csv_path.resolve()).replace("'", "''")
    lines = [
        f"# The {side(fit)} of {csv_path.name}: give this file after healthy.yaml; osteoarthritis.yaml may come "
        "before or after it.",
        "/**/knee_contact:",
        "  ros__parameters:",
        f"    {side(fit)}:",
        "      geometry: profile",
        f"      profile: '{quoted}'",
    ]
    return "\n".join([*lines, ""])
