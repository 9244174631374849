"""Residuals and reserves beside what the literature allows, on files with known peaks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.opensim.command import judge, show_checks
from knee_contact_ros.lab.opensim.pipeline import Check, Run, assess, read_setup
from tests.lab.opensim.storages import write_storage

ACTUATORS = """<D><ForceSet><defaults>
<CoordinateActuator name="default"><coordinate>hip</coordinate></CoordinateActuator></defaults><objects>
<PointActuator name="FX"/><PointActuator name="FY"/><TorqueActuator name="MZ"/>
<CoordinateActuator name="pelvis_tz_actuator"><coordinate> pelvis_tz </coordinate></CoordinateActuator>
<CoordinateActuator name="knee_reserve"><coordinate>knee_angle_r</coordinate></CoordinateActuator>
<CoordinateActuator name="hip_reserve"><coordinate>hip_flexion_r</coordinate></CoordinateActuator>
<CoordinateActuator name="toe_reserve"><coordinate>mtp_angle_r</coordinate></CoordinateActuator>
<CoordinateActuator name="off"><coordinate>ankle_angle_r</coordinate></CoordinateActuator></objects></ForceSet></D>"""
LOADS = """<D><ExternalLoads><objects><ExternalForce><force_identifier> right_v </force_identifier></ExternalForce>
<ExternalForce><force_identifier>left_v</force_identifier></ExternalForce></objects><datafile>grf.mot</datafile>
</ExternalLoads></D>"""
TIME = np.array([0.0, 0.5, 1.0])


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """400 N and 500 N on the feet in the middle, centre of mass at 1 m; before and after it the ground presses more."""
    (tmp_path / "act.xml").write_text(ACTUATORS)
    (tmp_path / "grf.xml").write_text(LOADS)
    (tmp_path / "cmc.xml").write_text(
        "<D><CMCTool name='walk'><force_set_files>act.xml</force_set_files>"
        "<external_loads_file>grf.xml</external_loads_file></CMCTool></D>"
    )
    (tmp_path / "ik.xml").write_text("<D><InverseKinematicsTool name='i'/></D>")
    feet = {f"{side}_v{axis}": np.zeros(5) for side in ("right", "left") for axis in "xyz"}
    feet |= {"right_vy": np.array([9e3, 0.0, 400.0, 0.0, 9e3]), "left_vy": np.array([0.0, 0.0, 500.0, 0.0, 0.0])}
    write_storage(tmp_path / "grf.mot", np.array([-1.0, 0.0, 0.5, 1.0, 2.0]), feet, "yes")
    columns = {"soleus_r": [900.0] * 3, "FX": [3.0, 0.0, 0.0], "FY": [4.0, 0.0, 0.0], "MZ": [0.0, -10.0, 0.0],
               "pelvis_tz_actuator": [12.0, 0.0, 0.0], "knee_reserve": [0.0, 1.0, -3.0], "hip_reserve": [0.0, 6.0, 0.0],
               "toe_reserve": [0.9, 0.0, 0.0]}  # fmt: skip
    forces = write_storage(tmp_path / "f.sto", TIME, {name: np.array(column) for name, column in columns.items()}, "no")
    net = {"knee_angle_r_moment": np.array([0.0, 80.0, 0.0]), "hip_flexion_r_moment": np.array([0.0, 0.0, -100.0]),
           "mtp_angle_r_moment": np.array([0.0, 0.1, 0.0])}  # fmt: skip
    moments = write_storage(tmp_path / "m.sto", TIME, net, "no")
    centre = write_storage(tmp_path / "c.sto", TIME, {"center_of_mass_Y": np.array([0.99, 1.0, 1.01])}, "no")
    errors = {"marker_error_RMS": np.array([0.01, 0.015, 0.01]), "marker_error_max": np.array([0.02, 0.05, 0.01])}
    write_storage(tmp_path / "i_ik_marker_errors.sto", TIME, errors)
    muscles, kinematics = (read_setup(tmp_path / name) for name in ("cmc.xml", "ik.xml"))
    assert muscles is not None
    assert kinematics is not None
    return Run(
        tmp_path, muscles, forces, tmp_path, tmp_path, tmp_path, tmp_path, centre, moments, {}, (kinematics, muscles)
    )


def test_peaks_and_what_is_allowed(run: Run) -> None:
    checks = {check.name: check for check in assess(run)}
    assert list(checks) == ["residual force", "residual moment", "reserve knee_angle_r", "reserve hip_flexion_r",
                            "marker error, RMS of all", "marker error, the worst"]  # fmt: skip
    figures = {name: (check.peak, check.allowed, check.passed) for name, check in checks.items()}
    expected = {
        "residual force": (13.0, 45.0, True),  # of 3, 4 and 12 N; 5 % of 900 N
        "residual moment": (10.0, 9.0, False),  # 1 % of 900 N x 1 m
        "reserve knee_angle_r": (3.0, 4.0, True),  # 5 % of 80 N m; shown although it passes
        "reserve hip_flexion_r": (6.0, 5.0, False),
        "marker error, RMS of all": (15.0, 20.0, True),
        "marker error, the worst": (50.0, 40.0, False),
    }
    for name, (peak, allowed, passed) in expected.items():
        assert figures[name] == (pytest.approx(peak), pytest.approx(allowed), passed)
    assert checks["residual force"].rms == pytest.approx(13.0 / np.sqrt(3.0))


def test_what_is_above_is_said(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    checks = assess(run)
    show_checks(checks)
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("ABOVE") == 3
    assert "Do not trust these results before you know why" in said
    assert said.endswith("residual moment, reserve hip_flexion_r, marker error, the worst.")
    show_checks([check for check in checks if check.passed])
    said = " ".join(capsys.readouterr().out.split())
    assert "within what the literature allows" in said
    assert "ABOVE" not in said


def test_a_run_that_cannot_be_judged_says_why(run: Run, capsys: pytest.CaptureFixture[str]) -> None:
    run.moments.unlink()
    checks, fault = judge(run)
    assert checks == []
    assert str(run.moments) in fault
    show_checks(checks, fault)
    assert capsys.readouterr().out.startswith("Residuals and reserves could not be judged: cannot read")


def test_a_check_in_a_sentence() -> None:
    check = Check("residual force", 50.0, 12.34, 45.0, "N", "5 % of 900 N of external force")
    assert check.sentence() == "residual force: peak 50, RMS 12.3 N, ABOVE 45 (5 % of 900 N of external force)"
