"""The work of `knee-contact fit-profile`: read, cut, smooth, measure, write.

Texts on a fit: the report on the terminal, the profile's CSV file and the parameter file.

Picture of a fit: slice and profile, circles, curvature, deviations and thickness of cartilage.
"""

from __future__ import annotations

import io
import math
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab.profiles.fit import SLAB, TOLERANCE, Fit, FittedCircle, concave, dented, fit
from knee_contact_ros.lab.profiles.surfaces import Surface, contact_centre, need_libraries, read_surface
from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name

AUTO, MESH, SURFACE = "auto", "mesh", "surface"
LABEL = 11
"""Width of the label of a line on the terminal, with the space behind it"""


class FitOptions(NamedTuple):
    """Options of the command `fit-profile`."""

    mesh: Path
    """Surface of the cartilage: a mesh, a cloud of points or a label map"""
    slice: str
    """Place of the slice along z [mm], or `auto`"""
    output: Path
    """The CSV file; picture and parameter file have its name with other suffixes"""
    bone: Path | None = None
    """Surface of the bone under the cartilage; None: the thickness is not measured"""
    femur: bool = True
    """Whether the surface is a femur's, and not a tibia's"""
    medial: bool = True
    """Whether `auto` looks for the medial compartment, and not the lateral one"""
    unit: str | None = None
    """Unit of the files; None: their kind's default"""
    axes: str | None = None
    """Axes of the files; None: their kind's default"""
    label: int | None = None
    """Label of the cartilage in a label map"""
    bone_label: int | None = None
    """Label of the bone in a label map"""
    tolerance: float = TOLERANCE
    """RMS distance from the slice that smoothing may add [m]"""
    slab: float = SLAB
    """Half thickness of the slab [m]"""
    origin: str | None = None
    """Origin of the profile, as `origin_of` takes it"""
    overwrite: bool = False
    """Whether existing output files are replaced"""


def run_fit_profile(options: FitOptions) -> list[str]:
    """Fit a profile and write CSV, picture and parameter file; return the lines of the report.

    Raises:
        UsageError: the surface, an option or an output cannot be used.
    """
    need_libraries()
    outputs = [options.output.with_suffix(suffix) for suffix in (".csv", ".png", ".yaml")]
    refuse(options, outputs)
    surface = read_surface(options.mesh, options.unit, options.axes, options.label)
    bone = read_surface(options.bone, options.unit, options.axes, options.bone_label) if options.bone else None
    z = slice_place(options, surface)
    found = fit(surface, z, femur=options.femur, bone=bone, tolerance=options.tolerance, slab=options.slab)
    origin = origin_of(found, options.origin)

    name = options.mesh.name
    profile = csv(found, name, found.smoothed.points - origin).encode()
    contents = (profile, picture(found, name), fragment(found, outputs[0]).encode())
    write(dict(zip(outputs, contents, strict=True)))
    files = zip(("CSV", "picture", "parameters"), outputs, strict=True)
    return [*report(found, name, origin), *[f"{label:<10} {path}" for label, path in files]]


def refuse(options: FitOptions, outputs: list[Path]) -> None:
    """Check before any work that the output files can be written.

    Raises:
        UsageError: the output is no CSV file, would replace an input, or exists already.
    """
    if options.output.suffix.lower() != ".csv":
        raise UsageError(f"--output {options.output}: its name must end with .csv")
    inputs = {path.resolve() for path in (options.mesh, options.bone) if path}
    for path in outputs:
        if path.resolve() in inputs:
            raise UsageError(f"--output {options.output}: it would replace the input {path}")
        if path.is_dir() or (path.exists() and not options.overwrite):
            raise UsageError(f"{path} exists already; choose another name, or --overwrite")


def slice_place(options: FitOptions, surface: Surface) -> float:
    """Place z of the slice [m].

    Raises:
        UsageError: it is not a number, or cannot be found from the surface.
    """
    if options.slice == AUTO:
        return contact_centre(surface, options.femur, options.medial)
    try:
        z = float(options.slice) * 1e-3
    except ValueError:
        z = float("nan")
    if not abs(z) < 1.0:
        raise UsageError(f"--slice {options.slice}: it must be a place in mm along the medio-lateral axis z, or auto")
    return z


def origin_of(fit: Fit, text: str | None) -> Floats:
    """Origin of the profile in the mesh's axes [m], shape (2,).

    `mesh` is the mesh's own (default of a femur), `surface` the tibia's surface at the mesh's x = 0 (default of a
    tibia), `X,Y` a point in mm.

    Raises:
        UsageError: the text is none of these, or the tibia does not reach to x = 0.
    """
    text = text or (MESH if fit.femur else SURFACE)
    if text == MESH:
        return np.zeros(2)
    if text == SURFACE and not fit.femur:
        x, y = fit.shape.points.T
        if not x.min() <= 0.0 <= x.max():
            raise UsageError(
                f"--origin surface: the plateau reaches from x = {1e3 * x.min():.1f} to {1e3 * x.max():.1f} mm, "
                "not over x = 0; give --origin X,Y in mm"
            )
        return np.array([0.0, float(np.interp(0.0, x, y))])
    try:
        place = np.array([float(number) * 1e-3 for number in text.split(",")])
    except ValueError:
        place = np.empty(0)
    if place.shape != (2,) or not np.isfinite(place).all():
        allowed = "mesh or X,Y in mm" if fit.femur else "surface, mesh or X,Y in mm"
        raise UsageError(f"--origin {text}: it must be {allowed}")
    return place


def write(contents: dict[Path, bytes]) -> None:
    """Write files so that they appear under their names when all of them are complete.

    Raises:
        UsageError: the folder cannot be written.
    """
    try:
        for path, content in contents.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            partial_name(path).write_bytes(content)
        for path in contents:
            partial_name(path).replace(path)
    except OSError as error:
        raise UsageError(f"cannot write {next(iter(contents)).parent}: {error.strerror}") from None
    finally:
        for path in contents:
            with suppress(OSError):  # the folder may be what cannot be used
                partial_name(path).unlink()


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


PROFILE, RAW, BONE = "#0072B2", "0.6", "#B08968"
CIRCLES = ("#D55E00", "#009E73", "#CC79A7", "#E69F00")
LINE = 0.24
"""Height of a line of the legend with its share of the margins [in]"""
WIDTHS = (4.6, 3.5, 2.4, 1.4)
"""Line widths of circles in the plot of curvature, where they may lie on each other"""
FEMUR, TIBIA, DPI = (10.5, 6.4), (7.6, 8.6), 110
"""Size of a picture [in] and its resolution: a femur's slice is beside the plots along it, a tibia's above them"""
STYLE: Any = {"font.size": 9.5, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
              "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
              "legend.fontsize": 8.5}  # fmt: skip


def picture(fit: Fit, name: str) -> bytes:
    """Draw the picture of a fit, as PNG; `name` is the mesh's."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    panels = [draw_curvature, draw_circles, draw_deviations, *([draw_cartilage] if fit.thickness else [])]
    with mpl.rc_context(STYLE):
        canvas = Figure(figsize=FEMUR if fit.femur else TIBIA, layout="constrained")
        if fit.femur:
            grid = canvas.add_gridspec(len(panels), 2, width_ratios=(1.1, 1.0))
            whole, rows = canvas.add_subplot(grid[:, 0]), [grid[row, 1] for row in range(len(panels))]
        else:
            grid = canvas.add_gridspec(1 + len(panels), 1, height_ratios=(1.5, *[1.0] * len(panels)))
            whole, rows = canvas.add_subplot(grid[0]), [grid[row] for row in range(1, 1 + len(panels))]
        title = f"{side(fit).capitalize()} of {name}, z = {MM * fit.z:g} mm"
        draw_slice(whole, fit, title.replace("$", r"\$"))
        first = None
        for draw, row in zip(panels, rows, strict=True):
            axis = canvas.add_subplot(row, sharex=first)
            first = first or axis
            draw(axis, fit)
            axis.tick_params(labelbottom=row is rows[-1])
        axis.set_xlabel(along(fit)[1])
        if not fit.femur:
            axis.set_xlim(whole.get_xlim())
        canvas.align_ylabels()
        columns, entries = 3 if fit.femur else 2, 2 + len(fit.circles) + (fit.thickness is not None)
        below = LINE * -(-entries // columns) / canvas.get_size_inches()[1]
        canvas.legend(loc="lower center", ncols=columns)
        canvas.set_layout_engine("constrained", rect=(0.0, below, 1.0, 1.0 - below))
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def draw_slice(axis: Any, fit: Fit, title: str) -> None:
    """Draw the slice, the profile and the bone, and for a femur the sectors to which its circles are fitted."""
    if fit.thickness is not None:
        for number, piece in enumerate(MM * fit.thickness.bone):
            axis.plot(*piece.T, color=BONE, linewidth=1.2, label=None if number else "bone")
    axis.plot(*(MM * fit.smoothed.raw).T, "o", color=RAW, markersize=3.0, label="slice of the mesh")
    axis.plot(*(MM * fit.shape.points).T, color=PROFILE, linewidth=1.6, label="profile")
    for each, colour in zip(fit.circles if fit.femur else (), CIRCLES, strict=False):
        sector = MM * np.vstack([each.centre, arc_of(each), each.centre])
        axis.plot(*sector.T, color=colour, linewidth=1.0)
        axis.plot(*(MM * each.centre), "o", color=colour, markersize=4.0)
    axis.set_aspect("equal", adjustable="datalim" if fit.femur else "box")
    axis.margins(0.06)
    axis.set(xlabel="x, anterior [mm]" if fit.femur else "", ylabel="y, superior [mm]", title=title)


def label(fit: Fit, each: FittedCircle) -> str:
    """Window of a circle for the legend."""
    low, high = each.window
    return f"{low:.0f}° to {high:.0f}°" if fit.femur else f"x {low:.0f} to {high:.0f} mm"


def arc_of(each: FittedCircle) -> Floats:
    """Points of a circle's arc over the part to which it is fitted, shape (200, 2) [m]."""
    offset = each.part - each.centre
    middle = offset.mean(axis=0)
    base = np.arctan2(middle[1], middle[0])
    angles = (np.arctan2(offset[:, 1], offset[:, 0]) - base + np.pi) % (2.0 * np.pi) - np.pi
    turn = base + np.linspace(angles.min(), angles.max(), 200)
    return np.asarray(each.centre + abs(each.radius) * np.column_stack([np.cos(turn), np.sin(turn)]))


def along(fit: Fit) -> tuple[Floats, str]:
    """Horizontal coordinate of the plots along the profile, at the places of the shape, with its label."""
    if fit.femur:
        return np.degrees(fit.shape.normal), "outward normal: 0 down, posterior positive [°]"
    return MM * fit.shape.points[:, 0], "x, anterior [mm]"


def place_of(fit: Fit, points: Floats) -> Floats:
    """Horizontal coordinates of points, shape (n, 2) [m], in these plots: those of the nearest place of the shape."""
    from scipy.spatial import cKDTree

    return np.asarray(along(fit)[0][cKDTree(fit.shape.points).query(points)[1]])


def draw_curvature(axis: Any, fit: Fit) -> None:
    """Draw the curvature along the profile, and that of the circles."""
    axis.plot(along(fit)[0], fit.shape.curvature / MM, color=PROFILE, linewidth=1.5)
    for each, colour, width in zip(fit.circles, CIRCLES, WIDTHS, strict=False):
        axis.plot(each.window, (1.0 / (MM * each.radius),) * 2, color=colour, linewidth=width)
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    title = "curvature of the profile and of the circles"
    axis.set(ylabel="[1/mm]", title=title if fit.femur else f"{title}, concave positive")


def draw_circles(axis: Any, fit: Fit) -> None:
    """Draw the distance of the profile from each circle within its window; as arcs they would hide each other."""
    for each, colour in zip(fit.circles, CIRCLES, strict=False):
        outwards = 1.0 if fit.femur or each.radius < 0.0 else -1.0  # out of a concave tibia is towards the centre
        off = outwards * (np.hypot(*(each.part - each.centre).T) - abs(each.radius))
        axis.plot(place_of(fit, each.part), MM * off, color=colour, linewidth=1.5,
                  label=f"circle over {label(fit, each)}: radius {MM * each.radius:.1f} mm")  # fmt: skip
    axis.axhline(0.0, color="0.5", linewidth=0.8)
    axis.set(ylabel="[mm]", title="profile outside of each circle")


def draw_deviations(axis: Any, fit: Fit) -> None:
    """Draw the distance of the slice from the profile."""
    axis.plot(place_of(fit, fit.smoothed.raw), MM * fit.smoothed.deviations, ".", color="0.3", markersize=3.5)
    axis.axhline(0.0, color=PROFILE, linewidth=1.2)
    most = f"{MM * fit.smoothed.rms:.3f} mm RMS, {MM * fit.smoothed.largest:.2f} mm at most"
    axis.set(ylabel="[mm]", title=f"slice outside of the profile: {most}")


def draw_cartilage(axis: Any, fit: Fit) -> None:
    """Draw the thickness of the cartilage."""
    if fit.thickness is None:
        return
    axis.plot(along(fit)[0], MM * fit.thickness.along, color=BONE, linewidth=1.5)
    axis.set(ylabel="[mm]", title=f"cartilage: {MM * fit.thickness.mean:.2f} mm on average where gait touches")
    axis.set_ylim(bottom=0.0)
