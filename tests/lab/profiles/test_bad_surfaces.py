"""What cannot be fitted is told in one line, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import not_installed
from tests.lab.profiles.meshes import femoral_curve, saved, swept, tibial_curve

pytest.importorskip("pyvista", reason="needs the extra mesh")
pytest.importorskip("trimesh")
pytest.importorskip("matplotlib")
nibabel = pytest.importorskip("nibabel")

FEMUR, TIBIA = swept(femoral_curve()), swept(tibial_curve())


def text(content: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(content)


def mesh(shape: tuple[Any, Any], unit: float = 1.0) -> Callable[[Path], Any]:
    return lambda path: saved(path, shape, unit)


def cut_off(path: Path) -> None:
    content = saved(path, FEMUR).read_bytes()
    path.write_bytes(content[: len(content) // 2])


def turned_over(shape: tuple[Any, Any]) -> tuple[Any, Any]:
    return shape[0] * [1.0, -1.0, 1.0], shape[1]


def only_points(path: Path) -> None:
    import pyvista

    pyvista.PolyData(FEMUR[0]).save(path)


CASES = {
    "no file": ("a.stl", lambda _path: None, [], "there is no such file"),
    "another kind": ("a.step", text("x"), [], "must end with one of .stl, .ply, .obj, .vtp"),
    "garbage STL": ("a.stl", text("no mesh"), [], "cannot be read as a .stl file, or has no faces"),
    "empty STL": ("a.stl", text("solid a\nendsolid a\n"), [], "cannot be read as a .stl file, or has no faces"),
    "garbage PLY": ("a.ply", text("no mesh"), [], "cannot be read as a .ply file"),
    "garbage VTP": ("a.vtp", text("<no mesh"), [], "cannot be read as a .vtp file"),
    **{f"cut-off {kind}": (f"a{kind}", cut_off, [], f"read as a {kind}") for kind in (".stl", ".ply", ".vtp")},
    "no faces": ("a.vtp", only_points, [], "points but no faces"),
    "garbage cloud": ("a.txt", text("1 2 3\n1 two 3\n"), [], "it has a line '1 two 3'"),
    "one column": ("a.xyz", text("1\n2\n"), [], "it has [1] columns"),
    "nan": ("a.xyz", text("0 0 nan\n" * 20), [], "has a point that is not finite"),
    "in mm": ("a.stl", mesh(FEMUR, 1e-3), [], "with --unit m; cartilages and bones of a knee measure 0.008 to 0.7 m: "
              "likely it is in mm, --unit mm"),
    "in m": ("a.stl", mesh(FEMUR), ["--unit", "mm"], "likely it is in m, --unit m"),
    "divided twice": ("a.ply", mesh(FEMUR, 1e3), [], "scale it to m or mm first"),
    "beside the mesh": ("a.stl", mesh(FEMUR), ["--slice", "12"], "--slice 12 misses"),
    "its range": ("a.stl", mesh(FEMUR), ["--slice", "12"], "which reaches from z = -28.0 to -8.0 mm"),
    "wrong compartment": ("a.stl", mesh(FEMUR), ["--slice", "auto", "--compartment", "lateral"],
                          "nothing on the lateral side"),
    "no number": ("a.stl", mesh(FEMUR), ["--slice", "medial"], "--slice medial: it must be a place in mm"),
    "tibia as femur": ("a.stl", mesh(TIBIA), [], "as flat as a tibial plateau: --side tibia?"),
    "femur as tibia": ("a.stl", mesh(FEMUR), ["--side", "tibia"], "as round as a femoral condyle: --side femur?"),
    "a trochlea": ("a.stl", mesh(swept(femoral_curve(((0.030, -110.0, 10.0),)))), [], "normals of -110° to 10°"),
    "a folder": ("a.stl", lambda path: path.mkdir(), [], "is a folder"),
    "upside down": ("a.stl", mesh(turned_over(FEMUR)), [], "looks up, not down: see --axes"),
    "axes": ("a.stl", mesh(FEMUR), ["--axes", "x,x,z"], "--axes x,x,z: it must name"),
    "label": ("a.stl", mesh(FEMUR), ["--label", "2"], "is no label map"),
    "origin": ("a.stl", mesh(FEMUR), ["--origin", "here"], "--origin here: it must be mesh or X,Y in mm"),
    "few points": ("a.xyz", text("0 0 0\n0.02 0.01 0.03\n" * 10), [], "only 0 points of"),
    "garbage map": ("a.nii", text("no image"), [], "cannot be read"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_one_line_says_what_is_wrong(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name, make, options, words = CASES[case]
    source = tmp_path / "in" / name
    source.parent.mkdir()
    make(source)
    options = options if "--slice" in options else ["--slice", "-18", *options]
    (tmp_path / "out").mkdir()
    assert main(["fit-profile", str(source), *options, "--output", str(tmp_path / "out" / "a.csv")]) == 2
    told = capsys.readouterr()
    assert words in told.err
    assert len(told.err.splitlines()) == 1
    assert told.out == ""
    assert not list((tmp_path / "out").iterdir())


def test_an_existing_profile_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = saved(tmp_path / "a.stl", FEMUR)
    output = tmp_path / "b.csv"
    output.write_text("mine")
    arguments = ["fit-profile", str(source), "--slice", "-18", "--output", str(output)]
    assert main(arguments) == 2
    assert "b.csv exists already; choose another name, or --overwrite" in capsys.readouterr().err
    assert output.read_text() == "mine"
    assert main([*arguments, "--overwrite"]) == 0
    assert output.read_text().startswith("# Femur profile")
    assert main(["fit-profile", str(source), "--slice", "-18", "--output", str(tmp_path / "a.stl")]) == 2
    assert "must end with .csv" in capsys.readouterr().err


def test_what_is_no_condyle_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Round as a condyle, but with a hollow of 8 mm."""
    points, normals = femoral_curve()
    hollow = 0.008 * np.exp(-(np.linspace(-9.0, 9.0, len(points)) ** 2))
    source = saved(tmp_path / "a.stl", swept((points - normals * hollow[:, None], normals)))
    assert main(["fit-profile", str(source), "--slice", "-18", "--output", str(tmp_path / "b.csv")]) == 2
    assert "is no convex condyle: no profile comes closer" in capsys.readouterr().err


def test_a_bone_must_be_behind_the_cartilage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cartilage = saved(tmp_path / "a.stl", FEMUR)
    bone = saved(tmp_path / "b.stl", swept(femoral_curve(), inwards=0.002))
    swapped = [
        "fit-profile",
        str(bone),
        "--bone",
        str(cartilage),
        "--slice",
        "-18",
        "--output",
        str(tmp_path / "c.csv"),
    ]
    assert main(swapped) == 2
    assert "is not behind the cartilage" in capsys.readouterr().err
    far = saved(tmp_path / "d.stl", (FEMUR[0] + [0.0, 0.0, 0.05], FEMUR[1]))
    arguments = [
        "fit-profile",
        str(cartilage),
        "--bone",
        str(far),
        "--slice",
        "-18",
        "--output",
        str(tmp_path / "c.csv"),
    ]
    assert main(arguments) == 2
    assert "misses --bone" in capsys.readouterr().err


def test_a_missing_library_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda _name: None)
    arguments = ["fit-profile", str(tmp_path / "a.stl"), "--slice", "-18", "--output", str(tmp_path / "c.csv")]
    assert main(arguments) == 2
    assert not_installed("pyvista", "mesh") in capsys.readouterr().err
