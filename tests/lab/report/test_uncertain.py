"""The report's section on uncertainty."""

from __future__ import annotations

from pathlib import Path

import pytest

import knee_contact_ros
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.report import UNCERTAINTY_COLUMNS
from knee_contact_ros.lab.report.figures import ALL_INPUTS, NUMERICAL_ERROR
from tests.lab.report.pages import check_html, page_of, rows_of, text_of

GIVEN = "axial_load: 5 %\nmedial_share: 0.06\ncontact.stiffness: 20 %\nfemur.radius: 0.002\n"


@pytest.fixture(scope="module")
def deviations(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("deviations") / "sd.yaml"
    path.write_text(GIVEN)
    return path


def test_a_report_says_what_python_says(right_bag: Path, deviations: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    asked = ["report", str(right_bag), "--output", str(out)]
    assert main([*asked, "--uncertainty", str(deviations), "--compare", "osteoarthritis"]) == 0
    rows = rows_of(out / "uncertainty.csv")
    assert tuple(rows[0]) == ("run", *UNCERTAINTY_COLUMNS)
    assert {row["run"] for row in rows} == {"gait2354_right"}  # a comparison has none of its own
    assert [row["input"] for row in rows] == [
        "axial_load",
        "medial_share",
        "contact.stiffness",
        "femur.radius",
        ALL_INPUTS,
        NUMERICAL_ERROR,
    ]
    assert [row["standard_deviation"] for row in rows] == [
        "5 %",
        "0.06",
        "20 %",
        "0.002 m",
        "",
        "",
    ]
    found = knee_contact_ros.uncertainty(right_bag, "healthy", deviations).medial
    at = int(found.rows["load"].argmax())
    expected = [part[0][at] for part in found.parts.values()] + [
        found.depth[at],
        found.rows["error_estimate"][at],
    ]
    # nine digits in the file
    assert [float(row["depth_at_largest_load_um"]) for row in rows] == pytest.approx(
        [1e6 * x for x in expected], 1e-8
    )
    check_html(page_of(out))
    text = text_of(out)
    low, high = (1e3 * edge[at] for edge in found.depth_interval())
    assert f"together the depth lies between {low:.3f} and {high:.3f} mm" in text
    assert (out / "uncertainty_1.png").exists()
    assert main(asked) == 0  # a later report without it takes it away
    assert not list(out.glob("uncertainty*"))
    assert "JCGM" not in text_of(out)


def test_both_compartments_of_a_recording(
    right_bag: Path, deviations: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "both.mcap"
    sources = ["--params", "healthy", "--params", "both_compartments"]
    assert main(["solve", str(right_bag), *sources, "--output", str(recording)]) == 0
    out = tmp_path / "out"
    assert (
        main(["report", str(recording), "--output", str(out), "--uncertainty", str(deviations)])
        == 0
    )
    shares = [row for row in rows_of(out / "uncertainty.csv") if row["input"] == "medial_share"]
    assert [row["run"] for row in shares] == ["both medial", "both lateral"]
    medial, lateral = (float(row["force_at_largest_load_N"]) for row in shares)
    assert medial == pytest.approx(
        -lateral, rel=0.01
    )  # quasi-static: what one gains the other loses
    assert (out / "uncertainty_2.png").exists()
    assert "femur.profile: femur_medial.csv, femur_lateral.csv" in text_of(out)
