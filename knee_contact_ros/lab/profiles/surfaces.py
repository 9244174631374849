"""Surfaces of cartilage and bone from files, in m and in the axes of the femur or tibia frame.

Trimesh or VTK reads meshes, and point clouds are text. A label map, or a mesh from 3D Slicer, says in its header which
way its axes point (`SPACE=RAS`); for other files the caller must know.
"""

import io
import logging
import math
import re
import warnings
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...model.types import MM, Floats, Integers
from ...system.errors import UsageError, list_names
from ...system.processes import written_by
from ..checks import refuse_outside
from ..units import UNIT_FACTORS
from . import vtk_file
from .label_maps import LABEL_MAPS, read_label_map

_MESH_UNITS = ("m", "mm", "cm")
_PLAUSIBLE_SIZES = (0.008, 0.7)
"""Generous range of the longest edge of the box around a cartilage or bone of the knee [m]"""
_KNEE, _WHOLE = 0.10, 0.15
"""Height [m] of what is used of a whole bone, at the knee; height from which a bone is one"""
_CLOUD_SUFFIXES = (".txt", ".xyz", ".csv", ".asc", ".dat")
_LARGEST_FILE = 128_000_000
"""Largest size of a file with a mesh or points [B]: 2.5 million triangles"""
_MOST_POINTS = 4_000_000
"""Largest number of points of a text: an optical scan of a knee has up to 3 million"""
_LONGEST_LINE = 1000
"""Largest number of characters of a line of that text; a longer one counts as several"""
_LARGEST_MAP = 600_000_000
"""Largest size of a label map's file [B]"""
_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""A triangle in binary STL"""
_MOST_FACES = 2_500_000
"""Largest number of faces between voxels of a label and others: ten times those of a bone at 0.4 mm. More would take
gigabytes"""
_MOST_LABELS = 1000
"""Largest number of different numbers in a label map: an image of grey values has more"""
_BODY_AXES = "x,y,z"
"""Axes of a mesh in a body's frame"""
_LEFT_BODY_AXES = "x,y,-z"
"""Those of a left knee, whose z points medially"""
_SPACE = re.compile(r"SPACE=([RL][AP][SI])\b")
"""What 3D Slicer writes into the header of a mesh: the sides to which its x, y and z point"""
_AXES_HINT = (
    "a right knee's are --axes=y,z,x in a scanner's RAS axes and --axes=-y,z,-x in LPS, a left one's have the "
    "other sign of x"
)


class Surface(NamedTuple):
    """Mesh, or a point cloud if there are no triangles."""

    path: Path
    points: Floats
    """Points, shape (n, 3) [m]: x anterior, y superior, z lateral"""
    triangles: Integers
    """Indices in `points` of each triangle's corners, shape (m, 3); m = 0 for a cloud"""
    axes: str = _BODY_AXES
    """The file's axes that point anterior, superior and lateral"""
    remarks: tuple[str, ...] = ()
    """How the axes were found, as sentences"""
    known: bool = False
    """Whether the axes follow from the file's header"""

    @property
    def axes_cure(self) -> str:
        """Advice for a slice that does not look like a condyle because the axes may be wrong."""
        return "see --slice" if self.known else f"see --axes and --slice; {_AXES_HINT}"

    @property
    def lateral_range(self) -> str:
        """Text of the surface's extent along z [mm]."""
        low, high = MM * self.points[:, 2].min(), MM * self.points[:, 2].max()
        return f"z = {low:.1f} to {high:.1f} mm"


def read_surface(
    path: Path,
    unit: str | None = None,
    axes: str | None = None,
    label: int | None = None,
    left: bool = False,
) -> Surface:
    """Read a mesh, a cloud of points or a label of a label map.

    Args:
        path: The file; its suffix gives its kind.
        unit: Unit of the file; default m, and mm for label maps and meshes from 3D Slicer.
        axes: The file's axes that point anterior, superior and lateral, as in `-y,z,x`. Default: those of the header
            if it says which way the axes point (label maps, meshes from 3D Slicer), else x,y,z with z to the right.
        label: Label of a label map; None if it has only one.
        left: Whether it is a left knee, which is mirrored to a right one unless `axes` are given.

    Raises:
        UsageError: the file is missing, of unknown kind, unreadable, without a surface or not of a knee's size, or
            `axes` contradict its header.
    """
    if not path.is_file():
        raise UsageError(
            f"{path} is a folder" if path.is_dir() else f"{path}: there is no such file"
        )
    kind = path.suffix.lower()
    if kind == ".gz":
        kind = "".join(path.suffixes[-2:]).lower()
    most = _LARGEST_MAP if kind in LABEL_MAPS else _LARGEST_FILE
    if path.stat().st_size > most:
        raise UsageError(
            f"{path} has {path.stat().st_size / 1e6:.0f} MB, and at most {most / 1e6:.0f} MB are read: crop it to the "
            "knee, or reduce its triangles"
        )
    if label is not None and kind not in LABEL_MAPS:
        raise UsageError(
            f"--label {label}: {path} is not a label map; label maps end with {' or '.join(LABEL_MAPS)}"
        )
    triangles = np.empty((0, 3), np.int64)
    usual = _LEFT_BODY_AXES if left else _BODY_AXES
    usual_unit = "m"
    remarks: tuple[str, ...] = ()
    if kind in LABEL_MAPS:
        points, triangles = _around_label(path, label, axes)
        usual = _axes_in("RAS", left)
        if axes is None:
            remarks = (_axes_remark(usual, "the header's orientation", left),)
        usual_unit = "mm"  # nibabel's
    elif kind in _CLOUD_SUFFIXES:
        points = _read_cloud(path)
    elif kind in _MESH_READERS:
        points, triangles, space = _read_mesh(path, kind)
        if space:
            usual = _axes_in(space, left)
            usual_unit = "mm"
            remarks = _space_remarks(path, space, axes, left)
    else:
        known = ", ".join((*_MESH_READERS, *_CLOUD_SUFFIXES, *LABEL_MAPS))
        raise UsageError(
            f"{path}: a mesh, cloud of points or label map must end with one of {known}"
        )
    places, signs = _axes(axes or usual)
    unit = unit or usual_unit
    _check_size(path, points, unit)
    turned = np.ascontiguousarray(points[:, places] * signs) * UNIT_FACTORS["length"][unit]
    known_axes = axes is None and usual not in {_BODY_AXES, _LEFT_BODY_AXES}
    return Surface(path, turned, triangles, axes or usual, remarks, known_axes)


def cropped(surface: Surface, femur: bool) -> Surface:
    """Return the part of a whole bone that is at the knee; another surface as it is."""
    height = surface.points[:, 1] if femur else -surface.points[:, 1]
    height = height - height.min()
    if height.max() <= _WHOLE:
        return surface
    near = height <= _KNEE
    remark = f"of a bone {MM * height.max():.0f} mm long, {MM * _KNEE:.0f} mm at the knee are used"
    return surface._replace(
        points=surface.points[near],
        triangles=(np.cumsum(near) - 1)[surface.triangles[near[surface.triangles].all(axis=1)]],
        remarks=(*surface.remarks, remark),
    )


def _axes_in(space: str, left: bool = False) -> str:
    """Return the axes of a right or left knee in a file whose x, y and z point to sides of the body, as in `RAS`."""
    names = dict(zip(space, "xyz", strict=True))
    wanted = {"A": "P", "S": "I"} | ({"L": "R"} if left else {"R": "L"})
    return ",".join(names.get(side, f"-{names.get(back)}") for side, back in wanted.items())


def _axes_remark(axes: str, source: str, left: bool) -> str:
    """Tell the axes that follow from a header, and what to do for the other leg."""
    side, other = ("left", "right") if left else ("right", "left")
    return f"axes {axes} follow from {source}, for a {side} knee; of a {other} one: --leg {other}"


def _space_remarks(path: Path, space: str, axes: str | None, is_left: bool) -> tuple[str, ...]:
    """Describe how the given axes relate to a header's space; refuse axes that contradict it."""
    right = _axes_in(space)
    left = _axes_in(space, left=True)
    if axes is None:
        usual = left if is_left else right
        return (_axes_remark(usual, f"SPACE={space} in the file's header", is_left),)
    cure = f"the header of {path.name} says SPACE={space}, where a right knee's are {right} and a left one's {left}"
    places, signs = _axes(axes)
    known_places, known_signs = _axes(right)
    for row, what in enumerate(("front and back", "up and down")):
        if places[row] == known_places[row] and signs[row] != known_signs[row]:
            raise UsageError(f"--axes={axes} exchanges {what}: {cure}")
    return () if places == known_places else (f"--axes={axes} is used, although {cure}",)


def _axes(text: str) -> tuple[list[int], list[float]]:
    """Return the columns of the file, and their signs, that point anterior, superior and lateral."""
    names = [name.strip().lower() for name in text.split(",")]
    letters = [name.lstrip("+-") for name in names]
    if sorted(letters) != ["x", "y", "z"] or any(len(name) > 2 for name in names):
        raise UsageError(
            f"--axes {text}: it must name the file's axes that point anterior, superior and lateral, "
            "each of x, y and z once, as x,y,z or --axes=-y,z,x"
        )
    signs = [-1.0 if name[0] == "-" else 1.0 for name in names]
    return ["xyz".index(letter) for letter in letters], signs


def _check_size(path: Path, points: Floats, unit: str) -> None:
    """Refuse points whose unit does not give the size of a knee, and name the unit that does."""
    if not np.isfinite(points).all():
        raise UsageError(f"{path} has a point that is not finite")
    largest = float(np.ptp(points, axis=0).max())
    sizes = {name: largest * UNIT_FACTORS["length"][name] for name in _MESH_UNITS}
    # A knee is 7 cm wide.
    likely = min(sizes, key=lambda name: abs(math.log(max(sizes[name], 1e-12) / 0.07)))
    fits = _PLAUSIBLE_SIZES[0] <= sizes[likely] <= _PLAUSIBLE_SIZES[1]
    cure = f"likely it is in {likely}, --unit {likely}" if fits else "scale it to m or mm first"
    what = f"its largest extent with --unit {unit}"
    refuse_outside(path, what, sizes[unit], "m", _PLAUSIBLE_SIZES, cure)


def _read_mesh(path: Path, kind: str) -> tuple[Floats, Integers, str]:
    """Read points [the file's unit], triangles and space of a mesh; coincident points are merged.

    The space is `RAS`, `LPS` and the like, as in `_SPACE`, or empty.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            points, triangles, space = _MESH_READERS[kind](path)
        with path.open("rb") as file:
            stated = _SPACE.search(file.read(1024).decode("latin-1"))
    except Exception as error:  # the libraries raise what they like
        raise UsageError(
            f"{path} cannot be read as a {kind} file: {' '.join(str(error).split())[:200]}"
        ) from None
    if not len(points):
        raise UsageError(f"{path} cannot be read as a {kind} file, or has no faces")
    if not len(triangles):
        raise UsageError(
            f"{path} has {len(points)} points but no faces; a cloud of points must be a text file x y z"
        )
    if stated and not space:
        space = stated[1]
    return np.asarray(points, np.float64), np.asarray(triangles, np.int64), space


def _by_trimesh(path: Path) -> tuple[Any, Any, str]:
    """Read STL, PLY and OBJ with Trimesh; VTK's PLY reader ends the process on a truncated file."""
    import trimesh

    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its lines on a damaged file are many
    read: Any = trimesh.load(path, process=False, skip_materials=True)
    if isinstance(read, trimesh.PointCloud):
        return read.vertices, (), ""
    mesh = read.to_mesh() if isinstance(read, trimesh.Scene) else read
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh.vertices, mesh.faces, ""


def _read_stl(path: Path) -> tuple[Any, Any, str]:
    """Read STL: binary STL in a third of the memory that Trimesh takes, with the same points and triangles."""
    head = np.fromfile(path, "<u4", 1, offset=80)
    if len(head) != 1 or path.stat().st_size != 84 + _STL.itemsize * int(head[0]):
        return _by_trimesh(path)
    corners = np.fromfile(path, _STL, offset=84)["corners"].reshape(-1, 3)
    keys = [np.rint(1e8 * each.astype(np.float64)).astype(np.int64) for each in corners.T]
    order = np.lexsort(keys)
    begins = np.zeros(len(order), bool)
    begins[:1] = True
    for key in keys:
        begins[1:] |= np.diff(key[order]) != 0
    del keys
    first = order[begins]  # corner where a point comes first, as the sort is stable
    number = np.argsort(np.argsort(first))
    triangles = np.empty(len(order), np.int64)
    triangles[order] = number[np.cumsum(begins) - 1]
    return corners[np.sort(first)], triangles.reshape(-1, 3), ""


def _by_vtk(path: Path) -> tuple[Any, Any, str]:
    """Read VTP and VTK with VTK, in a process of its own, which a damaged file may end by a signal."""
    with np.load(io.BytesIO(written_by(vtk_file.__name__, path, library="VTK"))) as found:
        stated = _SPACE.match(f"SPACE={found['space']}")
        return found["points"], found["triangles"], stated[1] if stated else ""


_MESH_READERS = {
    ".stl": _read_stl,
    ".ply": _by_trimesh,
    ".obj": _by_trimesh,
    ".vtp": _by_vtk,
    ".vtk": _by_vtk,
}
"""Reader of meshes by the suffix of their files"""


def _read_cloud(path: Path) -> Floats:
    """Read points of a text file with columns x y z, or x y of a single slice, separated by blanks or commas.

    The first line may name the columns; what follows # is a comment.
    """
    try:
        with path.open(encoding="utf-8-sig") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a file without numbers
            lines = iter(partial(file.readline, _LONGEST_LINE), "")
            filled = (line.replace(",", " ") for line in lines if not line.isspace())
            first = next(filled, "").lstrip()
            rows = chain([] if first[:1].isalpha() else [first], filled)
            points = np.loadtxt(islice(rows, _MOST_POINTS), ndmin=2)
            if next(filled, ""):
                raise ValueError(f"it has more than {_MOST_POINTS} points: reduce them")
        if points.shape[1] not in {2, 3}:
            raise ValueError(f"it has {len(points)} rows of {points.shape[1]} columns")
        return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    except ValueError as error:  # of Unicode, too
        fault = f"{path} must hold numbers with decimal points, in columns x, y or x, y, z apart by blanks or commas"
        raise UsageError(f"{fault}: {' '.join(str(error).split())[:200]}") from None


def _around_label(path: Path, label: int | None, axes: str | None) -> tuple[Floats, Integers]:
    """Read the points [the file's unit, scanner axes] and triangles around the voxels of a label.

    If the map has no orientation, the points are in the axes of its voxels, and the caller must give `axes`.
    """
    import pyvista

    values, affine, lacks = read_label_map(path)
    found: set[float] = set()
    for slab in values.T:  # in the order of the file; all at once would take a sorted copy
        found.update(value for value in np.unique(slab).tolist() if value and value == value)  # noqa: PLR0124
        if len(found) > _MOST_LABELS:
            raise UsageError(
                f"{path} is no label map: it has more than {_MOST_LABELS} different numbers"
            )
    labels = sorted(found)
    wanted = labels[0] if label is None and len(labels) == 1 else label
    if wanted not in labels:
        given = "" if label is None else f"--label {label}: "
        there = list_names([f"{value:g}" for value in labels]) or "(none but 0)"
        raise UsageError(f"{given}{path} needs --label N: it has the labels {there}")
    inside = values == wanted
    edges = [
        np.flatnonzero(inside.any(axis=others))[[0, -1]] for others in ((1, 2), (0, 2), (0, 1))
    ]
    inside = inside[tuple(slice(first, last + 1) for first, last in edges)]
    # Padding closes a label that reaches the edge of the image.
    padded = np.pad(inside, 1)
    faces = sum(np.count_nonzero(np.diff(padded, axis=axis)) for axis in range(3))
    if faces > _MOST_FACES:
        raise UsageError(
            f"{path}: the voxels of label {wanted:g} have {faces} faces to others, and a bone has at most {_MOST_FACES}"
        )
    origin = [float(first) - 1.0 for first, _ in edges]
    grid = pyvista.ImageData(dimensions=padded.shape, origin=origin)
    grid.point_data["inside"] = padded.ravel(order="F").view(np.uint8)
    mesh = grid.contour([0.5], scalars="inside").triangulate()
    if lacks and axes is None:
        raise UsageError(
            f"{path} has no orientation ({lacks}): export it with one, or name by --axes which axes of its voxels "
            "point anterior, superior and lateral, as --axes=y,z,x where the first points right, the second anterior "
            "and the third superior"
        )
    points = np.asarray(mesh.points, np.float64) @ affine[:3, :3].T + affine[:3, 3]
    return points, np.asarray(mesh.regular_faces, np.int64)
