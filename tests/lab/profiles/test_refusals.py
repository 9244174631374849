"""What cannot be fitted is told in one line, and nothing is written."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from tests.lab.profiles.meshes import (
    TWO_RADII,
    femoral_curve,
    label_map,
    other_map,
    saved,
    spaced,
    swept,
    tibial_curve,
)

for library in ("pyvista", "trimesh", "matplotlib", "nibabel"):
    pytest.importorskip(library, reason="needs the extra mesh")

FEMUR = swept(femoral_curve())
BONE = swept(femoral_curve(), inwards=0.002)
TIBIA = swept(tibial_curve())
SMALL = ((0.0065, -45.0, 150.0),)
GROWING = ((0.020, -60.0, 40.0), (0.030, 40.0, 150.0))
LARGE = swept(femoral_curve(TWO_RADII), larger=1.6)
KNEE, FACES = swept(femoral_curve(TWO_RADII))
SCANNER = FEMUR[0][:, [2, 0, 1]]
"""The femur's points in a scanner's axes: x right, y anterior, z superior"""
HOLLOW = (
    0.008
    * np.exp(-(np.linspace(-9.0, 9.0, len(femoral_curve()[0])) ** 2))[:, None]
    * femoral_curve()[1]
)


def unoriented(path):
    """A label map of which the header does not say how its voxels lie."""
    import nibabel

    image = nibabel.load(label_map(path))
    plain = nibabel.Nifti1Image(image.get_fdata(), None)
    nibabel.save(plain, path)


def replaced(path, old, new):
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))


def text(content):
    return lambda path: path.write_text(content)


def mesh(shape=FEMUR, unit=1.0, bone=None):
    """Write a mesh, and another one beside it."""
    return lambda path: [
        saved(path, shape, unit),
        *([saved(path.with_name("bone.stl"), bone)] if bone else []),
    ]


def cut_off(path):
    content = saved(path, FEMUR).read_bytes()
    path.write_bytes(content[: len(content) // 2])


def beside(name, encoding="raw"):
    """Write a label map whose header names another file."""

    def write(path):
        os.mkfifo("pipe")
        Path("words").write_text("secret " * 655360)
        replaced(other_map(path, encoding), b"voxels", name.encode())

    return write


def halves(path):
    """Two contours, 1 mm on either side of the slice, of which each holds one half of the condyle."""
    points, normals = femoral_curve(TWO_RADII)
    half = len(points) // 2
    lower, upper = (points + rise * normals for rise in (0.0, 0.0005))
    sides = (
        np.pad(part, ((0, 0), (0, 1)), constant_values=z)
        for part, z in ((lower[: half + 9], -0.019), (upper[half - 9 :], -0.017))
    )
    np.savetxt(path, np.concatenate([*sides]))


def only_points(path):
    import pyvista

    pyvista.PolyData(FEMUR[0]).save(path)


CASES = {
    "no file": ("a.stl", lambda _path: None, "", "there is no such file"),
    "a folder": ("a.stl", lambda path: path.mkdir(), "", "is a folder"),
    "another kind": ("a.step", text("x"), "", "must end with one of .stl, .ply, .obj, .vtp"),
    **{
        f"cut-off {kind}": (f"a{kind}", cut_off, "", f"read as a {kind}")
        for kind in (".stl", ".ply", ".vtp")
    },
    "no faces": ("a.vtp", only_points, "", "points but no faces"),
    "garbage cloud": (
        "a.txt",
        text("1 2 3\n1 two 3\n"),
        "",
        "commas: could not convert string 'two'",
    ),
    "empty": ("a.txt", text("# x y z\n"), "", "commas: it has 0 rows"),
    "decimal commas": ("a.txt", text("0,01 -0,02 0,018\n" * 20), "", "with decimal points, "),
    "nan": ("a.xyz", text("0 0 nan\n" * 20), "", "has a point that is not finite"),
    "garbage map": ("a.nii", text("no image"), "", "cannot be read"),
    "no label": ("a.nii", label_map, "", "needs --label N: it has the labels 1, 4"),
    "label": ("a.stl", mesh(), "--label 2", "is not a label map"),
    "in m": ("a.stl", mesh(), "--unit mm", "likely it is in m, --unit m"),
    "divided twice": ("a.ply", mesh(FEMUR, 1e3), "", "scale it to m or mm first"),
    "beside the mesh": ("a.stl", mesh(), "--slice 12", "--slice 12 misses"),
    "wrong compartment": (
        "a.stl",
        mesh(),
        "--slice auto --compartment lateral",
        "nothing on the lateral side",
    ),
    "no number": (
        "a.stl",
        mesh(),
        "--slice medial",
        "--slice medial: it must be a place in mm",
    ),
    "tibia as femur": ("a.stl", mesh(TIBIA), "", "plausible is 0.35 or more: --side tibia?"),
    "a trochlea": (
        "a.stl",
        mesh(swept(femoral_curve(((0.030, -110.0, 10.0),)))),
        "",
        "normals of -110° to 10°",
    ),
    "in cm as mm": (
        "a.stl",
        mesh(LARGE, 1e-2),
        "--unit mm --slice -2.88",
        "mm, plausible is 12 or more: is --unit right?",
    ),
    "another plane": (
        "a.stl",
        mesh(swept(femoral_curve(SMALL))),
        "",
        "12 or more: is --unit right? see --axes",
    ),
    "radii that grow": (
        "a.stl",
        mesh(swept(femoral_curve(GROWING))),
        "",
        "plausible is 0 to 1.2: are front and back exchanged (then",
    ),
    "against the header": (
        "a.stl",
        lambda path: spaced(path, (SCANNER, FEMUR[1]), "RAS"),
        "--axes=-y,z,-x",
        "exchanges front and back: the header of a.stl says SPACE=RAS, where a right knee's are",
    ),
    "a far origin": (
        "a.stl",
        mesh(),
        "--origin 0,80",
        ".stl, --origin 0,80: the distance of the condyle",
    ),
    "a tibia's far origin": (
        "a.stl",
        mesh(TIBIA),
        "--side tibia --origin 0,150",
        "plateau is 149",
    ),
    "no orientation": (
        "a.nii",
        unoriented,
        "--label 4",
        "has no orientation (its sform and qform codes are 0)",
    ),
    "no directions": (
        "a.nrrd",
        lambda path: replaced(other_map(path, "raw"), b"space: left-posterior-superior\n", b""),
        "--label 4",
        "has no orientation (it has no space directions)",
    ),
    "no matrix": (
        "a.mha",
        lambda path: replaced(other_map(path, "raw"), b"TransformMatrix", b"Comment"),
        "--label 4",
        "has no orientation (it has no TransformMatrix)",
    ),
    "a pipe's voxels": (
        "a.nhdr",
        beside("pipe"),
        "",
        "cannot be read: [Errno 22] it is no regular file: 'pipe'",
    ),
    "a device's voxels": (
        "a.mhd",
        beside("/dev/zero"),
        "",
        "it names /dev/zero, and may name only a file beside it",
    ),
    "words for voxels": (
        "a.nhdr",
        beside("words", "ascii"),
        "",
        "its data are not the 655360 numbers of a text\n",
    ),
    "half a map": (
        "a.nrrd",
        lambda path: path.write_bytes(other_map(path, "raw").read_bytes()[:9999]),
        "",
        "cannot be read: it has",
    ),
    "another type": (
        "a.mha",
        lambda path: replaced(other_map(path, "raw"), b"MET_SHORT", b"MET_STRING"),
        "",
        "cannot be read: data type 'string' not understood",
    ),
    "garbage NRRD": ("a.nrrd", text("no map"), "", "it does not begin with NRRD"),
    "a hollow of 8 mm": (
        "a.stl",
        mesh(swept((femoral_curve()[0] - HOLLOW, femoral_curve()[1]))),
        "",
        "is no condyle of a femur: its RMS distance from any profile",
    ),
    "half a contour": (
        "a.txt",
        halves,
        "",
        "too few points around the slice to tell the profile (",
    ),
    "bone outside": (
        "a.stl",
        mesh(BONE, bone=FEMUR),
        "--bone bone.stl",
        "is not behind the cartilage",
    ),
    "bone elsewhere": (
        "a.stl",
        mesh(bone=(FEMUR[0] + [0.0, 0.0, 0.05], FEMUR[1])),
        "--bone bone.stl",
        "misses --bone",
    ),
    "LPS for RAS": (
        "a.stl",
        mesh((KNEE[:, [2, 0, 1]] * [-1.0, -1.0, 1.0], FACES)),
        "--axes=y,z,x",
        "z = 8.0 to 28.0 mm; or see --axes",
    ),
    "upside down": ("a.stl", mesh((KNEE * [1.0, -1.0, 1.0], FACES)), "", "looks up"),
    "femur as tibia": ("a.stl", mesh((KNEE, FACES)), "--side=tibia", "--side femur"),
    "a tibia upside down": (
        "a.stl",
        mesh((TIBIA[0] * [1.0, -1.0, 1.0], TIBIA[1])),
        "--side=tibia",
        "upside down",
    ),
    "origin": (
        "a.stl",
        mesh(),
        "--origin here",
        "--origin here: it must be mesh or X,Y in mm",
    ),
    "no suffix": ("a.stl", mesh(), "--output b.stl", "must end with .csv"),
}


ALL_FILES = """
import sys
from knee_contact_ros.commands.main import main
for name in sys.argv[1:]:
    assert main(["fit-profile", name, "--slice=0", f"--output={name}.csv"]) == 2
"""


def test_vtk_prints_nothing_about_a_damaged_file(tmp_path):
    """In a process of its own, as pytest takes what goes through Python's logging."""
    files = []
    for kind in (".vtk", ".vtp"):
        half = saved(tmp_path / f"a{kind}", FEMUR).read_bytes()[:50_000]
        for name, content in (("empty", b""), ("half", half)):
            path = tmp_path / f"{name}{kind}"
            path.write_bytes(content)
            files.append(str(path))
    command = [sys.executable, "-c", ALL_FILES, *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    lines = done.stderr.splitlines()
    assert [each for each in files if sum(each in line for line in lines) != 1] == []
    assert len(lines) == len(files), lines


@pytest.mark.parametrize("case", CASES)
def test_one_line_says_what_is_wrong(case, tmp_path, capsys, monkeypatch):
    name, make, options, words = CASES[case]
    for folder in ("in", "out"):
        (tmp_path / folder).mkdir()
    monkeypatch.chdir(tmp_path / "in")
    make(Path(name))
    assert (
        main(["fit-profile", name, "--slice", "-18", "--output", "../out/a.csv", *options.split()])
        == 2
    )
    told = capsys.readouterr()
    assert words in told.err
    assert len(told.err.splitlines()) == 1
    assert told.out == ""
    assert not list((tmp_path / "out").iterdir())


def test_an_existing_profile_stays(tmp_path, capsys):
    output = tmp_path / "b.csv"
    output.write_text("mine")
    mesh = saved(tmp_path / "a.stl", FEMUR)
    arguments = ["fit-profile", str(mesh), "--slice=-18", f"--output={output}"]
    assert main(arguments) == 2
    assert "b.csv exists already; choose another name, or --overwrite" in capsys.readouterr().err
    assert output.read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert output.read_text().startswith("# Femur profile")
