"""The report's section on uncertainty."""

import pytest

import knee_contact_ros
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.report import UNCERTAINTY_COLUMNS
from knee_contact_ros.lab.report.figures import ALL_INPUTS, NUMERICAL_ERROR
from tests.lab.report.pages import check_html, page_of, rows_of, runs_of, text_of

INPUTS = {
    "axial_load": "5 %",
    "medial_share": "0.06",
    "contact.stiffness": "20 %",
    ALL_INPUTS: "",
    NUMERICAL_ERROR: "",
}
"""Inputs and their standard deviations"""


def test_a_report_has_the_numbers_of_the_python_interface(right_bag, deviations, report):
    out = report(right_bag, "--uncertainty", deviations, "--compare=osteoarthritis")
    rows = rows_of(out / "uncertainty.csv")
    assert {row["run"] for row in rows} == {"gait2354_right"}  # a comparison has none of its own
    assert tuple(rows[0]) == ("run", *UNCERTAINTY_COLUMNS)
    assert {row["input"]: row["standard_deviation"] for row in rows} == INPUTS
    found = knee_contact_ros.uncertainty(right_bag, "healthy", deviations).medial
    at = int(found.rows["load"].argmax())
    effects = [part for each, (part, _) in found.parts.items() if each.name in INPUTS]
    effects += [found.depth, found.rows["error_estimate"]]
    # nine digits in the file
    assert [float(row["depth_at_largest_load_um"]) for row in rows] == pytest.approx(
        [1e6 * effect[at] for effect in effects], 1e-8
    )
    low, high = (1e3 * edge[at] for edge in found.depth_interval())
    assert f"together the depth lies between {low:.3f} and {high:.3f} mm" in text_of(out)
    # a circle on a level plane is as deep with any radius
    assert "Without effect on depth and force, and left out: femur.radius (0.002 m)." in text_of(
        out
    )
    assert (out / "uncertainty_1.png").exists()
    check_html(page_of(out))


def test_a_constant_that_the_law_does_not_use_is_named_and_not_ranked(right_bag, tmp_path, report):
    worn, deviations = tmp_path / "worn.mcap", tmp_path / "layer.yaml"
    assert main(["solve", str(right_bag), "--params=osteoarthritis", f"--output={worn}"]) == 0
    deviations.write_text("contact.layer_depth: 10 %\ncontact.stiffness: 20 %\n")
    out = report(right_bag, worn, "--uncertainty", deviations)
    inputs = {
        run: {row["input"]: row for row in rows}
        for run, rows in runs_of(out / "uncertainty.csv").items()
    }
    assert "contact.layer_depth" not in inputs["gait2354_right"]
    assert float(inputs["worn"]["contact.layer_depth"]["depth_at_largest_load_um"]) > 10.0
    told = "Without effect on depth and force, and left out: contact.layer_depth (10 %)."
    assert text_of(out).count(told) == 1
    with pytest.warns(
        UserWarning, match=r"^contact\.layer_depth has no effect under contact\.law kelvin_voigt$"
    ):
        found = knee_contact_ros.uncertainty(right_bag, "healthy", deviations).medial
    assert [each.name for each in found.without_effect] == ["contact.layer_depth"]
    assert repr(found).endswith("of contact.stiffness; without effect: contact.layer_depth>")


def test_both_compartments_of_a_recording(right_bag, deviations, tmp_path, report):
    recording = tmp_path / "both.mcap"
    sources = ["--params=healthy", "--params=both_compartments", f"--output={recording}"]
    assert main(["solve", str(right_bag), *sources]) == 0
    out = report(recording, "--uncertainty", deviations)
    shares = [row for row in rows_of(out / "uncertainty.csv") if row["input"] == "medial_share"]
    assert [row["run"] for row in shares] == ["both medial", "both lateral"]
    medial, lateral = (float(row["force_at_largest_load_N"]) for row in shares)
    # quasi-static: what one gains the other loses
    assert medial == pytest.approx(-lateral, rel=0.01)
    assert (out / "uncertainty_2.png").exists()
    assert (
        "femur.profile: both medial femur_medial.csv, both lateral femur_lateral.csv"
        in text_of(out)
    )
