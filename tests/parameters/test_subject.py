"""Subject files: what they set, what wins, and what is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.offline.solve import Subject
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.errors import UsageError


def subject(folder: Path, text: str) -> Path:
    path = folder / "subject.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_generic_model_is_the_papers(tmp_path: Path) -> None:
    parameters = load_parameters(Subject(subject(tmp_path, "mass: 75.16\n")).sources())
    assert parameters.body_weight == pytest.approx(737.068, abs=5e-4)  # as the parameter files round it
    assert parameters.femur.mass == pytest.approx(9.3014, rel=1e-12)
    scaled = load_parameters(Subject(subject(tmp_path, "mass: 72.6\n")).sources())
    assert scaled.femur.mass == pytest.approx(8.984, abs=1e-3)  # OpenSim's own scaling of this model
    assert scaled.body_weight == pytest.approx(711.963, abs=1e-3)


def test_all_that_it_may_say(tmp_path: Path, config: Path) -> None:
    shutil.copy(config / "femur_medial.csv", tmp_path / "mine.csv")
    text = """
name: somebody
mass: 60
parameters: [osteoarthritis.yaml]
profile: mine.csv
tibial_profile: tibia_medial.csv
scale: 0.95
thickness: 0.0004
joint: knee_r
bag: gait
"""
    found = Subject(subject(tmp_path, text))
    (tmp_path / "gait").mkdir()
    parameters = load_parameters(found.sources())
    assert found.bag == tmp_path / "gait"
    assert parameters.contact.law == "two_layer_viscoelastic"
    assert parameters.contact.layer_depth == 0.0004
    assert parameters.knee.joint_name == "knee_r"
    assert (parameters.femur.geometry, parameters.femur.profile) == ("profile", str(tmp_path / "mine.csv"))
    assert parameters.tibia.profile == str(config / "tibia_medial.csv")
    assert (parameters.femur.scale, parameters.tibia.scale) == (0.95, 0.95)


def test_solve_takes_it_and_other_values_win(
    tmp_path: Path, right_bag: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = subject(tmp_path, f"mass: 72.6\nthickness: 0.0006\nparameters: [osteoarthritis.yaml]\nbag: {right_bag}\n")
    assert main(["solve", "--subject", str(path), "--output", str(tmp_path / "a.mcap")]) == 0
    assert "2.27" in capsys.readouterr().out  # 1613.8 N in body weights of 711.96 N
    arguments = ["solve", str(right_bag), "--subject", str(path), "-p", "contact.layer_depth:=0.0007"]
    assert main([*arguments, "--output", str(tmp_path / "b.mcap")]) == 0
    first, second = (read_provenance(tmp_path / f"{name}.mcap") for name in "ab")
    assert first is not None
    assert second is not None
    assert (first.parameters.contact.layer_depth, second.parameters.contact.layer_depth) == (0.0006, 0.0007)
    assert first.parameters.femur.mass == second.parameters.femur.mass == pytest.approx(8.984, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a subject file"),
        ("mass", "not a subject file"),
        ("mass: [", "not a YAML file"),
        ("name: x\n", "mass: is missing"),
        ("mass: -3\n", "mass: -3 is not allowed; it should be greater than or equal to 1"),
        ("mass: heavy\n", "mass: 'heavy' is not allowed"),
        ("mass: 70\nthicknes: 1\n", "thicknes: is not known"),
        ("mass: 70\nthickness: 3.0\n", "thickness: 3.0 is not allowed; it should be less than or equal to 0.1"),
        ("mass: 70\nscale: 0\n", "scale: 0 is not allowed"),
        ("mass: 70\nparameters: []\n", "parameters: [] is not allowed"),
        ("mass: 70\nparameters: [none.yaml]\n", "none.yaml"),
    ],
)
def test_what_is_not_allowed_is_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError) as caught:
        Subject(subject(tmp_path, text)).sources()
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_commands_say_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = subject(tmp_path, "mass: 70\n")
    assert main(["solve", "--subject", str(path), "--output", str(tmp_path / "a.mcap")]) == 2
    assert "no BAG: give a BAG, or a --subject file that names one" in capsys.readouterr().err
    assert main(["solve", "--subject", "none.yaml", "--output", str(tmp_path / "a.mcap")]) == 2
    assert "none.yaml: cannot read the subject file" in capsys.readouterr().err
