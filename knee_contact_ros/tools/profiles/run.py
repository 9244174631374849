"""The work of `knee-contact fit-profile`: read, cut, smooth, measure, write."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name
from knee_contact_ros.tools.profiles.automatic import contact_centre
from knee_contact_ros.tools.profiles.fit import SLAB, TOLERANCE, fit
from knee_contact_ros.tools.profiles.frame import origin_of
from knee_contact_ros.tools.profiles.read_surface import need_libraries, read_surface
from knee_contact_ros.tools.profiles.surface import Surface

AUTO = "auto"
LABEL = 11
"""Columns that the label of a line takes, with the space behind it"""


class FitOptions(NamedTuple):
    """What the command line says."""

    mesh: Path
    slice: str
    """In mm, or `auto`"""
    output: Path
    bone: Path | None = None
    femur: bool = True
    medial: bool = True
    unit: str | None = None
    axes: str | None = None
    label: int | None = None
    bone_label: int | None = None
    tolerance: float = TOLERANCE
    """[m]"""
    slab: float = SLAB
    """[m]"""
    origin: str | None = None
    overwrite: bool = False


def run_fit_profile(asked: FitOptions) -> list[str]:
    """Fit a profile and write CSV, picture and parameter file; give the lines that tell of it.

    Raises:
        UsageError: the surface, an option or an output cannot be used.
    """
    need_libraries()
    outputs = [asked.output.with_suffix(suffix) for suffix in (".csv", ".png", ".yaml")]
    refuse(asked, outputs)
    surface = read_surface(asked.mesh, asked.unit, asked.axes, asked.label)
    bone = read_surface(asked.bone, asked.unit, asked.axes, asked.bone_label) if asked.bone else None
    z = place_of(asked, surface)
    found = fit(surface, z, femur=asked.femur, bone=bone, tolerance=asked.tolerance, slab=asked.slab)
    origin = origin_of(found, asked.origin)

    from knee_contact_ros.tools.profiles import words  # after what may be refused
    from knee_contact_ros.tools.profiles.picture import picture

    name = asked.mesh.name
    profile = words.csv(found, name, found.smoothed.points - origin).encode()
    contents = (profile, picture(found, name), words.fragment(found, outputs[0]).encode())
    write(dict(zip(outputs, contents, strict=True)))
    files = zip(("CSV", "picture", "parameters"), outputs, strict=True)
    return [*words.report(found, name, origin), *[f"{label:<10} {path}" for label, path in files]]


def refuse(asked: FitOptions, outputs: list[Path]) -> None:
    """Refuse outputs that are taken or of another kind, before any work.

    Raises:
        UsageError: that is so.
    """
    if asked.output.suffix.lower() != ".csv":
        raise UsageError(f"--output {asked.output}: its name must end with .csv")
    inputs = {path.resolve() for path in (asked.mesh, asked.bone) if path}
    for path in outputs:
        if path.resolve() in inputs:
            raise UsageError(f"--output {asked.output}: it would replace the input {path}")
        if path.is_dir() or (path.exists() and not asked.overwrite):
            raise UsageError(f"{path} exists already; choose another name, or --overwrite")


def place_of(asked: FitOptions, surface: Surface) -> float:
    """The slice's place z [m].

    Raises:
        UsageError: not a number, or nothing to find it from.
    """
    if asked.slice == AUTO:
        return contact_centre(surface, asked.femur, asked.medial)
    try:
        z = float(asked.slice) * 1e-3
    except ValueError:
        z = float("nan")
    if not abs(z) < 1.0:
        raise UsageError(f"--slice {asked.slice}: it must be a place in mm along the medio-lateral axis z, or auto")
    return z


def write(contents: dict[Path, bytes]) -> None:
    """Write files that appear under their names when all are complete.

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
