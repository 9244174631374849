"""Knees of known shape as meshes: arcs of circles swept along z, in m."""

import bz2
import gzip
import zlib

import numpy as np

EDGE = 0.7e-3
"""[m] of a triangle, as in meshes from MRI"""
ONE_RADIUS = ((0.030, -45.0, 150.0),)
TWO_RADII = ((0.034, -45.0, 40.0), (0.022, 40.0, 150.0))
"""Radius [m], from which normal to which [deg]"""
MIDDLE = -0.018
"""z [m] of the condyle's ridge"""
RIDGE = 0.020
"""[m] Radius of the condyle across"""
VOXEL = 0.5
"""[mm] of the label map"""


def femoral_curve(
    arcs=ONE_RADIUS,
):
    """Points and outward normals, shape (n, 2), from anterior to posterior; arcs meet without a corner."""
    points, normals = [], []
    centre = np.zeros(2)
    for number, (radius, low, high) in enumerate(arcs):
        angle = np.radians(
            np.linspace(low, high, max(4, round(radius * np.radians(high - low) / EDGE)))
        )
        normal = np.column_stack([-np.sin(angle), -np.cos(angle)])
        centre = points[-1][-1] - radius * normal[0] if number else centre
        points.append(centre + radius * normal)
        normals.append(normal)
    return np.concatenate(points), np.concatenate(normals)


def tibial_curve(radius=0.095):
    """A concave circle with its lowest point at the origin."""
    x = np.linspace(-0.018, 0.018, round(0.036 / EDGE))
    height = np.sqrt(radius**2 - x**2)
    return np.column_stack([x, radius - height]), np.column_stack([-x, height]) / radius


def swept(
    curve,
    *,
    inwards=0.0,
    noise=0.0,
    seed=1,
    larger=1.0,
):
    """Points (n, 3) and triangles of a surface through a curve at z = `MIDDLE`, falling off to both sides.

    `inwards` [m] moves it along its normals, `noise` [m] is the standard deviation of its points along them, and all of
    it is `larger` times as large.
    """
    points, normals = curve
    across = np.linspace(-0.010, 0.010, 29)
    fall = np.sqrt(RIDGE**2 - across**2) - RIDGE - inwards
    shake = np.random.default_rng(seed).normal(0.0, noise, (len(points), len(across)))
    xy = points[:, None, :] + normals[:, None, :] * (fall + shake)[:, :, None]
    z = np.broadcast_to(MIDDLE + across, xy.shape[:2])
    corner = np.arange(len(points) * len(across)).reshape(len(points), len(across))
    a, b, c, d = (
        part.ravel()
        for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:])
    )
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return larger * np.concatenate([xy.reshape(-1, 2), z.reshape(-1, 1)], axis=1), triangles


def saved(path, mesh, unit=1.0):
    """Write a mesh in the form of its suffix."""
    import pyvista

    polygons = pyvista.PolyData.from_regular_faces(mesh[0] / unit, mesh[1])
    polygons.save(path)
    return path


def spaced(path, mesh, space):
    """Write a mesh in mm that says in its header which way its axes point, as 3D Slicer does."""
    import pyvista

    polygons = pyvista.PolyData.from_regular_faces(1e3 * mesh[0], mesh[1])
    said = f"3D Slicer output. SPACE={space}"
    if path.suffix == ".vtp":
        polygons.field_data["SPACE"] = [space]
    polygons.save(path)
    content = path.read_bytes()
    if path.suffix == ".stl":
        content = said.encode().ljust(80) + content[80:]
    elif path.suffix == ".ply":
        content = content.replace(
            b"\nelement vertex", f"\ncomment {said}\nelement vertex".encode(), 1
        )
    elif path.suffix == ".vtk":
        first, _, rest = content.split(b"\n", 2)
        content = b"\n".join([first, said.encode(), rest])
    elif path.suffix == ".obj":
        content = f"# {said}\n".encode() + content
    path.write_bytes(content)
    return path


def label_map(path):
    """A femur of radius 25 mm under 3 mm of cartilage (label 4; bone 1) about the origin, from z = -28 to -8 mm."""
    import nibabel

    anterior, superior = np.meshgrid(
        np.arange(-32, 32, VOXEL), np.arange(-32, 32, VOXEL), indexing="ij"
    )
    radius, angle = np.hypot(anterior, superior), np.arctan2(-anterior, -superior)
    there = np.abs(angle) < np.radians(150.0)
    slice_ = np.where(radius < 25.0, 1, np.where((radius < 28.0) & there, 4, 0)).astype(np.int16)
    affine = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    affine[:3, 3] = (-28.0, -32.0, -32.0)
    nibabel.save(
        nibabel.Nifti1Image(np.repeat(slice_[None], round(20 / VOXEL), axis=0), affine), path
    )
    return path


def other_map(path, encoding, space="left-posterior-superior"):
    """The label map of `label_map` as NRRD or MetaImage, of which the last axis of the voxels comes first, reversed."""
    import nibabel

    image = nibabel.load(label_map(path.with_suffix(".nii")))
    values = np.asarray(image.dataobj).copy().transpose(2, 0, 1)[::-1]
    path.with_suffix(".nii").unlink()
    directions, origin = (
        np.diag(image.affine)[:3, None] * np.eye(3)[[2, 0, 1]],
        np.array(image.affine[:3, 3]),
    )
    origin = origin + directions[0] * (len(values) - 1)
    directions[0] *= -1.0
    if space.upper().startswith("L") or path.suffix in {".mha", ".mhd"}:
        directions, origin = directions * [-1.0, -1.0, 1.0], origin * [-1.0, -1.0, 1.0]
    data = values.astype("<i2").tobytes(order="F")
    if path.suffix in {".nrrd", ".nhdr"}:
        ascii_ = " ".join(map(str, values.ravel(order="F"))).encode()
        data = {
            "gzip": gzip.compress(data),
            "bzip2": bz2.compress(data),
            "raw": data,
            "ascii": ascii_,
        }[encoding]
        vectors = " ".join("({:.17g},{:.17g},{:.17g})".format(*axis) for axis in directions)
        head = [
            "NRRD0005",
            "# made up",
            "type: short",
            "dimension: 3",
            f"space: {space}",
            "sizes: " + " ".join(map(str, values.shape)),
            f"space directions: {vectors}",
            "kinds: domain domain domain",
            "endian: little",
            f"encoding: {encoding}",
            "space origin: ({:.17g},{:.17g},{:.17g})".format(*origin),
            "Segment0_Name:=cartilage",
            *(["data file: voxels"] if path.suffix == ".nhdr" else []),
        ]
        own = "\n".join(head).encode() + b"\n\n"
    else:
        data = {"gzip": zlib.compress, "raw": bytes}[encoding](data)
        spacing = np.linalg.norm(directions, axis=1)
        head = [
            "ObjectType = Image",
            "NDims = 3",
            f"CompressedData = {encoding == 'gzip'}",
            "TransformMatrix = "
            + " ".join(f"{n:.17g}" for n in (directions / spacing[:, None]).ravel()),
            "Offset = " + " ".join(f"{n:.17g}" for n in origin),
            "ElementSpacing = " + " ".join(f"{n:.17g}" for n in spacing),
            "DimSize = " + " ".join(map(str, values.shape)),
            "ElementType = MET_SHORT",
            "ElementDataFile = " + ("voxels" if path.suffix == ".mhd" else "LOCAL"),
        ]
        own = "\n".join(head).encode() + b"\n"
    if path.suffix in {".nhdr", ".mhd"}:
        path.with_name("voxels").write_bytes(data)
        data = b""
    path.write_bytes(own + data)
    return path
