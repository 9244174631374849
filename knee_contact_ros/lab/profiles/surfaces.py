"""Surfaces of cartilage and bone from files, in m and in the axes of the femur or tibia frame.

Trimesh or VTK reads meshes, and point clouds are text. A label map, or a mesh from 3D Slicer, says in its header which
way its axes point (`SPACE=RAS`); for other files the caller must know.

**Label maps** hold a number for every voxel: nibabel reads NIfTI, NRRD and MetaImage are read by their text headers.
Every header says where the voxels lie in a scanner's axes. Ours are RAS: x to the right, y anterior, z superior.
NRRD: https://teem.sourceforge.net/nrrd/format.html. MetaImage: https://itk.org/Wiki/MetaIO/Documentation; its axes are
LPS, and a row of its TransformMatrix is the direction of an axis of the voxels.
"""

from __future__ import annotations

import bz2
import gzip
import logging
import math
import re
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.lab.checks import outside, refuse
from knee_contact_ros.model.types import Floats, Integers
from knee_contact_ros.system.errors import UsageError, list_names
from knee_contact_ros.system.files import open_regular

UNITS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
SIZE = (0.008, 0.7)
"""Generous range of the longest edge of the box around a cartilage or bone of the knee [m]"""
USUAL = 0.07
"""Typical longest edge [m]: the width of a knee"""
CLOUDS = (".txt", ".xyz", ".csv", ".asc", ".dat")
INSIDE = 0.5
"""Level of the contour between voxels of 1 and voxels of 0"""
BODY_AXES = "x,y,z"
"""Axes of a mesh in a body's frame"""
SPACE = re.compile(r"SPACE=([RL][AP][SI])\b")
"""What 3D Slicer writes into the header of a mesh: the sides to which its x, y and z point"""
HEADER = 1024
"""Number of bytes at the beginning of a file that are searched for it"""
AXES_HINT = (
    "a right knee's are --axes=y,z,x in a scanner's RAS axes and --axes=-y,z,-x in LPS, a left one's have the "
    "other sign of x"
)
MAP_HEADER = 2**16
"""Largest size of a text header of a label map [B]"""
TYPES = {"char": "i1", "uchar": "u1", "int": "i4", "uint": "u4", "float": "f4"}
"""NumPy types by the type names in headers, without `signed` and blanks; other names are the same in NumPy"""
UNPACKED: dict[str, Callable[[bytes], bytes]] = {
    "raw": bytes,
    "gzip": gzip.decompress,
    "gz": gzip.decompress,
    "bzip2": bz2.decompress,
    "bz2": bz2.decompress,
    "zlib": zlib.decompress,
}
NUMBER = re.compile(r"[-+0-9.eE]+")
LONGEST = 32
"""Largest number of bytes of a voxel in a text; in other encodings it has fewer"""


class Surface(NamedTuple):
    """Mesh, or a point cloud if there are no triangles."""

    path: Path
    points: Floats
    """Points, shape (n, 3) [m]: x anterior, y superior, z lateral"""
    triangles: Integers
    """Indices in `points` of each triangle's corners, shape (m, 3); m = 0 for a cloud"""
    axes: str = BODY_AXES
    """The file's axes that point anterior, superior and lateral"""
    remarks: tuple[str, ...] = ()
    """How the axes were found, as sentences"""
    known: bool = False
    """Whether the axes follow from the file's header"""

    @property
    def axes_cure(self) -> str:
        """Advice for a slice that does not look like a condyle because the axes may be wrong."""
        return "see --slice" if self.known else f"see --axes and --slice; {AXES_HINT}"

    @property
    def lateral_range(self) -> str:
        """Text of the surface's extent along z [mm]."""
        low, high = 1e3 * self.points[:, 2].min(), 1e3 * self.points[:, 2].max()
        return f"z = {low:.1f} to {high:.1f} mm"


def read_surface(
    path: Path, unit: str | None = None, axes: str | None = None, label: int | None = None
) -> Surface:
    """Read a mesh, a cloud of points or a label of a label map.

    Args:
        path: The file; its suffix gives its kind.
        unit: Unit of the file; default m, and mm for label maps and meshes from 3D Slicer.
        axes: The file's axes that point anterior, superior and lateral, as in `-y,z,x`. Default: a right knee's if the
            header says which way the axes point (label maps, meshes from 3D Slicer), else x,y,z.
        label: Label of a label map; None if it has only one.

    Raises:
        UsageError: the file is missing, of unknown kind, unreadable, without a surface or not of a knee's size, or
            `axes` contradict its header.
    """
    if not path.is_file():
        raise UsageError(
            f"{path} is a folder" if path.is_dir() else f"{path}: there is no such file"
        )
    usual, space = BODY_AXES, ""
    kind = (
        "".join(path.suffixes[-2:]).lower()
        if path.suffix.lower() == ".gz"
        else path.suffix.lower()
    )
    if kind in LABEL_MAPS:
        points, triangles = _around_label(path, label, axes)
        usual, unit = _axes_in("RAS"), unit or "mm"  # nibabel's
    elif label is not None:
        raise UsageError(
            f"--label {label}: {path} is not a label map; label maps end with {' or '.join(LABEL_MAPS)}"
        )
    elif kind in CLOUDS:
        points, triangles = _read_cloud(path), np.empty((0, 3), np.int64)
    elif kind in MESHES:
        points, triangles, space = _read_mesh(path, kind)
    else:
        known = ", ".join((*MESHES, *CLOUDS, *LABEL_MAPS))
        raise UsageError(
            f"{path}: a mesh, cloud of points or label map must end with one of {known}"
        )
    remarks: tuple[str, ...] = ()
    if space:
        usual, unit, remarks = _axes_in(space), unit or "mm", _space_remarks(path, space, axes)
    places, signs = _axes(axes or usual)
    _check_size(path, points, unit or "m")
    turned = np.ascontiguousarray(points[:, places] * signs) * UNITS[unit or "m"]
    return Surface(
        path, turned, triangles, axes or usual, remarks, axes is None and usual != BODY_AXES
    )


def _axes_in(space: str, left: bool = False) -> str:
    """Axes of a right or left knee in a file whose x, y and z point to sides of the body, as in `RAS` or `LPS`."""
    names = dict(zip(space, "xyz", strict=True))
    wanted = {"A": "P", "S": "I"} | ({"L": "R"} if left else {"R": "L"})
    return ",".join(names.get(side, f"-{names.get(back)}") for side, back in wanted.items())


def _space_remarks(path: Path, space: str, axes: str | None) -> tuple[str, ...]:
    """Describe how the given axes relate to a header's space; refuse axes that contradict it."""
    right, left = _axes_in(space), _axes_in(space, left=True)
    if axes is None:
        return (
            f"axes {right} follow from SPACE={space} in the file's header, for a right knee; left: --axes={left}",
        )
    (places, signs), (known, known_signs) = _axes(axes), _axes(right)
    cure = f"the header of {path.name} says SPACE={space}, where a right knee's are {right} and a left one's {left}"
    for row, what in enumerate(("front and back", "up and down")):
        if places[row] == known[row] and signs[row] != known_signs[row]:
            raise UsageError(f"--axes={axes} exchanges {what}: {cure}")
    return () if places == known else (f"--axes={axes} is used, although {cure}",)


def _axes(text: str) -> tuple[list[int], list[float]]:
    """Columns of the file, and their signs, that point anterior, superior and lateral."""
    names = [name.strip().lower() for name in text.split(",")]
    letters = [name.lstrip("+-") for name in names]
    if sorted(letters) != ["x", "y", "z"] or any(len(name) > 2 for name in names):
        raise UsageError(
            f"--axes {text}: it must name the file's axes that point anterior, superior and lateral, "
            "each of x, y and z once, as x,y,z or --axes=-y,z,x"
        )
    return ["xyz".index(letter) for letter in letters], [
        -1.0 if name[0] == "-" else 1.0 for name in names
    ]


def _check_size(path: Path, points: Floats, unit: str) -> None:
    """Refuse points whose unit does not give the size of a knee, and name the unit that does."""
    if not np.isfinite(points).all():
        raise UsageError(f"{path} has a point that is not finite")
    largest = float(np.ptp(points, axis=0).max())
    likely = min(UNITS, key=lambda name: abs(math.log(max(largest, 1e-9) * UNITS[name] / USUAL)))
    fits = SIZE[0] <= largest * UNITS[likely] <= SIZE[1]
    cure = f"likely it is in {likely}, --unit {likely}" if fits else "scale it to m or mm first"
    refuse(
        outside(
            path, f"its largest extent with --unit {unit}", largest * UNITS[unit], "m", SIZE, cure
        )
    )


def _read_mesh(path: Path, kind: str) -> tuple[Floats, Integers, str]:
    """Read points [the file's unit], triangles and space of a mesh; coincident points are merged.

    The space is `RAS`, `LPS` and the like, as in `SPACE`, or empty.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            points, triangles, space = MESHES[kind](path)
        with path.open("rb") as file:
            said = SPACE.search(file.read(HEADER).decode("latin-1"))
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
    space = space or (said[1] if said else "")
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


def _by_vtk(path: Path) -> tuple[Any, Any, str]:
    """Read VTP and VTK with VTK, the only library that reads them."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    vtkObject.GlobalWarningDisplayOff()  # likewise, and those that go through Python's logging
    with pyvista.vtk_verbosity("off"):
        read: Any = pyvista.read(path)
    read = read if isinstance(read, pyvista.PolyData) else read.extract_surface()
    mesh = read.triangulate().clean()
    has_faces = bool(mesh.n_cells and mesh.faces.size)
    said = (
        SPACE.match(f"SPACE={''.join(map(str, read.field_data['SPACE']))}")
        if "SPACE" in read.field_data
        else None
    )
    space = said[1] if said else ""
    return (mesh.points, mesh.regular_faces, space) if has_faces else (read.points, (), space)


MESHES = {
    ".stl": _by_trimesh,
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
        lines = path.read_text("utf-8-sig").replace(",", " ").lstrip().splitlines()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a file without numbers
            points = np.loadtxt(
                lines, ndmin=2, skiprows=int(bool(lines) and lines[0][0].isalpha())
            )
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

    values, affine, lacks = _label_map(path)
    labels = [float(value) for value in np.unique(values) if value != 0]
    shown = list_names([f"{value:g}" for value in labels]) or "(none but 0)"
    wanted = labels[0] if label is None and len(labels) == 1 else label
    if wanted not in labels:
        given = "" if label is None else f"--label {label}: "
        raise UsageError(f"{given}{path} needs --label N: it has the labels {shown}")
    padded = np.pad(values == wanted, 1).astype(
        np.float32
    )  # a label at the edge of the image is closed there
    grid = pyvista.ImageData(dimensions=padded.shape, origin=(-1.0, -1.0, -1.0))
    grid.point_data["inside"] = padded.ravel(order="F")
    mesh = grid.contour([INSIDE], scalars="inside").triangulate()
    if lacks and axes is None:
        raise UsageError(
            f"{path} has no orientation ({lacks}): export it with one, or name by --axes which axes of its voxels "
            "point anterior, superior and lateral, as --axes=y,z,x where the first points right, the second anterior "
            "and the third superior"
        )
    points = np.asarray(mesh.points, np.float64) @ affine[:3, :3].T + affine[:3, 3]
    return points, np.asarray(mesh.regular_faces, np.int64)


class LabelMap(NamedTuple):
    """Labels of voxels, and where the voxels lie."""

    values: NDArray[Any]
    """Shape (i, j, k)"""
    affine: Floats
    """Transforms indices of voxels to a scanner's RAS axes [mm], shape (4, 4)"""
    lacks: str = ""
    """What the header lacks to give the orientation; the affine is then in the voxels' own axes. Empty: nothing"""


def _label_map(path: Path) -> LabelMap:
    """Read a label map; the suffix tells its kind.

    Raises:
        UsageError: the file cannot be read, or does not have three dimensions.
    """
    reader = next(
        reader for suffix, reader in LABEL_MAPS.items() if path.name.lower().endswith(suffix)
    )
    try:
        found = reader(path)
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    values = found.values
    values = (
        values.reshape(values.shape[:3])
        if values.ndim > 3 and set(values.shape[3:]) == {1}
        else values
    )
    if values.ndim != 3 or not values.size or abs(np.linalg.det(found.affine)) < 1e-12:
        raise UsageError(
            f"{path}: its voxels have the shape {values.shape}; a map of three dimensions is needed"
        )
    return found._replace(values=values)


def _nifti(path: Path) -> LabelMap:
    import nibabel

    image: Any = nibabel.load(path)
    affine = np.array(image.affine, np.float64)
    if image.header["sform_code"] or image.header["qform_code"]:
        return LabelMap(np.asarray(image.dataobj), affine)
    affine[0] *= -1.0  # nibabel turns the first axis over, as Analyze's files have it
    return LabelMap(np.asarray(image.dataobj), affine, "its sform and qform codes are 0")


def _nrrd(path: Path) -> LabelMap:
    content = path.read_bytes()
    end = re.search(rb"\r?\n\r?\n", content[:MAP_HEADER])
    head, data = (
        (content[: end.start()], content[end.end() :]) if end else (content[:MAP_HEADER], b"")
    )
    if not head.startswith(b"NRRD"):
        raise ValueError("it does not begin with NRRD")
    fields = _fields(head, ":")
    if (
        fields.get("dimension") != "3"
        or fields.get("byte skip", "0") != "0"
        or fields.get("line skip", "0") != "0"
    ):
        raise ValueError("a map has dimension 3, without byte skip and line skip")
    if name := fields.get("data file") or fields.get("datafile"):
        data = _data_file(path.parent / name, fields["sizes"])
    values = _voxels(
        data, fields["type"], fields["sizes"], fields["encoding"], fields.get("endian") == "big"
    )
    space, directions = fields.get("space", ""), fields.get("space directions", "none")
    letters = (
        space if len(space) == 3 else "".join(word[:1] for word in space.split("-"))
    ).upper()
    if not re.fullmatch("[RL][AP][SI]", letters) or "none" in directions:
        spacing = _numbers(fields.get("spacings", "1 1 1"))
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no space directions")
    unit = (re.findall('"(.*?)"', fields.get("space units", "")) or ["mm"])[0]
    turn = {"mm": 1.0, "cm": 10.0, "m": 1e3}[unit] * np.array(
        [1.0 if each in "RAS" else -1.0 for each in letters]
    )
    return LabelMap(
        values, _affine(_numbers(directions), fields.get("space origin", "0 0 0"), turn)
    )


def _meta_image(path: Path) -> LabelMap:
    head, key, rest = path.read_bytes().partition(b"ElementDataFile")
    if not key:
        raise ValueError("it has no ElementDataFile")
    line, _, data = rest.partition(b"\n")
    fields, name = _fields(head[:MAP_HEADER], "="), line.decode().strip(" =\r")
    if name.upper() != "LOCAL":
        data = _data_file(path.parent / name, fields["dimsize"])

    def first(names: str, default: str) -> str:
        return next((fields[name] for name in names.split() if name in fields), default)

    kind = fields["elementtype"].lower().removeprefix("met_").replace("_", "")
    encoding = "zlib" if first("compresseddata", "").lower() == "true" else "raw"
    big = first("binarydatabyteordermsb elementbyteordermsb", "").lower() == "true"
    values = _voxels(data, kind, fields["dimsize"], encoding, big)
    spacing = np.array(_numbers(fields.get("elementspacing", "1 1 1")))
    matrix = _numbers(first("transformmatrix rotation orientation", ""))
    if not matrix:
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no TransformMatrix")
    directions = np.reshape(matrix, (3, 3)) * spacing[:, None]
    return LabelMap(
        values,
        _affine(directions, first("offset position origin", "0 0 0"), np.array([-1.0, -1.0, 1.0])),
    )


def _data_file(path: Path, sizes: str) -> bytes:
    """Read the file that a header names, as far as the voxels of the given sizes may reach."""
    with open_regular(path) as file:
        return file.read(LONGEST * math.prod(int(size) for size in _numbers(sizes)))


def _fields(head: bytes, mark: str) -> dict[str, str]:
    """Entries of a header by lower-case names."""
    lines = [line.split(mark, 1) for line in head.decode("latin-1").splitlines() if mark in line]
    return {key.strip().lower(): value.strip(" =") for key, value in lines}


def _affine(directions: Any, origin: str, turn: Floats) -> Floats:
    """Affine from the directions of the voxels' axes, in order, and an origin, both scaled and turned by `turn`."""
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = np.reshape(directions, (3, 3)).T, _numbers(origin)
    affine[:3] *= turn[:, None]
    return affine


def _numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def _voxels(data: bytes, kind: str, sizes: str, encoding: str, big: bool) -> NDArray[Any]:
    """Decode the numbers of voxels, the first axis fastest."""
    kind = (
        kind.replace("unsigned ", "u")
        .replace("signed ", "")
        .removesuffix(" int")
        .removesuffix("_t")
    )
    dtype = np.dtype(TYPES.get(kind, kind.replace(" ", ""))).newbyteorder(">" if big else "<")
    shape = tuple(int(size) for size in _numbers(sizes))
    if encoding in {"text", "txt", "ascii"}:
        try:
            return np.array(data.split(), dtype).reshape(shape, order="F")
        except ValueError:  # its words may come from any file that a header names
            raise ValueError(
                f"its data are not the {math.prod(shape)} numbers of a text"
            ) from None
    data = UNPACKED[encoding](data)
    if len(data) < math.prod(shape) * dtype.itemsize:
        raise ValueError(f"it has {len(data)} of {math.prod(shape) * dtype.itemsize} B")
    return np.frombuffer(data, dtype, math.prod(shape)).reshape(shape, order="F")


LABEL_MAPS = {
    ".nii": _nifti,
    ".nii.gz": _nifti,
    ".nrrd": _nrrd,
    ".nhdr": _nrrd,
    ".mha": _meta_image,
    ".mhd": _meta_image,
}
"""Reader by the suffix of a file"""
