"""A file's surface: meshes by Trimesh or VTK, clouds of points as text, label maps by nibabel."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from knee_contact_ros.core.arrays import Floats, Integers
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.tools.profiles.label_map import LABEL_MAPS, read_label_map
from knee_contact_ros.tools.profiles.surface import Surface, parse_axes, placed

CLOUDS = (".txt", ".xyz", ".csv", ".asc", ".dat")
EXTRA = "mesh"
BODY_AXES, SCANNER_AXES = "x,y,z", "y,z,x"
"""Of a mesh in the axes of a body, and of a right knee in a scanner's axes (x right, y anterior, z superior)"""


def read_surface(path: Path, unit: str | None = None, axes: str | None = None, label: int | None = None) -> Surface:
    """Read a mesh, a cloud of points or one label of a label map.

    `unit` is m unless given (label maps: mm); `axes` are those of `parse_axes`, x,y,z unless given (label maps: y,z,x,
    a right knee in the scanner's axes).

    Raises:
        UsageError: no such file, none of these kinds, not readable, without a surface, or of no knee's size.
    """
    if not path.is_file():
        raise UsageError(f"{path} is a folder" if path.is_dir() else f"{path}: there is no such file")
    kind = "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if kind in LABEL_MAPS:
        points, triangles = read_label_map(path, label)
        return placed(path, points, triangles, unit or "mm", parse_axes(axes or SCANNER_AXES))
    if label is not None:
        raise UsageError(f"--label {label}: {path} is no label map; those end with {' or '.join(LABEL_MAPS)}")
    if kind in CLOUDS:
        points, triangles = read_cloud(path)
    elif kind in MESHES:
        points, triangles = read_mesh(path, kind)
    else:
        known = ", ".join((*MESHES, *CLOUDS, *LABEL_MAPS))
        raise UsageError(f"{path}: a mesh, cloud of points or label map must end with one of {known}")
    return placed(path, points, triangles, unit or "m", parse_axes(axes or BODY_AXES))


def read_mesh(path: Path, kind: str) -> tuple[Floats, Integers]:
    """Points and triangles of a mesh; points of equal place are one."""
    with quiet():
        try:
            points, triangles = MESHES[kind](path)
        except Exception as error:  # the libraries raise what they like
            raise UsageError(f"{path} cannot be read as a {kind} file: {' '.join(str(error).split())[:200]}") from None
    if not len(points):
        raise UsageError(f"{path} cannot be read as a {kind} file, or has no faces")
    if not len(triangles):
        raise UsageError(f"{path} has {len(points)} points but no faces; a cloud of points must be a text file x y z")
    return np.asarray(points, np.float64), np.asarray(triangles, np.int64)


def by_trimesh(path: Path) -> tuple[Any, Any]:
    """STL, PLY and OBJ: VTK's reader of PLY ends the process on a file that is cut off."""
    import trimesh

    read: Any = trimesh.load(path, process=False, skip_materials=True)
    if isinstance(read, trimesh.PointCloud):
        return read.vertices, ()
    mesh = read.to_mesh() if isinstance(read, trimesh.Scene) else read
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh.vertices, mesh.faces


def by_vtk(path: Path) -> tuple[Any, Any]:
    """VTP, which no other library reads."""
    import pyvista

    read: Any = pyvista.read(path)
    mesh = read.triangulate().clean()
    has_faces = bool(mesh.n_cells and mesh.faces.size)
    return (mesh.points, mesh.regular_faces) if has_faces else (read.points, ())


def read_cloud(path: Path) -> tuple[Floats, Integers]:
    """Points of a text file with columns x y z, or x y of one slice, apart by blanks or commas.

    The first line may name the columns; what follows # is a comment.
    """
    try:
        lines = [line.split("#")[0].replace(",", " ").split() for line in path.read_text("utf-8-sig").splitlines()]
    except UnicodeDecodeError:
        raise UsageError(f"{path} cannot be read: it is not a text file in UTF-8") from None
    rows = [line for line in lines if line]
    if rows and not is_numbers(rows[0]):
        del rows[0]
    widths = {len(row) for row in rows}
    wrong = next((row for row in rows if not is_numbers(row)), None)
    if not rows or wrong or not widths <= {2, 3} or len(widths) > 1:
        problem = f"it has a line {' '.join(wrong)[:60]!r}" if wrong else f"it has {sorted(widths)} columns"
        raise UsageError(f"{path} must hold numbers in two columns x, y or three x, y, z; {problem}")
    points = np.array(rows, dtype=np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return points, np.empty((0, 3), np.int64)


def is_numbers(row: list[str]) -> bool:
    """Whether all words are numbers."""
    try:
        [float(word) for word in row]
    except ValueError:
        return False
    return True


MESHES = {".stl": by_trimesh, ".ply": by_trimesh, ".obj": by_trimesh, ".vtp": by_vtk}
"""By what meshes are read"""


@contextmanager
def quiet() -> Iterator[None]:
    """VTK says what is wrong with a file in many lines on the terminal; we say it in one."""
    import pyvista

    before, level = pyvista.vtk_verbosity(None), logging.root.manager.disable
    pyvista.vtk_verbosity("off")
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)
        pyvista.vtk_verbosity(before)


def need_libraries() -> None:
    """Refuse to begin without the extra.

    Raises:
        UsageError: a library is missing.
    """
    for needed in ("pyvista", "trimesh", "nibabel", "matplotlib"):
        if find_spec(needed) is None:
            raise UsageError(not_installed(needed, EXTRA))
