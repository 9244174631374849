"""Surfaces of cartilage and bone, in m and in the axes of the femur or tibia frame, and the articular side of a slice.

Trimesh or VTK reads meshes, `label_maps` reads label maps, and point clouds are text. A label map, or a mesh from 3D
Slicer, says in its header which way its axes point (`SPACE=RAS`); for other files the caller must know.

Parallel slices within a slab are cut too: the noise of a mesh differs from one to the next, the bone does not.

**Chart.** Coordinates in which a profile is a function g of a single number make smoothing a linear problem. Femur:
polar, about the centre of its mean circle. g = R/r over the angle α; its curvature has the sign of v = g'' + g, so that
v > 0 is convexity, and v is constant for a circle about the centre. Tibia: height over x. g = y/L over x/L, and v = g''
is free.
"""

from __future__ import annotations

import logging
import math
import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.lab.checks import outside, refuse
from knee_contact_ros.lab.profiles.label_maps import LABEL_MAPS, read_label_map
from knee_contact_ros.lab.tables import some
from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

Integers = NDArray[np.int64]
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
TURNED = "are front and back exchanged (then turn over two axes, as --axes=-x,y,-z; one alone makes a mirror image)?"
AXES_HINT = ("a right knee's are --axes=y,z,x in a scanner's RAS axes and --axes=-y,z,-x in LPS, a left one's have the "
             "other sign of x")  # fmt: skip
DISTANCE = 0.5e-3
"""Distance of adjacent planes of the slab [m], or a little less"""
COVER = 0.5e-3
"""A part further than this behind another part of the surface is not articular [m]; noise is smaller"""
LEAST_POINTS = 12
"""Smallest number of points of a slice"""
BLOCK = 256
"""Number of points compared with all pieces at a time"""
LEAST_LENGTH = 0.5e-3
"""Length [m] above which left-out pieces are reported"""
FLEXION = np.radians(np.linspace(0.0, 60.0, 25))
"""Flexion angles [rad] of gait"""
NEAR = 0.2e-3
"""Points up to this height [m] above the lowest one count as lowest, as noise moves single points"""
STEPWISE = 1e-4
"""Step [m] to which the place of an automatic slice is rounded"""


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


class Pieces(NamedTuple):
    """The n segments in which a plane cuts a mesh."""

    begins: Floats
    """First ends, shape (n, 2) [m]"""
    ends: Floats
    """Second ends, shape (n, 2) [m]"""
    numbers: Any
    """Index of the connected line of each segment, shape (n,)"""


def read_surface(path: Path, unit: str | None = None, axes: str | None = None, label: int | None = None) -> Surface:
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
        raise UsageError(f"{path} is a folder" if path.is_dir() else f"{path}: there is no such file")
    usual, space = BODY_AXES, ""
    kind = "".join(path.suffixes[-2:]).lower() if path.suffix.lower() == ".gz" else path.suffix.lower()
    if kind in LABEL_MAPS:
        points, triangles = _read_label_map(path, label, axes)
        usual, unit = _axes_in("RAS"), unit or "mm"  # nibabel's
    elif label is not None:
        raise UsageError(f"--label {label}: {path} is not a label map; label maps end with {' or '.join(LABEL_MAPS)}")
    elif kind in CLOUDS:
        points, triangles = _read_cloud(path), np.empty((0, 3), np.int64)
    elif kind in MESHES:
        points, triangles, space = _read_mesh(path, kind)
    else:
        known = ", ".join((*MESHES, *CLOUDS, *LABEL_MAPS))
        raise UsageError(f"{path}: a mesh, cloud of points or label map must end with one of {known}")
    remarks: tuple[str, ...] = ()
    if space:
        usual, unit, remarks = _axes_in(space), unit or "mm", _space_remarks(path, space, axes)
    places, signs = _axes(axes or usual)
    _check_size(path, points, unit or "m")
    turned = np.ascontiguousarray(points[:, places] * signs) * UNITS[unit or "m"]
    return Surface(path, turned, triangles, axes or usual, remarks, axes is None and usual != BODY_AXES)


def _axes_in(space: str, left: bool = False) -> str:
    """Axes of a right or left knee in a file whose x, y and z point to sides of the body, as in `RAS` or `LPS`."""
    names = dict(zip(space, "xyz", strict=True))
    wanted = {"A": "P", "S": "I"} | ({"L": "R"} if left else {"R": "L"})
    return ",".join(names.get(side, f"-{names.get(back)}") for side, back in wanted.items())


def _space_remarks(path: Path, space: str, axes: str | None) -> tuple[str, ...]:
    """Describe how the given axes relate to a header's space; refuse axes that contradict it."""
    right, left = _axes_in(space), _axes_in(space, left=True)
    if axes is None:
        return (f"axes {right} follow from SPACE={space} in the file's header, for a right knee; left: --axes={left}",)
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
    return ["xyz".index(letter) for letter in letters], [-1.0 if name[0] == "-" else 1.0 for name in names]


def _check_size(path: Path, points: Floats, unit: str) -> None:
    """Refuse points whose unit does not give the size of a knee, and name the unit that does."""
    if not np.isfinite(points).all():
        raise UsageError(f"{path} has a point that is not finite")
    largest = float(np.ptp(points, axis=0).max())
    likely = min(UNITS, key=lambda name: abs(math.log(max(largest, 1e-9) * UNITS[name] / USUAL)))
    fits = SIZE[0] <= largest * UNITS[likely] <= SIZE[1]
    cure = f"likely it is in {likely}, --unit {likely}" if fits else "scale it to m or mm first"
    refuse(outside(path, f"its largest extent with --unit {unit}", largest * UNITS[unit], "m", SIZE, cure))


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
        raise UsageError(f"{path} cannot be read as a {kind} file: {' '.join(str(error).split())[:200]}") from None
    if not len(points):
        raise UsageError(f"{path} cannot be read as a {kind} file, or has no faces")
    if not len(triangles):
        raise UsageError(f"{path} has {len(points)} points but no faces; a cloud of points must be a text file x y z")
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

    with pyvista.vtk_verbosity("off"):  # likewise
        read: Any = pyvista.read(path)
    read = read if isinstance(read, pyvista.PolyData) else read.extract_surface()
    mesh = read.triangulate().clean()
    has_faces = bool(mesh.n_cells and mesh.faces.size)
    said = SPACE.match(f"SPACE={''.join(map(str, read.field_data['SPACE']))}") if "SPACE" in read.field_data else None
    space = said[1] if said else ""
    return (mesh.points, mesh.regular_faces, space) if has_faces else (read.points, (), space)


MESHES = {".stl": _by_trimesh, ".ply": _by_trimesh, ".obj": _by_trimesh, ".vtp": _by_vtk, ".vtk": _by_vtk}
"""Reader of meshes by the suffix of their files"""


def _read_cloud(path: Path) -> Floats:
    """Read points of a text file with columns x y z, or x y of a single slice, separated by blanks or commas.

    The first line may name the columns; what follows # is a comment.
    """
    try:
        lines = path.read_text("utf-8-sig").replace(",", " ").lstrip().splitlines()
        points = np.loadtxt(lines, ndmin=2, skiprows=int(bool(lines) and lines[0][0].isalpha()))
        return np.pad(points, ((0, 0), (0, {2: 1, 3: 0}[points.shape[1]])))
    except (ValueError, KeyError) as error:  # of Unicode, too
        fault = f"{path} must hold numbers in two columns x, y or three x, y, z"
        raise UsageError(f"{fault}: {' '.join(str(error).split())[:200]}") from None


def _read_label_map(path: Path, label: int | None, axes: str | None) -> tuple[Floats, Integers]:
    """Read the points [the file's unit, scanner axes] and triangles around the voxels of a label.

    If the map has no orientation, the points are in the axes of its voxels, and the caller must give `axes`.
    """
    import pyvista

    values, affine, lacks = read_label_map(path)
    labels = [float(value) for value in np.unique(values) if value != 0]
    shown = some([f"{value:g}" for value in labels]) or "(none but 0)"
    wanted = labels[0] if label is None and len(labels) == 1 else label
    if wanted not in labels:
        given = "" if label is None else f"--label {label}: "
        raise UsageError(f"{given}{path} needs --label N: it has the labels {shown}")
    padded = np.pad(values == wanted, 1).astype(np.float32)  # a label at the edge of the image is closed there
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


def contact_centre(surface: Surface, femur: bool, medial: bool) -> float:
    """Find the place z [m] of the slice through the contact centre of a compartment; medial is z < 0.

    Femur: the mean place of its lowest points while it flexes from 0° to 60°. Tibia: the middle of the plateau, with
    triangles weighted by their area seen from above.

    Raises:
        UsageError: the surface has nothing on that side, or is a point cloud.
    """
    if not len(surface.triangles):
        raise UsageError(f"--slice auto needs a mesh; {surface.path} is a cloud of points: give the slice in mm")
    side = surface.points[:, 2] * (-1.0 if medial else 1.0) > 0.0
    if np.count_nonzero(side) < LEAST_POINTS:
        name = "medial side, z < 0" if medial else "lateral side, z > 0"
        raise UsageError(
            f"--slice auto: {surface.path} has nothing on the {name}; it reaches from {surface.lateral_range} (see "
            "--compartment and --axes)"
        )
    if femur:
        points, places = surface.points[side], []
        for angle in FLEXION:
            height = np.sin(angle) * points[:, 0] + np.cos(angle) * points[:, 1]
            places.append(points[height <= height.min() + NEAR, 2].mean())
        z = np.mean(places)
    else:
        corners = surface.points[surface.triangles[side[surface.triangles].all(axis=1)]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        z = np.average(corners[:, :, 2].mean(axis=1), weights=np.abs(normal[:, 1]) + 1e-30)
    return float(np.round(float(z) / STEPWISE) * STEPWISE)


def cut(surface: Surface, z: float) -> Pieces:
    """Cut a mesh with the plane at `z` [m]."""
    import pyvista

    triangles: Any = surface.triangles
    mesh: Any = pyvista.PolyData.from_regular_faces(surface.points, triangles)
    line = mesh.slice(normal="z", origin=(0.0, 0.0, z))
    if line.n_cells == 0:
        return Pieces(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.int64))
    line = line.clean().connectivity("all")
    ends = line.lines.reshape(-1, 3)[:, 1:]
    points = np.asarray(line.points, np.float64)[:, :2]
    return Pieces(points[ends[:, 0]], points[ends[:, 1]], np.asarray(line.cell_data["RegionId"]))


class Chart(NamedTuple):
    """Coordinates of a slice: the place along the profile, and the function g across it."""

    femur: bool
    middle: Floats
    """Origin, shape (2,) [m]: centre of a femur's circle, middle of a tibia's plateau"""
    scale: float
    """Approximate length [m] of one unit of the place: radius of a femur's circle, or half the width of a plateau"""
    direction: float
    """Direction from a femur's centre to the middle of the profile [rad]"""

    @classmethod
    def around(cls, points: Floats, femur: bool) -> Chart:
        """Make the chart for points of shape (n, 2) [m]; a femur's has the centre of Coope's circle as origin."""
        if not femur:
            x, y = points.T
            middle = np.array([(x.min() + x.max()) / 2.0, y.mean()])
            return cls(False, middle, max(float(np.ptp(x)) / 2.0, 1e-9), 0.0)
        centre, radius = circle(points)
        x, y = (points - centre).mean(axis=0)
        return cls(True, centre, radius, math.atan2(y, x))

    def place(self, points: Floats) -> Floats:
        """Places along the profile from posterior to anterior, shape (n,): angles [rad], or half widths."""
        x, y = (points - self.middle).T
        angle = (np.arctan2(y, x) - self.direction + math.pi) % math.tau - math.pi
        return np.asarray(angle if self.femur else x / self.scale)

    def outwards(self, points: Floats) -> Floats:
        """Distances of points towards the joint [m], shape (n,): from a femur's centre, or heights."""
        x, y = (points - self.middle).T
        return np.asarray(np.hypot(x, y) if self.femur else y)

    def values(self, points: Floats) -> tuple[Floats, Floats]:
        """Values g of points, and the distance across the profile per unit of g there [m], shape (n,) each."""
        out = self.outwards(points)
        return (self.scale / out, out**2 / self.scale) if self.femur else (out / self.scale, 0.0 * out + self.scale)

    def columns(self, grid: Floats, v: Floats) -> Floats:
        """Columns g: the two straight lines, for which v = 0, and one for each column of v, shape (grid, 2 + n)."""
        if not self.femur:
            return np.column_stack([np.ones_like(grid), grid, _integral(grid, _integral(grid, v))])
        sine, cosine = np.sin(grid)[:, None], np.cos(grid)[:, None]  # g'' + g = v: the integral of sin(α - β) v(β)
        curved = sine * _integral(grid, cosine * v) - cosine * _integral(grid, sine * v)
        return np.column_stack([cosine, sine, curved])

    def curve(self, grid: Floats, g: Floats) -> Floats:
        """Points of the profile, shape (grid, 2) [m], from g on a grid of places."""
        if not self.femur:
            return self.middle + self.scale * np.column_stack([grid, g])
        angle = grid + self.direction
        return np.asarray(self.middle + (self.scale / g)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


class Slices(NamedTuple):
    """Points of the articular side in a slice and the slab around it."""

    points: Floats
    """Points, shape (n, 2) [m]"""
    offsets: Floats
    """Distances from the slice relative to the slab's half thickness, shape (n,), -1 to 1; 0 in the slice"""
    remarks: tuple[str, ...]
    """What was left out, as sentences"""

    @property
    def raw(self) -> Floats:
        """Points of the slice itself, shape (n, 2) [m]; for a cloud with few of them, all points of the slab."""
        own = self.offsets == 0.0
        return self.points[own] if np.count_nonzero(own) >= LEAST_POINTS else self.points


def slices(surface: Surface, z: float, slab: float, femur: bool) -> Slices:
    """Select the articular side of a surface within `slab` [m] of the plane at `z` [m].

    Raises:
        UsageError: the plane misses the surface or hardly touches it.
    """
    if not len(surface.triangles):
        return _of_cloud(surface, z, slab)
    middle = cut(surface, z)
    if len(middle.begins) < LEAST_POINTS:
        what = "misses" if not len(middle.begins) else "hardly touches"
        raise UsageError(
            f"--slice {1e3 * z:g} {what} {surface.path}, which reaches from {surface.lateral_range}; or see --axes"
        )
    points, remarks = _articular(middle, Chart.around(np.concatenate([middle.begins, middle.ends]), femur))
    chart = Chart.around(points, femur)
    places = chart.place(points)
    found, offsets = [points], [np.zeros(len(points))]
    planes = math.ceil(slab / DISTANCE)
    for step in range(1, planes + 1):
        beside = [_articular(cut(surface, z + side * slab * step / planes), chart)[0] for side in (-1.0, 1.0)]
        if min(map(len, beside)) < LEAST_POINTS:
            remarks = [*remarks, f"the slab of {1e3 * slab:g} mm reaches beyond the surface"]
            break
        for side, piece in zip((-1.0, 1.0), beside, strict=True):
            at = chart.place(piece)
            found.append(piece[(at >= places.min()) & (at <= places.max())])
            offsets.append(np.full(len(found[-1]), side * step / planes))
    return Slices(np.concatenate(found), np.concatenate(offsets), tuple(remarks))


def _of_cloud(surface: Surface, z: float, slab: float) -> Slices:
    """Select the points of a cloud within `slab` [m] of `z` [m], or all points if there is no third column."""
    flat = not surface.points[:, 2].any()
    distance = np.zeros(len(surface.points)) if flat else surface.points[:, 2] - z
    inside = np.abs(distance) <= slab
    if np.count_nonzero(inside) < LEAST_POINTS:
        raise UsageError(
            f"--slice {1e3 * z:g}: only {np.count_nonzero(inside)} points of {surface.path} lie within "
            f"{1e3 * slab:g} mm of it (--slab); it reaches from {surface.lateral_range}"
        )
    remark = "all points of a cloud are used: it must hold the articular side only"
    return Slices(surface.points[inside, :2], distance[inside] / (slab or 1.0), (remark,))


def _articular(pieces: Pieces, chart: Chart) -> tuple[Floats, list[str]]:
    """Select the visible points of the line that is most visible from outside; also return remarks on the rest."""
    if not len(pieces.begins):
        return np.empty((0, 2)), []
    seen = _seen(0.5 * (pieces.begins + pieces.ends), pieces, chart)
    lengths = np.hypot(*(pieces.ends - pieces.begins).T)
    visible = np.bincount(pieces.numbers, weights=lengths * seen)
    best = int(visible.argmax())
    chosen = (pieces.numbers == best) & seen
    points = np.unique(np.concatenate([pieces.begins[chosen], pieces.ends[chosen]]), axis=0)
    if lengths.sum() - visible[best] <= LEAST_LENGTH:
        return points, []
    return points, [
        f"{1e3 * visible[best]:.1f} of {1e3 * lengths.sum():.1f} mm of the slice are used, the outer side of one "
        f"of {len(visible)} pieces; the rest lies behind it, or is apart from it"
    ]


def _seen(points: Floats, pieces: Pieces, chart: Chart) -> Any:
    """Whether no segment covers each of the points, shape (n, 2) [m], by more than `COVER` from outside; shape (n,)."""
    begin, end = chart.place(pieces.begins), chart.place(pieces.ends)
    out_begin, out_end = chart.outwards(pieces.begins), chart.outwards(pieces.ends)
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    usual = high - low < (math.pi if chart.femur else math.inf)  # a piece round the back of a femur covers nothing
    rise = (out_end - out_begin) / np.where(end == begin, 1.0, end - begin)
    seen = []
    for first in range(0, len(points), BLOCK):  # of many points at once, the table would be large
        part = points[first : first + BLOCK]
        place, out = chart.place(part)[:, None], chart.outwards(part)[:, None]
        covers = (low <= place) & (place <= high) & usual & (out_begin + rise * (place - begin) > out + COVER)
        seen.append(~covers.any(axis=1))
    return np.concatenate(seen)


def _integral(grid: Floats, columns: Floats) -> Floats:
    """Integrate each column from the beginning of the grid, by trapezoids; shape (grid, n)."""
    from scipy.integrate import cumulative_trapezoid

    return np.asarray(cumulative_trapezoid(columns, grid, axis=0, initial=0.0))


def circle(points: Floats) -> tuple[Floats, float]:
    """Fit a circle to points of shape (n, 2) [m] by least squares; return its centre, shape (2,), and radius [m].

    Coope's linear form: (x² + y²) = 2 a x + 2 b y + c. I. D. Coope 1993, J Optim Theory Appl 76:381-388.
    """
    middle = points.mean(axis=0)
    local = points - middle
    rows = np.column_stack([2.0 * local, np.ones(len(local))])
    solution = np.linalg.lstsq(rows, (local**2).sum(axis=1), rcond=None)[0]
    centre = solution[:2]
    return centre + middle, math.sqrt(max(float(solution[2] + centre @ centre), 0.0))
