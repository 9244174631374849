"""What makes no sense is told: in parameters, in depths, in a load of the wrong sign; and nothing else is."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.build import build_model, load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.watch import Doubts, doubts_about
from tests.offline.test_solve import make_bag

TYPED = {"contact.stiffness": 2500.0}
"""N/mm^1.5 for N/m^1.5"""
FIFTH = r"beyond 6\.8 mm, a fifth of the femoral radius"
HALF = r"under 368\.5 N \(0\.5 body weights\)"
MILLISECOND = 1_000_000


def doubts(**values: Any) -> Doubts:
    """Those about parameters, `__` standing for a dot."""
    parameters = load_parameters({name.replace("__", "."): value for name, value in values.items()})
    return doubts_about(parameters, build_model(parameters))


def test_the_defaults_and_all_shipped_files_make_sense(config: Path) -> None:
    combinations = [[], ["healthy.yaml"], ["osteoarthritis.yaml"]]
    combinations += [[*files, knee] for files in combinations[1:] for knee in ("mri_femur.yaml", "mri_knee.yaml")]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for files in combinations:
            knee_contact_ros.load_model([config / name for name in files])
    for name in ("elastic_foundation", "two_layer_viscoelastic", "flores"):
        assert doubts(contact__law=name).sentences == []
    assert doubts(contact__stiffness_from="material").sentences == []


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (TYPED, rf"^contact\.stiffness 2500 N/m\^1\.5 gives 279 mm of depth {HALF}, {FIFTH}; "
                r"2500 N/mm\^1\.5 would be 7\.905694e\+07 N/m\^1\.5$"),
        ({"pairing.angle_delay": 0.12},
         r"^pairing\.wait 0\.1 s does not exceed pairing\.angle_delay 0\.12 s: live, the node answers every force .* "
         r"\(INPUT_HELD\)$"),
        (TYPED | {"load.compartment": "total"}, r"under 737\.1 N \(1 body weights\), "),
        (TYPED | {"load.compartment": "moment_balance"}, HALF),
        (TYPED | {"load.share": 0.7}, r"under 515\.9 N \(0\.7 body weights\), "),
        ({"contact.law": "elastic_foundation", "contact.youngs_modulus": 24.0},
         rf"^contact\.youngs_modulus 24 Pa gives 466 mm of depth {HALF}, beyond 4\.4 mm, the cartilage's thickness; "
         r"24 MPa would be 2\.4e\+07 Pa$"),
        ({"contact.stiffness_from": "material", "contact.youngs_modulus": 24.0},
         rf"^contact\.youngs_modulus 24 Pa gives 1\.94e\+04 mm of depth {HALF}, {FIFTH}; 24 MPa would"),
        ({"contact.law": "two_layer_elastic", "contact.stiffness_2": 98408.0},
         r"^contact\.stiffness_2 98408 N/m\^1\.5 is below contact\.stiffness, 7\.905694e\+07: bone softer "
         r"than cartilage; 98408 N/mm\^1\.5 would be 3\.111934e\+09 N/m\^1\.5$"),
        ({"contact.law": "two_layer_elastic", "contact.stiffness": 2500.0, "contact.stiffness_2": 98408.0},
         r"^contact\.stiffness 2500 N/m\^1\.5 gives 24\.6 mm .*; 2500 N/mm\^1\.5 would be 7\.905694e\+07"),
        ({"body_weight": 75.0}, r"^body_weight 75 N: is it kg\? 75 kg weigh 735\.5 N$"),
    ],
)  # fmt: skip
def test_parameters_in_another_unit_are_told_in_a_sentence(values: dict[str, Any], words: str) -> None:
    with pytest.warns(UserWarning, match=words) as told:
        knee_contact_ros.load_model(values)
    assert len(told) == 1
    assert "\n" not in str(told[0].message)
    assert told[0].filename == __file__  # where the user called


def answers(stamps: np.ndarray, loads: np.ndarray, **others: np.ndarray) -> dict[str, np.ndarray]:
    """Fields of answers that `Doubts` looks at; the others are 0."""
    nothing = np.zeros(len(stamps))
    names = ("flexion_angle", "penetration_depth", "gap", "contact_point_x")
    fields = dict.fromkeys(names, nothing) | {"status": nothing.astype(int)}
    return fields | {"stamp": stamps, "load": loads} | others


@pytest.mark.parametrize("compiled", [False, True])
def test_an_angle_and_a_contact_that_no_knee_has_say_so(compiled: bool) -> None:
    """A knee turned by a whole turn, and one whose femur's origin is at the hip: on no plateau."""
    time, load = np.arange(200) * 0.01, np.full(200, 700.0)
    model = load_model(compiled=compiled)
    angle = np.linspace(-0.6, 3.2, 200)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        flagged = (model.run(time, angle, load).status & Status.IMPLAUSIBLE) != 0
    degrees = np.degrees(angle)
    assert flagged.tolist() == ((degrees < -30.0) | (degrees > 170.0)).tolist()
    points = np.array([0.061, -0.5, 0.059, 0.061])
    watch = Doubts()
    status = np.array([32, 32, 0, 0])
    watch.add_all(answers(np.arange(4), np.ones(4), penetration_depth=np.array([1e-4, 1e-4, 1e-4, 0.0]), status=status)
                  | {"contact_point_x": points})  # fmt: skip
    assert watch.sentences[0].startswith(
        "the contact is up to 500 mm ahead of the tibia's origin or behind it, outside"
    )
    assert "in 2 of 4 ticks (IMPLAUSIBLE)" in watch.sentences[0]
    assert (watch.too_deep, watch.flown) == (0, 0)


def test_solve_says_it_on_the_terminal_and_in_its_table(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out.mcap"
    arguments = [str(right_bag), "-p", "contact.stiffness:=2500", "-p", "body_weight:=75.16", "--output", str(output)]
    assert main(["solve", *arguments]) == 0
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    assert [line.partition(" warning: ")[2].split()[0] for line in lines] == ["body_weight", "contact.stiffness", "387"]
    assert lines[2].startswith(
        "knee-contact: warning: 387 of 387 ticks are up to 359 mm deep, beyond 6.8 mm, a fifth of"
    )
    assert "387 x IMPLAUSIBLE" in printed.out
    words = " ".join(printed.out.split())
    for line in lines:
        assert f"warning {line.partition(' warning: ')[2][:30]}" in words


def test_solve_tells_of_an_offset_and_marks_the_peaks_of_a_landing(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = str(tmp_path / "out.mcap")
    assert main(["solve", str(right_bag), "-p", "knee.flexion_offset:=5.0", "--output", output]) == 0
    said = capsys.readouterr().err
    assert "ticks are beyond, IMPLAUSIBLE): does it have an offset (knee.flexion_offset, in rad), or is it in" in said
    assert said.count("\n") == 1
    loads = [-200.0 if 50 <= i < 60 else 900.0 for i in range(121)]
    thrown = make_bag(tmp_path / "thrown.mcap", [(i * 10 * MILLISECOND, 0.1, load) for i, load in enumerate(loads)])
    assert main(["solve", str(thrown), "--output", str(tmp_path / "thrown_out.mcap")]) == 0
    printed = capsys.readouterr()
    assert "largest !" in printed.out
    assert "! from an answer that is IMPLAUSIBLE" in printed.out
    assert "mm above the tibia, beyond 10 mm:" in printed.err
