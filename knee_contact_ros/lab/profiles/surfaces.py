"""Surface from a file, in m and in the axes of the femur or tibia frame.

Read surfaces: meshes by Trimesh or VTK, clouds of points as text, label maps (NIfTI) by nibabel.

Find the slice through the contact centre of a compartment from the surface alone.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require

Integers = NDArray[np.int64]
UNITS = {"m": 1.0, "mm": 1e-3}
SMALLEST, LARGEST = 0.008, 0.7
"""Range of the longest edge of the box around a cartilage or bone of the knee [m], generously"""
LETTERS = "xyz"


class Axes(NamedTuple):
    """Axes of a file that point anterior, superior and lateral."""

    places: tuple[int, ...]
    """Index of the file's axis for each"""
    signs: tuple[float, ...]
    """Sign of the file's axis for each, 1 or -1"""

    def turned(self, points: Floats) -> Floats:
        """Points of the file, shape (n, 3), in the order anterior, superior, lateral."""
        return np.ascontiguousarray(points[:, self.places] * np.array(self.signs))


class Surface(NamedTuple):
    """Mesh, or a cloud of points if there are no triangles."""

    path: Path
    points: Floats
    """Points, shape (n, 3) [m]: x anterior, y superior, z lateral"""
    triangles: Integers
    """Indices in `points` of each triangle's corners, shape (m, 3); m = 0 for a cloud"""

    @property
    def lateral_range(self) -> str:
        """Text of the surface's extent along z [mm]."""
        low, high = 1e3 * self.points[:, 2].min(), 1e3 * self.points[:, 2].max()
        return f"z = {low:.1f} to {high:.1f} mm"


def parse_axes(text: str) -> Axes:
    """Parse the file's axes that point anterior, superior and lateral, as in `x,y,z` or `-y,z,x`.

    Raises:
        UsageError: these are not three different axes.
    """
    names = [name.strip().lower() for name in text.split(",")]
    letters = [name.lstrip("+-") for name in names]
    if sorted(letters) != list(LETTERS) or any(len(name) > 2 for name in names):
        raise UsageError(
            f"--axes {text}: it must name the file's axes that point anterior, superior and lateral, "
            "each of x, y and z once, as x,y,z or --axes=-y,z,x"
        )
    return Axes(
        tuple(LETTERS.index(letter) for letter in letters),
        tuple(-1.0 if name.startswith("-") else 1.0 for name in names),
    )


def placed(path: Path, points: Floats, triangles: Integers, unit: str, axes: Axes) -> Surface:
    """Make a surface from points and triangles in the unit and axes of a file.

    Raises:
        UsageError: a number is not finite, or the size is not that of a knee, as with a wrong unit.
    """
    if not np.isfinite(points).all():
        raise UsageError(f"{path} has a point that is not finite")
    largest = float(np.ptp(points, axis=0).max())
    size = largest * UNITS[unit]
    if not SMALLEST <= size <= LARGEST:
        wanted = f"cartilages and bones of a knee measure {SMALLEST:g} to {LARGEST:g} m"
        raise UsageError(f"{path} measures {size:.3g} m with --unit {unit}; {wanted}{likely(largest)}")
    return Surface(path, axes.turned(points * UNITS[unit]), triangles)


def likely(largest: float) -> str:
    """Hint at the unit that a file with a longest edge of so many units may be in; empty if there is none."""
    for name, factor in UNITS.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}, --unit {name}"
    if largest <= 0.0 or not math.isfinite(largest):
        return ""
    for name, factor in {"cm": 1e-2, "µm": 1e-6, "km or was divided by 1000 twice": 1e3}.items():
        if SMALLEST <= largest * factor <= LARGEST:
            return f": likely it is in {name}; scale it to m or mm first"
    return ""


LABEL_MAPS = (".nii", ".nii.gz")
CLOUDS = (".txt", ".xyz", ".csv", ".asc", ".dat")
INSIDE = 0.5
MOST_SHOWN = 12
"""Largest number of labels that a message lists"""
EXTRA = "mesh"
BODY_AXES, SCANNER_AXES = "x,y,z", "y,z,x"
"""Axes of a mesh in a body's frame, and of a right knee in a scanner's axes (x right, y anterior, z superior)"""


def read_surface(path: Path, unit: str | None = None, axes: str | None = None, label: int | None = None) -> Surface:
    """Read a mesh, a cloud of points or a label of a label map.

    Args:
        path: the file; its suffix tells its kind.
        unit: unit of the file, by default m, for label maps mm.
        axes: the file's axes as `parse_axes` takes them, by default x,y,z, for label maps y,z,x.
        label: which label of a label map; None if it has only one.

    Raises:
        UsageError: there is no such file, its kind is unknown, it cannot be read, it has no surface, or its size is
            not that of a knee.
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
    """Read points [the file's unit] and triangles of a mesh; coincident points are merged."""
    with silenced():
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
    """Read STL, PLY and OBJ with Trimesh, as VTK's reader of PLY ends the process on a truncated file."""
    import trimesh

    read: Any = trimesh.load(path, process=False, skip_materials=True)
    if isinstance(read, trimesh.PointCloud):
        return read.vertices, ()
    mesh = read.to_mesh() if isinstance(read, trimesh.Scene) else read
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh.vertices, mesh.faces


def by_vtk(path: Path) -> tuple[Any, Any]:
    """Read VTP with VTK, as no other library reads it."""
    import pyvista

    read: Any = pyvista.read(path)
    mesh = read.triangulate().clean()
    has_faces = bool(mesh.n_cells and mesh.faces.size)
    return (mesh.points, mesh.regular_faces) if has_faces else (read.points, ())


def read_cloud(path: Path) -> tuple[Floats, Integers]:
    """Read points of a text file with columns x y z, or x y of a single slice, separated by blanks or commas.

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


def read_label_map(path: Path, label: int | None) -> tuple[Floats, Integers]:
    """Read the points [the file's unit, scanner axes] and triangles around the voxels of a label.

    Raises:
        UsageError: the file cannot be read, is not three-dimensional, or has no such label.
    """
    import nibabel
    import pyvista

    try:
        image: Any = nibabel.load(path)
        values = np.asarray(image.dataobj)
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    values = values.reshape(values.shape[:3]) if values.ndim > 3 and set(values.shape[3:]) == {1} else values
    if values.ndim != 3:
        raise UsageError(f"{path} has {values.ndim} dimensions; a label map has 3")
    mask = chosen(path, values, label)
    padded = np.pad(mask, 1).astype(np.float32)  # a label at the edge of the image is closed there
    grid = pyvista.ImageData(dimensions=padded.shape, origin=(-1.0, -1.0, -1.0))
    grid.point_data["inside"] = padded.ravel(order="F")
    mesh = grid.contour([INSIDE], scalars="inside").triangulate()
    voxels = np.asarray(mesh.points, np.float64)
    affine = np.asarray(image.affine, np.float64)
    return voxels @ affine[:3, :3].T + affine[:3, 3], np.asarray(mesh.regular_faces, np.int64)


def chosen(path: Path, values: Any, label: int | None) -> Any:
    """Mark the voxels of a label, of the only one if `label` is None; an array of truth values."""
    labels = [float(value) for value in np.unique(values) if value != 0]
    shown = ", ".join(f"{value:g}" for value in labels[:MOST_SHOWN]) + (", ..." if len(labels) > MOST_SHOWN else "")
    if label is None and len(labels) != 1:
        raise UsageError(f"{path} needs --label N: it has the labels {shown or '(none but 0)'}")
    wanted = labels[0] if label is None else float(label)
    mask = values == wanted
    if wanted == 0.0 or not mask.any():
        raise UsageError(f"--label {wanted:g}: {path} has the labels {shown or '(none but 0)'}")
    return mask


def is_numbers(row: list[str]) -> bool:
    """Whether all words of a row are numbers."""
    try:
        [float(word) for word in row]
    except ValueError:
        return False
    return True


MESHES = {".stl": by_trimesh, ".ply": by_trimesh, ".obj": by_trimesh, ".vtp": by_vtk}
"""Reader of meshes by the suffix of their files"""


@contextmanager
def silenced() -> Iterator[None]:
    """Silence VTK and loggers, which describe what is wrong with a file in many lines on the terminal."""
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
    """Check that the libraries of the extra are installed.

    Raises:
        UsageError: a library is missing.
    """
    require(EXTRA, "pyvista", "trimesh", "nibabel", "matplotlib")


FLEXION = np.radians(np.linspace(0.0, 60.0, 25))
"""Flexion angles [rad] of gait"""
NEAR = 0.2e-3
"""Height [m] above the lowest point within which points count as lowest, as noise moves single points"""
STEPWISE = 1e-4
"""Step [m] to which the place is rounded"""


def contact_centre(surface: Surface, femur: bool, medial: bool) -> float:
    """Find the place z [m] of the slice; medial is z < 0.

    Femur: where its lowest points lie on average while it flexes from 0° to 60°. Tibia: the middle of the plateau, each
    triangle counting with its area seen from above.

    Raises:
        UsageError: the surface has nothing on that side, or is a cloud of points.
    """
    if not len(surface.triangles):
        raise UsageError(f"--slice auto needs a mesh; {surface.path} is a cloud of points: give the slice in mm")
    side = surface.points[:, 2] < 0.0 if medial else surface.points[:, 2] > 0.0
    if np.count_nonzero(side) < 10:
        name, where = ("medial", "z < 0") if medial else ("lateral", "z > 0")
        raise UsageError(
            f"--slice auto: {surface.path} has nothing on the {name} side, {where}; it reaches from "
            f"{surface.lateral_range} (see --compartment and --axes)"
        )
    z = of_femur(surface.points[side]) if femur else of_tibia(surface, side)
    return float(np.round(z / STEPWISE) * STEPWISE)


def of_femur(points: Floats) -> float:
    """Mean z [m] of a femur's lowest points over the flexion angles of gait."""
    places = []
    for angle in FLEXION:
        height = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
        places.append(points[height <= height.min() + NEAR, 2].mean())
    return float(np.mean(places))


def of_tibia(surface: Surface, side: Any) -> float:
    """Mean z [m] of a tibia's area seen from above; `side` marks the points of the compartment."""
    triangles = surface.triangles[side[surface.triangles].all(axis=1)]
    corners = surface.points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.average(corners[:, :, 2].mean(axis=1), weights=np.abs(normal[:, 1]) + 1e-30))
