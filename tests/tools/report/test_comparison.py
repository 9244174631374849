"""A comparison changes the contact law and nothing else, and says what that is."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.parameters.files import flat_parameters, load_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.report.comparison import between, compared, differences, kept, named, overlay
from tests.tools.report.pages import page_of, text_of

pytest.importorskip("matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7")
HEAVY = {"body_weight": 931.6, "load.share": 0.6, "femur.radius": 0.036, "femur.mass": 11.8, "contact.damping": 4000.0}
WHOLE = """/**/knee_contact:
  ros__parameters:
    body_weight: 700.0
    load: {share: 0.5}
    femur: {radius: 0.03}
    fidelity: {tolerance: 1.0e-7}
    record: {path: elsewhere}
    contact: {law: hertz, stiffness: 5.0e+7}
"""


def peaks(folder: Path) -> dict[str, list[dict[str, str]]]:
    """Rows by run."""
    with (folder / "peaks.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {run: [row for row in rows if row["run"] == run] for run in dict.fromkeys(row["run"] for row in rows)}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    path = tmp_path / "whole.yaml"
    path.write_text(WHOLE)
    return path


@pytest.mark.parametrize("file", ["osteoarthritis.yaml", "WHOLE"])
def test_a_heavy_subject_stays_itself(bags: tuple[Path, Path], tmp_path: Path, whole: Path, file: str, capsys) -> None:
    """95 kg, a share of 0.6 and a femur of his own: the peaks in BW are the same, whatever the file sets beside."""
    subject = [text for name, value in HEAVY.items() for text in ("-p", f"{name}:={value}")]
    arguments = ["--compare", str(whole) if file == "WHOLE" else file, "--output", str(tmp_path / "out")]
    assert main(["report", str(bags[0]), *subject, *arguments]) == 0
    (own, other) = peaks(tmp_path / "out").values()
    assert [row["load_BW"] for row in own] == [row["load_BW"] for row in other]
    for row in (own[1], other[1]):  # of the shipped right knee 0.5 of it are 1556.9 N
        assert float(row["load_BW"]) == pytest.approx(1556.9 / 0.5 * 0.6 / 931.6, abs=1e-4)
        assert float(row["contact_force_BW"]) == pytest.approx(float(row["load_BW"]), abs=0.05)  # hertz rings
    assert own[1]["penetration_depth_mm"] != other[1]["penetration_depth_mm"]
    text, told = text_of(page_of(tmp_path / "out")), "body_weight 931.6 (not 700)"
    assert (told in text) == (file == "WHOLE")
    assert (told in capsys.readouterr().err) == (file == "WHOLE")


def test_only_the_contact_law_is_taken(whole: Path) -> None:
    before = load_parameters(HEAVY)
    over = overlay([whole])
    after = compared(before, over)
    assert flat_parameters(after) == flat_parameters(before) | {"contact.law": "hertz", "contact.stiffness": 5.0e7}
    assert kept(before, over) == [
        "body_weight 931.6 (not 700)", "load.share 0.6 (not 0.5)", "femur.radius 0.036 (not 0.03)",
        "fidelity.tolerance 1e-06 (not 1e-07)",
    ]  # fmt: skip
    assert kept(load_parameters({"body_weight": 700, "load.share": 0.5, "femur.radius": 0.03,
                                 "fidelity.tolerance": 1e-7}), over) == []  # fmt: skip
    told = [str(each) for each in differences(before, after)]
    assert told == ["law: kelvin_voigt → hertz", "stiffness: 7.90569e+07 → 5e+07 N/m^n", "damping: 4000 → – N s/m"]


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ({}, ("", "")),
        ({"contact.layer_depth": 1e-3}, ("", "")),  # which the law does not use
        ({"contact.damping": 0.0}, ("damping 5000 N s/m", "damping 0 N s/m")),
        ({"contact.damping": 0.0, "contact.stiffness": 1e8, "contact.exponent": 1.6},
         ("stiffness 7.90569e+07 N/m^n, exponent 1.5, …", "stiffness 1e+08 N/m^n, exponent 1.6, …")),
        ({"contact.stiffness_from": "material"}, ("stiffness 7.90569e+07 N/m^n", "stiffness 4.30314e+06 N/m^n")),
        ({"contact.allow_tension": True}, ("allow_tension no", "allow_tension yes")),
        ({"contact.law": "hertz"}, ("kelvin_voigt", "hertz")),
    ],
)  # fmt: skip
def test_curves_are_named_by_what_differs(values: dict[str, object], names: tuple[str, str]) -> None:
    found = differences(load_parameters({}), load_parameters(values))
    assert (named(found, after=False), named(found, after=True)) == names


def test_a_law_that_nobody_knows_differs_in_all() -> None:
    found = differences(None, load_parameters({}))
    assert str(found[0]) == "law: not told → kelvin_voigt"
    assert named(found, after=False) == "not told"


def test_recordings_with_parameters_of_their_own_say_so() -> None:
    one, other = load_parameters({}), load_parameters({"body_weight": 800.0, "contact.law": "hertz", "deadline": 0.2})
    assert between([one, one]) == []
    assert between([one, other]) == [
        "body_weight: 737.068, 800 N", "contact.law: kelvin_voigt, hertz", "contact.damping: 5000, – N s/m"
    ]  # fmt: skip


def test_a_file_without_a_law_is_refused(bags: tuple[Path, Path], config: Path, tmp_path: Path, capsys) -> None:
    with pytest.raises(UsageError, match=r"mri_femur.yaml: sets no contact\.\* parameter"):
        overlay([config / "osteoarthritis.yaml", config / "mri_femur.yaml"])
    arguments = ["--compare", "mri_femur.yaml", "--output", str(tmp_path / "out")]
    assert main(["report", str(bags[0]), *arguments]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_curves_that_are_the_same_are_said_to_be(bags: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "stiffer.yaml"
    path.write_text("/**/knee_contact: {ros__parameters: {contact: {stiffness: 7.9057e+7}}}\n")
    assert main(["report", str(bags[0]), "--compare", str(path), "--output", str(tmp_path / "out")]) == 0
    text = text_of(page_of(tmp_path / "out"))
    assert text.count("Curves with “=” are the same within") == 4  # force, depth, pressure and patch
    assert "Largest difference" not in text
    path.write_text("/**/knee_contact: {ros__parameters: {contact: {stiffness: 3.0e+7}}}\n")
    assert main(["report", str(bags[0]), "--compare", str(path), "--output", str(tmp_path / "other")]) == 0
    assert "Largest difference of dashed to full: gait2354_right" in text_of(page_of(tmp_path / "other"))


def test_a_file_that_is_given_twice_is_refused(config: Path) -> None:
    """Under any of its names."""
    with pytest.raises(UsageError, match=r"^--compare .*healthy.yaml is given twice$"):
        overlay([Path("healthy"), config / "healthy.yaml"])
