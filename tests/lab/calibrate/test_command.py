"""`knee-contact calibrate`: from a table to a parameter file; and what is wrong with either in one line."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import load_model
from knee_contact_ros.commands.main import main
from knee_contact_ros.parameters.files import values_set_in
from tests.lab.calibrate.trials import START, trial, written

START_VALUES = [f"-p{name}:={value}" for name, value in START.items()]


def run(*arguments: object) -> int:
    return main(["calibrate", *map(str, arguments)])


def test_the_command_writes_parameters_that_others_take(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = written(tmp_path / "trial.csv", trial(1))
    output = tmp_path / "fitted.yaml"
    arguments = (table, *START_VALUES, "--free", "contact.stiffness", "--free", "contact.damping=100:20000",
                 "--output", output)  # fmt: skip
    assert run(*arguments) == 0
    said = capsys.readouterr()
    assert "95 % interval" in said.out
    assert "contact.damping" in said.out
    assert "penetration_depth: RMS" in said.out
    assert f"Parameters: {output}" in said.out
    assert "warning" not in said.err
    values = values_set_in(output)
    assert values["contact.stiffness"] == pytest.approx(7e7, rel=0.01)
    assert set(values) == {"contact.stiffness", "contact.damping"}
    text = output.read_text(encoding="utf-8")
    assert f"# Data: trial.csv, sha256 {hashlib.sha256(table.read_bytes()).hexdigest()}." in text
    assert "healthy.yaml, contact.stiffness 90000000.0" in text
    assert load_model(["healthy", output]).law.layers[0].damping == values["contact.damping"]
    assert run(*arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert run(*arguments, "--overwrite", "--no-intervals", "--sigma", "penetration_depth=3e-6", "--loss", "huber") == 0
    assert "noise given 3e-06 m" in capsys.readouterr().out
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--free", "contact.stifness"], "did you mean contact.stiffness?"),
        (["--free", "fidelity.tolerance"], "--free fidelity.tolerance: it is no parameter that can be fitted; allowed"),
        (["--free", "contact.law"], "--free contact.law: it is no real number; allowed are contact.stiffness"),
        (["--free", "contact.layer_depth"], "nothing depends on it (law kelvin_voigt, femur circle, tibia plane"),
        (["--free", "tibia.radius"], "--free tibia.radius: nothing depends on it"),
        (["--free", "femur.radius"], "around 0.034 it changes nothing of what was measured (penetration_depth)"),
        (["--free", "load.share"], "has no column axial_load, of which it is the share"),
        (["--free", "contact.damping=5000"], "range '5000' is not allowed; two numbers that grow"),
        (["--free", "contact.damping=9:1"], "range '9:1' is not allowed; two numbers that grow"),
        (["--free", "contact.damping=-1:10"], "range -1:10 is not allowed; it must lie in 0 to 1e+09"),
        (["--free", "contact.damping=1:10"], "it starts from 5000, outside of 1 to 10; give another value or range"),
        (["--free", "contact.damping", "--free", "contact.damping"], "--free contact.damping: it is given twice"),
        (["--free", ""], "--free '': it is no parameter"),
        (["--free", "contact.damping", "--sigma", "gap=1e-6"], "--sigma gap: it was not measured; measured are penetr"),
        (["--free", "contact.damping", "--sigma", "penetration_depth"], "it must be COLUMN=NUMBER, the number > 0"),
        (["--free", "contact.damping", "--sigma", "penetration_depth=-1"], "it must be COLUMN=NUMBER, the number > 0"),
        (["--free", "contact.damping", "-p", "drive:=displacement"], "has no column femoral_height, which drive displ"),
        (["--free", "contact.damping", "-p", "contact.dampin:=1"], "unknown parameter contact.dampin"),
        (["--free", "contact.damping", "--params", "none.yaml"], "cannot read the parameter file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    output = tmp_path / "fitted.yaml"
    assert run(written(tmp_path / "trial.csv", trial(1)), "--output", output, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert list(tmp_path.iterdir()) == [tmp_path / "trial.csv"]


GOOD = "time,flexion_angle,load,penetration_depth\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "it has no column time, which drive force needs; it has none"),
        (GOOD, "its columns must be equally long, with one sample or more"),
        (GOOD + "0,0,100,1e-4\n", "1 values are measured, for 1 parameters"),
        (GOOD + "0,0,100,1e-4\n1,0,100\n", "row 2 does not hold 4 numbers or empty cells: 1,0,100"),
        (GOOD + "0,0,100,x\n", "row 1 does not hold 4 numbers or empty cells: 0,0,100,x"),
        (GOOD + "0,0,100,1e-4\n0,0,100,1e-4\n", "column time must increase, by a nanosecond or more; row 2 does not"),
        (GOOD + "0,0,,1e-4\n1,0,100,1e-4\n", "column load is nan in row 1; an input must be known at every sample"),
        (GOOD + "0,0,100,inf\n1,0,100,1e-4\n", "column penetration_depth is inf in row 1; allowed are numbers"),
        (GOOD + "0,0,100,\n1,0,100,\n", "column penetration_depth is empty; leave it out"),
        (GOOD + "0,0,1e7,1e-4\n1,0,100,1e-4\n", "must not exceed 10 rad, 1e+06 N"),
        ("time,flexion_angle,load\n0,0,100\n", "nothing is measured in it; one or more of the columns penetration_d"),
        ("time,flexion_angle,penetration_depth\n0,0,1e-4\n", "it has no column load, which drive force needs"),
        ("time,flexion_angle,load,penetration_dept\n0,0,1,1\n", "penetration_dept is not known; did you mean penetra"),
        ("time,flexion_angle,load,load,gap\n0,0,1,1,1\n", "column load is there twice"),
        ("time,flexion_angle,load,axial_load,gap\n0,0,1,1,1\n", "columns load and axial_load are both there"),
    ],
)
def test_damaged_tables_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, reason: str
) -> None:
    table = tmp_path / "trial.csv"
    table.write_text(content, encoding="utf-8")
    assert run(table, "--free", "contact.stiffness", "--output", tmp_path / "fitted.yaml") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "trial.csv" in line
    assert reason in line


def test_files_that_are_none_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    table, text, folder = (
        "cannot read",
        "not a text file in UTF-8",
        "it is one of the contact, which is fitted to a table",
    )
    for name, reason in (("none.csv", table), ("bytes.csv", text), ("", folder)):
        assert run(tmp_path / name, "--free", "contact.stiffness", "--output", tmp_path / "fitted.yaml") == 2
        assert reason in capsys.readouterr().err
    axial = trial(1)
    axial["axial_load"] = axial.pop("load")
    table = written(tmp_path / "axial.csv", axial)
    rule = ("-p", "load.compartment:=moment_balance")
    assert run(table, *rule, "--free", "contact.stiffness", "--output", tmp_path / "fitted.yaml") == 2
    assert "column axial_load needs load.compartment fixed_share, not moment_balance" in capsys.readouterr().err


def test_python_names_its_arguments() -> None:
    from knee_contact_ros import UsageError, calibrate

    with pytest.raises(UsageError, match=r"^free contact\.dampin: it is no parameter"):
        calibrate(trial(1), "healthy", ["contact.dampin"])
    with pytest.raises(UsageError, match=r"^sigma gap: it was not measured"):
        calibrate(trial(1), "healthy", ["contact.damping"], sigma={"gap": 1.0})
    with pytest.raises(UsageError, match=r"^table: column load has shape \(1, 200\)"):
        calibrate(trial(1) | {"load": np.ones((1, 200))}, "healthy", ["contact.damping"])
    for options in ({"loss": "cubic"}, {"level": 1.0}, {"starts": 0}):
        with pytest.raises(UsageError, match="is not allowed"):
            calibrate(trial(1), "healthy", ["contact.damping"], **options)
