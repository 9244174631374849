"""Files of strangers cost a line: they neither end the process, nor fill the memory, nor show other files."""

import bz2
import gzip
import time
import tracemalloc

import numpy as np
import pytest

from knee_contact_ros.commands.main import main

VTK = """\
# vtk DataFile Version 3.0
a mesh
ASCII
DATASET POLYDATA
POINTS 3 float
0 0 0 0.03 0 0 0 0.03 0
POLYGONS 1 4
3 0 1 {index}
"""
NRRD = "NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {sizes}\nencoding: {encoding}\n{more}\n"


def vtk(folder):
    path = folder / "index.vtk"
    path.write_text(VTK.format(index=10_000_000))
    return path


def sparse_mesh(folder):
    path = folder / "sparse.stl"
    with path.open("wb") as file:
        file.truncate(2 * 10**9)
    return path


def nifti_bomb(folder):
    """A header that promises 10^9 voxels, over zeros."""
    nibabel = pytest.importorskip("nibabel")
    head = nibabel.Nifti1Header()
    head.set_data_shape((1000, 1000, 1000))
    head.set_data_dtype(np.uint8)
    head["vox_offset"], head["magic"] = 352, b"n+1"
    path = folder / "bomb.nii.gz"
    with gzip.open(path, "wb", compresslevel=9) as file:
        file.write(head.binaryblock + bytes(4))
        for _ in range(100):
            file.write(bytes(10**7))
    return path


def zipped_bomb(folder):
    """A few voxels, and a gigabyte behind them."""
    path = folder / "bomb.nrrd"
    head = NRRD.format(kind="uchar", sizes="4 4 4", encoding="gzip", more="").encode()
    path.write_bytes(head + gzip.compress(bytes(10**9), compresslevel=1))
    return path


def board(folder):
    """Voxels that alternate, each with six faces: a map of usual size took 16 GB."""
    path = folder / "board.nrrd"
    voxels = (np.indices((112, 112, 112)).sum(axis=0) % 2).astype(np.uint8)
    head = NRRD.format(kind="uchar", sizes="112 112 112", encoding="gzip", more="").encode()
    path.write_bytes(head + gzip.compress(voxels.tobytes()))
    return path


def elsewhere(folder):
    """A header that names a file of the user's."""
    (folder / "secret.txt").write_text("11 22 33 44 55 66 77 88")
    (folder / "maps").mkdir()
    path = folder / "maps" / "a.nhdr"
    more = "data file: ../secret.txt\n"
    path.write_text(NRRD.format(kind="uchar", sizes="2 2 2", encoding="ascii", more=more))
    return path


def late_voxels(folder):
    """Packed voxels behind 10 GB of zeros."""
    nibabel = pytest.importorskip("nibabel")
    head = nibabel.Nifti1Header()
    head.set_data_shape((8, 8, 8))
    head["vox_offset"], head["magic"] = 10**10, b"n+1"
    path = folder / "late.nii.gz"
    zeros = gzip.compress(bytes(10**8))
    path.write_bytes(gzip.compress(head.binaryblock + bytes(4)) + 100 * zeros)
    return path


def complex_numbers(folder):
    """Voxels that are no labels."""
    nibabel = pytest.importorskip("nibabel")
    head = nibabel.Nifti1Header()
    head.set_data_shape((4, 4, 4))
    head.set_data_dtype(np.complex64)
    path = folder / "complex.nii"
    head["vox_offset"], head["magic"] = 352, b"n+1"
    path.write_bytes(head.binaryblock + bytes(4 + 512))
    return path


def greys(folder):
    path = folder / "greys.nrrd"
    head = NRRD.format(kind="double", sizes="128 128 128", encoding="raw", more="").encode()
    path.write_bytes(head + np.random.default_rng(1).random(2**21).tobytes())
    return path


def words(folder):
    """Voxels as text, which took 5 GB."""
    path = folder / "words.nrrd"
    head = NRRD.format(kind="uchar", sizes="512 512 256", encoding="ascii", more="").encode()
    path.write_bytes(head + b"0 " * 2**26)
    return path


def sparse_voxels(folder):
    """A file of voxels with a hole of 2 GB, of which a few are used."""
    with (folder / "hole").open("wb") as file:
        file.truncate(2 * 10**9)
    path = folder / "sparse.mhd"
    path.write_text("ElementType = MET_UCHAR\nDimSize = 512 512 128\nElementDataFile = hole\n")
    return path


def doubles(path):
    """A map of 268 MB, packed to one: unpacked at once it took twice that."""
    nibabel = pytest.importorskip("nibabel")
    voxels = np.zeros((512, 512, 128), order="F")
    nibabel.save(nibabel.Nifti1Image(voxels, np.eye(4)), path)
    return path


def packed_nifti(folder):
    return doubles(folder / "doubles.nii.gz")


def packed_nrrd(folder, packed=gzip.compress, encoding="gzip"):
    path = folder / "doubles.nrrd"
    head = NRRD.format(kind="double", sizes="512 512 128", encoding=encoding, more="").encode()
    path.write_bytes(head + packed(bytes(2**28), 1))
    return path


def packed_by_bzip2(folder):
    return packed_nrrd(folder, bz2.compress, "bzip2")


def cloud(folder):
    path = folder / "cloud.xyz"
    path.write_bytes(b"0 0 0\n" * 6_000_000)
    return path


def wide_line(folder):
    """One line, for which an array of petabytes was asked."""
    path = folder / "wide.xyz"
    path.write_bytes(b"0 " * 10_000_000)
    return path


def crossed(folder):
    """Triangles that all cross every slice, of which each pair was compared."""
    stl = np.zeros(30_000, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("flags", "<u2")])
    stl["corners"] = np.random.default_rng(1).uniform(-0.03, 0.03, (30_000, 3, 3))
    stl["corners"][:, :, 2] = -0.02, -0.01, 0.02
    path = folder / "crossed.stl"
    path.write_bytes(bytes(80) + np.uint32(len(stl)).tobytes() + stl.tobytes())
    return path


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (vtk, "VTK ended by signal"),
        (sparse_mesh, "has 2000 MB, and at most 128 MB are read"),
        (nifti_bomb, "it has 1000 x 1000 x 1000 voxels"),
        (zipped_bomb, "needs --label N"),
        (board, "have 4214784 faces to others"),
        (elsewhere, "may name only a file beside it"),
        (late_voxels, "its voxels begin at byte 10000000000"),
        (complex_numbers, "a map of numbers in three dimensions is needed"),
        (greys, "it has more than 1000 different numbers"),
        (words, "it has 67108864 voxels as text"),
        (sparse_voxels, "needs --label N: it has the labels (none but 0)"),
        (packed_nifti, "needs --label N"),
        (packed_nrrd, "needs --label N"),
        (packed_by_bzip2, "needs --label N"),
        (cloud, "it has more than 4000000 points"),
        (wide_line, "it has 20000 rows of 500 columns"),
        (crossed, "cuts 30000 triangles"),
    ],
)
def test_a_file_of_a_stranger_costs_a_line(make, words, tmp_path, capsys):
    path = make(tmp_path)
    begin = time.process_time()
    tracemalloc.start()
    command = ["fit-profile", str(path), "--slice=auto", f"--output={tmp_path / 'p.csv'}"]
    assert main(command) == 2
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    said = capsys.readouterr().err
    assert words in said
    assert "66, 77" not in said
    assert said.count("\n") == 1
    assert time.process_time() - begin < 10.0  # reading them took minutes
    assert most < 500_000_000  # B


def test_a_mesh_of_vtk_is_read_as_before(tmp_path, capsys):
    path = tmp_path / "small.vtk"
    path.write_text(VTK.format(index=2))
    command = ["fit-profile", str(path), "--slice=0", f"--output={tmp_path / 'p.csv'}"]
    assert main(command) == 2
    assert "--slice 0 misses" in capsys.readouterr().err


def test_of_a_dense_cloud_a_part_is_used(tmp_path, capsys):
    """A scan's slice of 200 000 points would take gigabytes."""
    angles = np.random.default_rng(1).uniform(-2.6, 2.6, 200_000)
    path = tmp_path / "scan.xyz"
    np.savetxt(path, 34.0 * np.column_stack([-np.sin(angles), -np.cos(angles)]), "%.4f")
    begin = time.process_time()
    command = ["fit-profile", str(path), "--unit=mm", "--slice=0"]
    assert main([*command, f"--output={tmp_path / 'p.csv'}"]) == 0
    assert "50000 are used" in " ".join(capsys.readouterr().out.split())
    lines = (tmp_path / "p.csv").read_text().splitlines()
    profile = np.loadtxt([line for line in lines if line[0] in "-.0123456789"], delimiter=",")
    np.testing.assert_allclose(np.hypot(*profile[:, :2].T), 0.034, atol=2e-5)
    assert time.process_time() - begin < 10.0
