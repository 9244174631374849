"""Files of strangers cost a line: they neither end the process, nor fill the memory, nor show other files."""

import gzip
import time

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


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (vtk, "VTK ended by signal"),
        (sparse_mesh, "has 2000 MB, and at most 128 MB are read"),
        (nifti_bomb, "it has 1000 x 1000 x 1000 voxels"),
        (zipped_bomb, "needs --label N"),
        (board, "have 4214784 faces to others"),
        (elsewhere, "may name only a file beside it"),
    ],
)
def test_a_file_of_a_stranger_costs_a_line(make, words, tmp_path, capsys):
    path, begin = make(tmp_path), time.process_time()
    command = ["fit-profile", str(path), "--slice=auto", f"--output={tmp_path / 'p.csv'}"]
    assert main(command) == 2
    said = capsys.readouterr().err
    assert words in said
    assert "88" not in said
    assert said.count("\n") == 1
    assert time.process_time() - begin < 10.0  # reading them took minutes


def test_a_mesh_of_vtk_is_read_as_before(tmp_path, capsys):
    path = tmp_path / "small.vtk"
    path.write_text(VTK.format(index=2))
    command = ["fit-profile", str(path), "--slice=0", f"--output={tmp_path / 'p.csv'}"]
    assert main(command) == 2
    assert "--slice 0 misses" in capsys.readouterr().err
