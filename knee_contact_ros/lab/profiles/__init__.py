"""`knee-contact fit-profile`: from a mesh of cartilage to a profile for the model.

It reads, cuts, smooths and measures the mesh, writes the profile as CSV, a picture and a parameter file, and prints a
report.
"""

import io
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...model.types import MM, Floats
from ...parameters.files import parameter_text
from ...parameters.schema import Parameters
from ...system.errors import UsageError
from ...system.files import require
from ...system.output_files import check_name_free, check_not_input, write_complete
from ...view.picture import CURVES_STYLE, saved_figure
from ..checks import refuse_outside
from .chart import circle
from .fit import (
    GAIT_NORMALS,
    SLAB,
    SMOOTHING_TOLERANCE,
    ProfileFit,
    concave,
    fit,
)
from .slices import contact_centre
from .surfaces import Surface, cropped, read_surface

LABEL_WIDTH = 11
"""Width of a line's label on the terminal, with the space after it"""
_PROFILE_COLOUR = "#0072B2"
_BONE_COLOUR = "#B08968"
_CIRCLE_COLOURS = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
_LARGEST_DISTANCES = {True: 40.0, False: 70.0}
"""Largest distances [mm] from the origin to the middle of a femur's condyle, and (False) to a tibia's plateau"""
_PICTURE_SIZE = (8.0, 9.0)
"""Size of a picture [in]"""
_DOTS_PER_INCH = 110


class ProfileOptions(NamedTuple):
    """Options of the command `fit-profile`."""

    mesh: Path
    """Surface of the cartilage: a mesh, a cloud of points or a label map"""
    output: Path
    """The CSV file; picture and parameter file have its name with other suffixes"""
    slice: str
    """Place of the slice along z [mm], or `auto`"""
    bone: Path | None = None
    """Surface of the bone under the cartilage; None: the thickness is not measured"""
    femur: bool = True
    """Whether the surface is a femur's (else a tibia's)"""
    medial: bool = True
    """Whether `auto` looks for the medial compartment (else the lateral one)"""
    left: bool = False
    """Whether it is a left knee, which is mirrored to a right one"""
    unit: str | None = None
    """Unit of the files; None: the default of their kind"""
    axes: str | None = None
    """Axes of the files; None: the default of their kind"""
    label: int | None = None
    """Label of the cartilage in a label map"""
    bone_label: int | None = None
    """Label of the bone in a label map"""
    tolerance: float = SMOOTHING_TOLERANCE
    """RMS distance from the slice that smoothing may add [m]"""
    slab: float = SLAB
    """Half thickness of the slab [m]"""
    origin: str | None = None
    """Origin of the profile: `mesh`, the mesh's own (default for a femur); `surface`, the tibia's surface at the mesh's
    x = 0 (default for a tibia); or `X,Y`, a point in mm"""
    overwrite: bool = False
    """Whether existing output files are replaced"""


def run_fit_profile(options: ProfileOptions) -> list[str]:
    """Fit a profile and write CSV, picture and parameter file; return the lines of the report.

    Raises:
        UsageError: the surface, an option or an output cannot be used.
    """
    require("mesh", "pyvista", "trimesh", "nibabel", "matplotlib")
    mesh, bone, femur = options.mesh, options.bone, options.femur
    outputs = [options.output.with_suffix(suffix) for suffix in (".csv", ".png", ".yaml")]
    for path in outputs:
        check_not_input(path, filter(None, (mesh, bone)))
        if not options.overwrite:
            check_name_free(path)
    how = options.unit, options.axes
    surface = cropped(read_surface(mesh, *how, options.label, options.left), femur)
    under = None
    if bone:
        under = cropped(read_surface(bone, *how, options.bone_label, options.left), femur)
    z = _slice_place(options, surface)
    found = fit(
        surface, z, femur=femur, bone=under, tolerance=options.tolerance, slab=options.slab
    )
    origin = _origin(found, options.origin, mesh)
    contents = (
        _csv(found, mesh.name, found.smoothed.points - origin).encode(),
        picture(found, mesh.name),
        _parameter_file(found, outputs[0]).encode(),
    )
    write_complete(dict(zip(outputs, contents, strict=True)))
    rows = _report(found, mesh.name, origin)
    rows += zip(("CSV", "picture", "parameters"), map(str, outputs), strict=True)
    return [f"{label:<{LABEL_WIDTH - 1}} {text}" for label, text in rows]


def _slice_place(options: ProfileOptions, surface: Surface) -> float:
    """Return the place z of the slice [m]."""
    if options.slice == "auto":
        return contact_centre(surface, options.femur, options.medial)
    place = _metres(options.slice)
    if len(place) != 1 or not abs(place[0]) < 1.0:
        raise UsageError(
            f"--slice {options.slice}: it must be a place in mm along the medio-lateral axis z, or auto"
        )
    return place[0]


def _origin(found: ProfileFit, text: str | None, mesh: Path) -> Floats:
    """Return the origin of the profile in the mesh's axes [m], shape (2,).

    An origin outside the knee is refused, such as a mesh's origin at the hip or in the scanner: a femur rotates about
    its origin, and would leave the plateau.
    """
    points = found.shape.points
    x, y = points.T
    text = text or ("mesh" if found.femur else "surface")
    if text == "mesh":
        origin = [0.0, 0.0]
    elif text == "surface" and not found.femur:
        origin = [0.0, float(np.interp(0.0, x, y, left=math.nan, right=math.nan))]
    else:
        origin = _metres(text)
    if len(origin) != 2 or not np.isfinite(origin).all():
        over = "" if found.femur else ", or surface if the plateau reaches over x = 0"
        raise UsageError(
            f"--origin {text}: it must be mesh or X,Y in mm{over}; "
            f"this is x = {MM * x.min():.1f} to {MM * x.max():.1f} mm"
        )
    if found.femur:
        begin, end = np.radians(GAIT_NORMALS)
        middle = circle(points[(found.shape.normal >= begin) & (found.shape.normal <= end)])[0]
        what = "the distance of the condyle's middle"
        distance = math.dist(middle, origin)
        text = ",".join(f"{round(MM * each, 1) + 0.0:.1f}" for each in middle)
        cure = (
            "a femur turns about it: give the joint's axis in the mesh by --origin=X,Y, or this condyle's middle: "
            f"--origin={text}"
        )
    else:
        what = "the distance of the plateau"
        distance = float(np.hypot(*(points - origin).T).min())
        cure = "give surface or X,Y in mm"
    where = f"{mesh}, --origin {','.join(f'{MM * each:g}' for each in origin)}"
    limits = (0.0, _LARGEST_DISTANCES[found.femur])
    refuse_outside(where, what, MM * distance, "mm", limits, cure)
    return np.array(origin)


def _metres(text: str) -> list[float]:
    """Return lengths [m] from comma-separated numbers in mm; NaN if one is not a number."""
    try:
        return [float(number) * 1e-3 for number in text.split(",")]
    except ValueError:
        return [math.nan]


def _report(found: ProfileFit, name: str, origin: Floats) -> list[tuple[str, str]]:
    """Return labels and texts of the report; `name` is the mesh's, `origin` the profile's origin [m], shape (2,)."""
    smoothed = found.smoothed
    place = f"slice at z = {MM * found.z:g} mm, {len(smoothed.points)} points"
    rows = [
        ("profile", f"{_side(found)} of {name}, {place}"),
        ("origin", f"x = {MM * origin[0]:.5f}, y = {MM * origin[1]:.5f} mm of the mesh"),
        ("tolerance", _tolerance(found)),
        ("deviation", f"{_distance(found)}, of the {len(smoothed.raw)} points of the slice"),
        ("curvature", _curvature(found)),
    ]
    for each in found.circles:
        low, high = each.window
        window = f"x = {low:.1f} to {high:.1f} mm"
        if found.femur:
            window = f"normals of {low:.0f}° to {high:.0f}°"
        rows.append(("circle", f"radius {MM * each.radius:.2f} mm over {window}"))
    if found.thickness is not None:
        along = MM * found.thickness.along
        mean = found.thickness.mean
        zone = "normals of -15° to 70°" if found.femur else "the middle half of the width"
        text = (
            f"{MM * mean:.2f} mm on average where gait touches ({zone}); {along.mean():.2f} mm over the "
            f"whole profile, {along.max():.2f} mm at most"
        )
        for_file = (
            f"thickness: {mean:.6f}   (m, this cartilage alone: add the other bone's, for a subject file "
            "or -p contact.layer_depth:=...)"
        )
        rows += [("cartilage", text), ("cartilage", for_file)]
    return [*rows, *(("note", remark) for remark in found.remarks)]


def _curvature(found: ProfileFit) -> str:
    """Describe the curvature of the profile in a line."""
    shape = found.shape
    if not found.femur:
        hollow = [f"x = {MM * a:.1f} to {MM * b:.1f} mm" for a, b in concave(shape)]
        if hollow:
            return f"concave from {', '.join(hollow)}; convex elsewhere"
        return "convex everywhere"
    begin, end = sorted(np.degrees(shape.normal[[0, -1]]))
    low = float(shape.curvature.min())
    largest = f"{MM / low:.1f}" if low > 0.0 else "infinite"
    radii = f"radius {MM / float(shape.curvature.max()):.1f} to {largest} mm"
    return f"convex everywhere; {radii}; normals from {begin:.0f}° to {end:.0f}° (0° down, posterior positive)"


def _side(found: ProfileFit) -> str:
    return "femur" if found.femur else "tibia"


def _distance(found: ProfileFit) -> str:
    smoothed = found.smoothed
    return f"{MM * smoothed.rms:.3f} mm RMS, {MM * smoothed.largest:.3f} mm at most"


def _tolerance(found: ProfileFit) -> str:
    """Describe the tolerance, the roughness and the resulting deviation in a line."""
    rough = found.smoothed.roughness
    allowed = MM * math.hypot(rough, found.tolerance)
    where = f"slab of ±{MM * found.slab:g} mm" if found.slab else "slice"
    return (
        f"smoothing moved the {where} by {MM * found.smoothed.deviation:.3f} mm (RMS); {allowed:.3f} are allowed: "
        f"the mesh's roughness of {MM * rough:.3f} mm, and --tolerance"
    )


def _csv(found: ProfileFit, name: str, points: Floats) -> str:
    """Write a profile as CSV text for `femur.profile` or `tibia.profile`; `points`, shape (n, 2) [m], are its own."""
    header = [
        f"{_side(found).capitalize()} profile, sagittal slice at z = {MM * found.z:g} mm, from posterior to anterior.",
        f"Made by knee-contact fit-profile from {name}.",
        f"Smoothed: {_tolerance(found)}.",
        f"Slice to profile: {_distance(found)}.",
        "x anterior, y superior [m].",
    ]
    comments = [f"# {' '.join(line.split())}" for line in header]
    rows = [f"{x:.8f},{y:.8f}" for x, y in points]
    return "\n".join([*comments, "x,y", *rows, ""])


def _parameter_file(found: ProfileFit, profile: Path) -> str:
    """Write a parameter file as YAML text that sets the profile and nothing else."""
    side, quoted = _side(found), str(profile.resolve()).replace("'", "''")
    hint = "give this file after healthy.yaml; osteoarthritis.yaml may come before or after it."
    values = (f"{side}:", "  geometry: profile", f"  profile: '{quoted}'")
    return parameter_text(Parameters, [f"The {side} of {profile.name}: {hint}"], values)


def picture(found: ProfileFit, name: str) -> bytes:
    """Draw slice and profile, and below them curvature, deviations and thickness, as PNG; `name` is the mesh's."""
    heights = [2.5, 1.0, 1.0, *([1.0] if found.thickness else [])]
    style = CURVES_STYLE | {"font.size": 9.5}
    file = io.BytesIO()
    with saved_figure({"png": file}, _PICTURE_SIZE, _DOTS_PER_INCH, **style) as canvas:
        whole, *rows = canvas.subplots(len(heights), 1, height_ratios=heights)
        _draw_slice(whole, found)
        _draw_rows(rows, found)
        title = f"{_side(found).capitalize()} of {name}, z = {MM * found.z:g} mm: x anterior, y superior [mm]"
        whole.set_title(title.replace("$", r"\$"))
        canvas.align_ylabels()
        canvas.legend(loc="outside lower center", ncols=3)
    return file.getvalue()


def _draw_slice(axis: Any, found: ProfileFit) -> None:
    """Draw the slice, the profile with its circles, and the bone."""
    for number, piece in enumerate(MM * found.thickness.bone if found.thickness else ()):
        label = None if number else "bone"
        axis.plot(*piece.T, color=_BONE_COLOUR, linewidth=1.2, label=label)
    raw = (MM * found.smoothed.raw).T
    axis.plot(*raw, "o", color="0.6", markersize=3.0, label="slice of the mesh")
    points = (MM * found.shape.points).T
    axis.plot(*points, color=_PROFILE_COLOUR, linewidth=1.6, label="profile")
    for each, colour in zip(found.circles, _CIRCLE_COLOURS, strict=False):
        label = f"circle of radius {MM * each.radius:.1f} mm"
        axis.plot(*(MM * each.part).T, color=colour, label=label)
    axis.set_aspect("equal", adjustable="datalim")


def _draw_rows(rows: list[Any], found: ProfileFit) -> None:
    """Draw the curvature, the deviations and the thickness over the normal or over x."""
    from scipy.spatial import cKDTree

    smoothed, shape, thickness = found.smoothed, found.shape, found.thickness
    along = np.degrees(shape.normal) if found.femur else MM * shape.points[:, 0]
    for number, (each, colour) in enumerate(zip(found.circles, _CIRCLE_COLOURS, strict=False)):
        level = (1.0 / (MM * each.radius),) * 2
        # Circles may lie on each other, so later ones are thinner.
        rows[0].plot(each.window, level, color=colour, linewidth=4.5 - number)
    rows[0].plot(along, shape.curvature / MM, color=_PROFILE_COLOUR, linewidth=1.5)
    nearest = along[cKDTree(shape.points).query(smoothed.raw)[1]]
    rows[1].plot(nearest, MM * smoothed.deviations, ".", color="0.3", markersize=3.5)
    most = f"{MM * smoothed.rms:.3f} mm RMS, {MM * smoothed.largest:.2f} mm at most"
    hollow = "" if found.femur else ", concave positive"
    titles = [
        f"curvature of the profile and of the circles{hollow}",
        f"slice outside of the profile: {most}",
    ]
    if thickness:
        rows[2].plot(along, MM * thickness.along, color=_BONE_COLOUR, linewidth=1.5)
        titles.append(f"cartilage: {MM * thickness.mean:.2f} mm on average where gait touches")
    for row, unit, title in zip(rows, ("[1/mm]", "[mm]", "[mm]"), titles, strict=False):
        row.sharex(rows[0])
        row.axhline(0.0, color="0.5", linewidth=0.8)
        row.set(ylabel=unit, title=title)
    rows[-1].set_xlabel(
        "outward normal: 0 down, posterior positive [°]" if found.femur else "x, anterior [mm]"
    )
