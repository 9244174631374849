"""`knee-contact fit-profile`: from a mesh of cartilage to a profile for the model.

It reads, cuts, smooths and measures the mesh, writes the profile as CSV, a picture and a parameter file, and prints a
report.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from knee_contact_ros.lab.checks import outside, refuse
from knee_contact_ros.lab.profiles.fit import (
    GAIT,
    SLAB,
    TOLERANCE,
    Fit,
    circle,
    concave,
    contact_centre,
    fit,
)
from knee_contact_ros.lab.profiles.surfaces import Surface, read_surface
from knee_contact_ros.model.types import MM, Floats
from knee_contact_ros.parameters.files import parameter_text
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require
from knee_contact_ros.system.output_files import check_name_free, check_not_input, write_complete
from knee_contact_ros.view.picture import CURVES_STYLE, png_figure

LABEL = 11
"""Width of a line's label on the terminal, with the space after it"""
PROFILE, RAW, BONE = "#0072B2", "0.6", "#B08968"
CIRCLES = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
"""Colours of circles"""
FAR_CONDYLE, FAR_PLATEAU = 40.0, 70.0
"""Largest distances [mm] from the origin to the middle of a condyle's circle, and to a plateau"""
SIZE, DPI = (8.0, 9.0), 110
"""Size of a picture [in] and its resolution"""


def run_fit_profile(
    mesh: Path,
    output: Path,
    slice: str,  # noqa: A002
    *,
    bone: Path | None = None,
    femur: bool = True,
    medial: bool = True,
    unit: str | None = None,
    axes: str | None = None,
    label: int | None = None,
    bone_label: int | None = None,
    tolerance: float = TOLERANCE,
    slab: float = SLAB,
    origin: str | None = None,
    overwrite: bool = False,
) -> list[str]:
    """Fit a profile and write CSV, picture and parameter file; return the lines of the report.

    Args:
        mesh: Surface of the cartilage: a mesh, a cloud of points or a label map.
        output: The CSV file; picture and parameter file have its name with other suffixes.
        slice: Place of the slice along z [mm], or `auto`.
        bone: Surface of the bone under the cartilage; None: the thickness is not measured.
        femur: Whether the surface is a femur's (else a tibia's).
        medial: Whether `auto` looks for the medial compartment (else the lateral one).
        unit: Unit of the files; None: the default of their kind.
        axes: Axes of the files; None: the default of their kind.
        label: Label of the cartilage in a label map.
        bone_label: Label of the bone in a label map.
        tolerance: RMS distance from the slice that smoothing may add [m].
        slab: Half thickness of the slab [m].
        origin: Origin of the profile: `mesh`, the mesh's own (default for a femur); `surface`, the tibia's surface at
            the mesh's x = 0 (default for a tibia); or `X,Y`, a point in mm.
        overwrite: Whether existing output files are replaced.

    Raises:
        UsageError: the surface, an option or an output cannot be used.
    """
    require("mesh", "pyvista", "trimesh", "nibabel", "matplotlib")
    outputs = [output.with_suffix(suffix) for suffix in (".csv", ".png", ".yaml")]
    for path in outputs:
        check_not_input(path, filter(None, (mesh, bone)))
        if not overwrite:
            check_name_free(path)
    surface = read_surface(mesh, unit, axes, label)
    under = read_surface(bone, unit, axes, bone_label) if bone else None
    z = _place(slice, surface, femur, medial)
    found = fit(surface, z, femur=femur, bone=under, tolerance=tolerance, slab=slab)
    start = _origin(found, origin, mesh)
    profile = csv(found, mesh.name, found.smoothed.points - start)
    contents = (
        profile.encode(),
        picture(found, mesh.name),
        _parameter_file(found, outputs[0]).encode(),
    )
    write_complete(dict(zip(outputs, contents, strict=True)))
    files = zip(("CSV", "picture", "parameters"), outputs, strict=True)
    return [
        f"{label:<{LABEL - 1}} {text}"
        for label, text in (*_report(found, mesh.name, start), *files)
    ]


def _place(text: str, surface: Surface, femur: bool, medial: bool) -> float:
    """Place z of the slice [m]."""
    if text == "auto":
        return contact_centre(surface, femur, medial)
    place = _numbers(text)
    if len(place) != 1 or not abs(place[0]) < 1.0:
        raise UsageError(
            f"--slice {text}: it must be a place in mm along the medio-lateral axis z, or auto"
        )
    return place[0]


def _origin(found: Fit, text: str | None, mesh: Path) -> Floats:
    """Origin of the profile in the mesh's axes [m], shape (2,).

    An origin outside the knee is refused, such as a mesh's origin at the hip or in the scanner: a femur rotates about
    its origin, and would leave the plateau.
    """
    points, text = found.shape.points, text or ("mesh" if found.femur else "surface")
    x, y = points.T
    place = [0.0, 0.0] if text == "mesh" else _numbers(text)
    if text == "surface" and not found.femur:
        place = [0.0, float(np.interp(0.0, x, y, left=math.nan, right=math.nan))]
    if len(place) != 2 or not np.isfinite(place).all():
        allowed = "mesh or X,Y in mm" + ", or surface if the plateau reaches over x = 0" * (
            not found.femur
        )
        raise UsageError(
            f"--origin {text}: it must be {allowed}; this is x = {MM * x.min():.1f} to {MM * x.max():.1f} mm"
        )
    where = f"{mesh}, --origin {','.join(f'{MM * each:g}' for each in place)}"
    what, away, most = "plateau", float(np.hypot(*(points - place).T).min()), FAR_PLATEAU
    cure = "give surface or X,Y in mm"
    if found.femur:
        touching = (found.shape.normal >= math.radians(GAIT[0])) & (
            found.shape.normal <= math.radians(GAIT[1])
        )
        middle = circle(points[touching])[0]
        what, away, most = "condyle's middle", math.dist(middle, place), FAR_CONDYLE
        cure = (
            f"a femur turns about it: give the joint's axis in the mesh by --origin=X,Y, or this condyle's middle: "
            f"--origin={','.join(f'{round(MM * each, 1) + 0.0:.1f}' for each in middle)}"
        )
    refuse(outside(where, f"the distance of the {what}", MM * away, "mm", (0.0, most), cure))
    return np.array(place)


def _numbers(text: str) -> list[float]:
    """Lengths [m] from comma-separated numbers in mm; NaN if one is not a number."""
    try:
        return [float(number) * 1e-3 for number in text.split(",")]
    except ValueError:
        return [math.nan]


def _report(found: Fit, name: str, origin: Floats) -> list[tuple[str, str]]:
    """Labels and texts of the report; `name` is the mesh's, `origin` the profile's origin [m], shape (2,)."""
    smoothed, shape, rows = found.smoothed, found.shape, []
    for each in found.circles:
        low, high = each.window
        window = (
            f"normals of {low:.0f}° to {high:.0f}°"
            if found.femur
            else f"x = {low:.1f} to {high:.1f} mm"
        )
        rows.append(("circle", f"radius {MM * each.radius:.2f} mm over {window}"))
    if found.thickness is not None:
        along, mean = MM * found.thickness.along, found.thickness.mean
        zone = "normals of -15° to 70°" if found.femur else "the middle half of the width"
        rows += [
            (
                "cartilage",
                f"{MM * mean:.2f} mm on average where gait touches ({zone}); {along.mean():.2f} mm over the "
                f"whole profile, {along.max():.2f} mm at most",
            ),
            (
                "cartilage",
                f"thickness: {mean:.6f}   (m, this cartilage alone: add the other bone's, for a subject file "
                "or -p contact.layer_depth:=...)",
            ),
        ]
    hollow = [
        f"x = {MM * a:.1f} to {MM * b:.1f} mm" for a, b in ([] if found.femur else concave(shape))
    ]
    curvature = (
        f"concave from {', '.join(hollow)}; convex elsewhere" if hollow else "convex everywhere"
    )
    if found.femur:
        begin, end = sorted(np.degrees(shape.normal[[0, -1]]))
        low, high = float(shape.curvature.min()), float(shape.curvature.max())
        largest = f"{MM / low:.1f}" if low > 0.0 else "infinite"
        curvature += (
            f"; radius {MM / high:.1f} to {largest} mm; normals from {begin:.0f}° to {end:.0f}°"
        )
    return [
        (
            "profile",
            f"{_side(found)} of {name}, slice at z = {MM * found.z:g} mm, {len(smoothed.points)} points",
        ),
        ("origin", f"x = {MM * origin[0]:.5f}, y = {MM * origin[1]:.5f} mm of the mesh"),
        ("tolerance", _tolerance(found)),
        (
            "deviation",
            f"{MM * smoothed.rms:.3f} mm RMS, {MM * smoothed.largest:.3f} mm at most, of the "
            f"{len(smoothed.raw)} points of the slice",
        ),
        ("curvature", curvature),
        *rows,
        *(("note", remark) for remark in found.remarks),
    ]


def _side(found: Fit) -> str:
    return "femur" if found.femur else "tibia"


def _tolerance(found: Fit) -> str:
    """Describe the tolerance, the roughness and the resulting deviation in a line."""
    rough, where = (
        found.smoothed.roughness,
        f"slab of ±{MM * found.slab:g} mm" if found.slab else "slice",
    )
    allowed = MM * math.hypot(rough, found.tolerance)
    return (
        f"{MM * found.tolerance:.3g} mm RMS beyond the roughness of {MM * rough:.3f} mm: at most "
        f"{allowed:.3f} mm; {MM * found.smoothed.deviation:.3f} mm in the {where}"
    )


def csv(found: Fit, name: str, points: Floats) -> str:
    """Write a profile as CSV text for `femur.profile` or `tibia.profile`; `points`, shape (n, 2) [m], are its own."""
    header = [
        f"{_side(found).capitalize()} profile, sagittal slice at z = {MM * found.z:g} mm, from posterior to anterior.",
        f"Made by knee-contact fit-profile from {name}.",
        f"Smoothed: {_tolerance(found)}.",
        f"Slice to profile: {MM * found.smoothed.rms:.3f} mm RMS, {MM * found.smoothed.largest:.3f} mm at most.",
        "x anterior, y superior [m].",
    ]
    rows = [f"{x:.8f},{y:.8f}" for x, y in points]
    return "\n".join([*(f"# {' '.join(line.split())}" for line in header), "x,y", *rows, ""])


def _parameter_file(found: Fit, profile: Path) -> str:
    """Write a parameter file as YAML text that sets the profile and nothing else."""
    side, quoted = _side(found), str(profile.resolve()).replace("'", "''")
    hint = "give this file after healthy.yaml; osteoarthritis.yaml may come before or after it."
    values = (f"{side}:", "  geometry: profile", f"  profile: '{quoted}'")
    return parameter_text(Parameters, [f"The {side} of {profile.name}: {hint}"], values)


def picture(found: Fit, name: str) -> bytes:
    """Draw slice and profile, and below them curvature, deviations and thickness, as PNG; `name` is the mesh's."""
    from scipy.spatial import cKDTree

    smoothed, shape, thickness = found.smoothed, found.shape, found.thickness
    along = np.degrees(shape.normal) if found.femur else MM * shape.points[:, 0]
    heights = [2.5, 1.0, 1.0, *([1.0] if thickness else [])]
    file = io.BytesIO()
    with png_figure(file, SIZE, DPI, **CURVES_STYLE | {"font.size": 9.5}) as canvas:
        whole, *rows = canvas.subplots(len(heights), 1, height_ratios=heights)
        for number, piece in enumerate(MM * thickness.bone if thickness else ()):
            whole.plot(*piece.T, color=BONE, linewidth=1.2, label=None if number else "bone")
        whole.plot(
            *(MM * smoothed.raw).T, "o", color=RAW, markersize=3.0, label="slice of the mesh"
        )
        whole.plot(*(MM * shape.points).T, color=PROFILE, linewidth=1.6, label="profile")
        for number, (each, colour) in enumerate(zip(found.circles, CIRCLES, strict=False)):
            width = 4.5 - number  # they may lie on each other
            rows[0].plot(
                each.window, (1.0 / (MM * each.radius),) * 2, color=colour, linewidth=width
            )
            whole.plot(
                *(MM * each.part).T,
                color=colour,
                label=f"circle of radius {MM * each.radius:.1f} mm",
            )
        nearest = along[cKDTree(shape.points).query(smoothed.raw)[1]]
        rows[0].plot(along, shape.curvature / MM, color=PROFILE, linewidth=1.5)
        rows[1].plot(nearest, MM * smoothed.deviations, ".", color="0.3", markersize=3.5)
        most = f"{MM * smoothed.rms:.3f} mm RMS, {MM * smoothed.largest:.2f} mm at most"
        hollow = "" if found.femur else ", concave positive"
        titles = [
            f"curvature of the profile and of the circles{hollow}",
            f"slice outside of the profile: {most}",
        ]
        if thickness:
            rows[2].plot(along, MM * thickness.along, color=BONE, linewidth=1.5)
            titles.append(f"cartilage: {MM * thickness.mean:.2f} mm on average where gait touches")
        for row, unit, title in zip(rows, ("[1/mm]", "[mm]", "[mm]"), titles, strict=False):
            row.sharex(rows[0])
            row.axhline(0.0, color="0.5", linewidth=0.8)
            row.set(ylabel=unit, title=title)
        rows[-1].set_xlabel(
            "outward normal: 0 down, posterior positive [°]" if found.femur else "x, anterior [mm]"
        )
        whole.set_aspect("equal", adjustable="datalim")
        title = f"{_side(found).capitalize()} of {name}, z = {MM * found.z:g} mm: x anterior, y superior [mm]"
        whole.set_title(title.replace("$", r"\$"))
        canvas.align_ylabels()
        canvas.legend(loc="outside lower center", ncols=3)
    return file.getvalue()
