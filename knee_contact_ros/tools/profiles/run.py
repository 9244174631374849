"""The work of `knee-contact fit-profile`: read, cut, smooth, measure, write."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name
from knee_contact_ros.tools.profiles.automatic import contact_centre
from knee_contact_ros.tools.profiles.fit import SLAB, TOLERANCE, Fit, fit
from knee_contact_ros.tools.profiles.read_surface import need_libraries, read_surface
from knee_contact_ros.tools.profiles.surface import Surface

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
    z = place_of(options, surface)
    found = fit(surface, z, femur=options.femur, bone=bone, tolerance=options.tolerance, slab=options.slab)
    origin = origin_of(found, options.origin)

    from knee_contact_ros.tools.profiles import words  # after what may be refused
    from knee_contact_ros.tools.profiles.picture import picture

    name = options.mesh.name
    profile = words.csv(found, name, found.smoothed.points - origin).encode()
    contents = (profile, picture(found, name), words.fragment(found, outputs[0]).encode())
    write(dict(zip(outputs, contents, strict=True)))
    files = zip(("CSV", "picture", "parameters"), outputs, strict=True)
    return [*words.report(found, name, origin), *[f"{label:<10} {path}" for label, path in files]]


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


def place_of(options: FitOptions, surface: Surface) -> float:
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
