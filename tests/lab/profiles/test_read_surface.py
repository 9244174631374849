"""The same surface from every kind of file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.profiles.fit import fit
from knee_contact_ros.lab.profiles.surfaces import read_surface
from knee_contact_ros.system.errors import UsageError
from tests.lab.profiles.meshes import MIDDLE, femoral_curve, saved, swept

pytest.importorskip("pyvista", reason="needs the extra mesh")
pytest.importorskip("trimesh")
nibabel = pytest.importorskip("nibabel")

MM = 1e-3
VOXEL = 0.5
"""[mm]"""


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".vtp"])
def test_meshes_of_all_kinds_in_mm(suffix: str, tmp_path: Path) -> None:
    points, triangles = swept(femoral_curve())
    read = read_surface(saved(tmp_path / f"a{suffix}", (points, triangles), MM), "mm")
    assert read.triangles.shape == triangles.shape
    assert read.points.shape == points.shape
    # These files hold 32-bit numbers: 3e-8 m at most; OBJ six digits: 1e-7 m.
    assert np.sort(read.points, axis=0) == pytest.approx(np.sort(points, axis=0), abs=2e-7)


def test_axes_are_turned(tmp_path: Path) -> None:
    """A left knee in a scanner's axes: x to the right, y anterior, z superior."""
    points, triangles = swept(femoral_curve())
    in_scanner = np.column_stack([-points[:, 2], points[:, 0], points[:, 1]])
    read = read_surface(saved(tmp_path / "a.ply", (in_scanner, triangles)), axes="y,z,-x")
    mixed = np.array(
        [1.0, 2.3, 5.7]
    )  # tells the columns apart; PLY holds 32-bit numbers, and its points are in another order
    assert np.sort(read.points @ mixed) == pytest.approx(np.sort(points @ mixed), abs=1e-7)


@pytest.mark.parametrize("separator", [" ", ","])
def test_a_cloud_of_points_gives_nearly_the_profile_of_its_mesh(separator: str, tmp_path: Path) -> None:
    points, triangles = swept(femoral_curve())
    rows = [separator.join(f"{number:.7f}" for number in point) for point in points]
    cloud = tmp_path / "a.txt"
    cloud.write_text("\n".join([separator.join("xyz"), *rows]))
    of_cloud = fit(read_surface(cloud), MIDDLE)
    of_mesh = fit(read_surface(saved(tmp_path / "a.stl", (points, triangles))), MIDDLE)
    assert any("taken whole" in remark for remark in of_cloud.remarks)
    for one, other in zip(of_cloud.circles, of_mesh.circles, strict=True):
        assert one.radius == pytest.approx(other.radius, abs=0.2 * MM)  # facets cut in by 3 um on arcs 2 mm high


def test_points_of_one_slice(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    np.savetxt(path, femoral_curve()[0], delimiter=",", header="x,y", comments="")
    assert fit(read_surface(path), MIDDLE).circles[0].radius == pytest.approx(0.030, abs=1e-5)  # exact but for 1e-8 m


def label_map(path: Path) -> Path:
    """A femur of radius 25 mm under 3 mm of cartilage (label 4; bone 1) about the origin, from z = -28 to -8 mm."""
    anterior, superior = np.meshgrid(np.arange(-32, 32, VOXEL), np.arange(-32, 32, VOXEL), indexing="ij")
    radius, angle = np.hypot(anterior, superior), np.arctan2(-anterior, -superior)
    there = np.abs(angle) < np.radians(150.0)
    slice_ = np.where(radius < 25.0, 1, np.where((radius < 28.0) & there, 4, 0)).astype(np.int16)
    voxels = np.repeat(slice_[None], round(20 / VOXEL), axis=0)
    affine = np.diag([VOXEL, VOXEL, VOXEL, 1.0])
    affine[:3, 3] = (-28.0, -32.0, -32.0)
    nibabel.save(nibabel.Nifti1Image(voxels, affine), path)
    return path


def test_a_label_map(tmp_path: Path) -> None:
    path = label_map(tmp_path / "knee.nii.gz")
    cartilage, bone = read_surface(path, label=4), read_surface(path, label=1)
    found = fit(cartilage, MIDDLE, bone=bone)
    # A voxel's edge lies up to half a voxel off the circle, and steps of it cancel over arcs of 20 mm.
    assert [each.radius for each in found.circles] == pytest.approx([0.028] * len(found.circles), rel=0.05)
    assert len(found.circles) >= 2
    assert found.thickness is not None
    assert found.thickness.mean == pytest.approx(3.0 * MM, abs=VOXEL * MM)


@pytest.mark.parametrize(("label", "words"), [(None, "needs --label N: it has the labels 1, 4"), (7, "--label 7: ")])
def test_a_label_must_be_there(label: int | None, words: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=words):
        read_surface(label_map(tmp_path / "knee.nii"), label=label)
