"""A comparison changes the contact law and nothing else, and says what that is; runs are told apart by their names."""

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.report.runs import differences
from knee_contact_ros.parameters.files import load_parameters
from tests.lab.report.pages import numbers, runs_of, text_of

pytest.importorskip(
    "matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7"
)
HEAVY = {
    "body_weight": 931.6,
    "load.share": 0.6,
    "femur.radius": 0.036,
    "femur.mass": 11.8,
    "contact.damping": 4000.0,
}
WHOLE = """/**/knee_contact:
  ros__parameters:
    body_weight: 700.0
    load: {share: 0.5}
    femur: {radius: 0.03}
    fidelity: {tolerance: 1.0e-7}
    record: {path: elsewhere}
    contact: {law: hertz, stiffness: 5.0e+7}
"""


def test_a_heavy_subject_stays_itself(bags, tmp_path, report, capsys):
    """95 kg, a share of 0.6 and a femur of his own: the peaks in BW are the same, whatever the file sets beside."""
    whole = tmp_path / "whole.yaml"
    whole.write_text(WHOLE)
    subject = [text for name, value in HEAVY.items() for text in ("-p", f"{name}:={value}")]
    out = report(bags[0], *subject, "--compare", whole)
    own, other = runs_of(out / "peaks.csv").values()
    assert [row["load_BW"] for row in own] == [row["load_BW"] for row in other]
    for row in (own[1], other[1]):  # of the shipped right knee 0.5 of it are 1556.9 N
        load = float(row["load_BW"])
        assert load == pytest.approx(1556.9 / 0.5 * 0.6 / 931.6, abs=1e-4)
        assert float(row["contact_force_BW"]) == pytest.approx(load, abs=0.05)  # hertz rings
    assert own[1]["penetration_depth_mm"] != other[1]["penetration_depth_mm"]
    kept = "body_weight 931.6 (not 700)"
    assert kept in text_of(out)
    assert kept in capsys.readouterr().err


@pytest.mark.parametrize(
    ("values", "lines"),
    [
        (
            {"contact.layer_depth": 1e-3, "deadline": 0.2},
            [],
        ),  # which the law does not use, and no answer depends on
        ({"contact.damping": 0.0}, ["contact.damping: 5000 → 0 N s/m"]),
        (
            {"contact.stiffness_from": "material"},
            ["contact.stiffness: 7.90569e+07 → 4.30314e+06 N/m^n"],
        ),
        ({"contact.allow_tension": True}, ["contact.allow_tension: no → yes"]),
        (
            {"body_weight": 800.0, "contact.law": "hertz"},
            [
                "body_weight: 737.068 → 800 N",
                "contact.law: kelvin_voigt → hertz",
                "contact.damping: 5000 → – N s/m",
            ],
        ),
    ],
)
def test_differences_count_as_far_as_they_are_used(values, lines):
    assert differences([load_parameters({}), load_parameters(values)], " → ") == lines


def test_files_of_one_name_have_numbers_also_when_their_laws_differ(
    bags, recording, tmp_path, report
):
    healthy = tmp_path / recording.name
    assert main(["solve", str(bags[0]), "--params=healthy", f"--output={healthy}"]) == 0
    out = report(healthy, recording, "--compare=osteoarthritis.yaml")
    runs = runs_of(out / "peaks.csv")
    names = [label.split(",")[0] for label in runs]
    assert names == ["knee (1)", "knee (1)", "knee (2)", "knee (2)"]
    assert all(len(numbers(rows, "load_N")) == 4 for rows in runs.values())
