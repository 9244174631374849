"""What `knee-contact report` says of bad input and damaged bags, and what it leaves behind when it is interrupted."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import not_installed
from tests.tools.report.pages import page_of, text_of

pytest.importorskip("matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.mcap"], "no recording at nowhere.mcap"),
        (["{bag}", "--label", "a", "--label", "b"], "--label: 2 given for 1 FILEs"),
        (["{bag}", "--params", "nowhere.yaml"], "nowhere.yaml"),
        (["{bag}", "--compare", "nowhere.yaml"], "nowhere.yaml"),
        (["{bag}", "-p", "knee.joint_name:=elbow"], "elbow"),
        (["{recording}", "--params", "healthy.yaml"], "--params is for bags"),
        (["{csv}"], "femur_medial.csv"),
        ([], "FILE"),
    ],
)
def test_bad_input_is_told_in_a_line(
    arguments, words, bags, recording: Path, config: Path, tmp_path: Path, capsys
) -> None:
    names = {"bag": bags[0], "recording": recording, "csv": config / "femur_medial.csv"}
    output = tmp_path / "out"
    assert main(["report", *(each.format(**names) for each in arguments), "--output", str(output)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not output.exists()


def test_a_damaged_bag_is_told_and_reported_as_far_as_it_goes(bags, tmp_path: Path, capsys) -> None:
    source = next(bags[0].glob("*.mcap"))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(source.read_bytes()[: source.stat().st_size * 2 // 3])
    assert main(["report", str(cut), "--output", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert "The file is damaged" in text_of(page_of(tmp_path / "out"))


def test_a_missing_library_is_told_in_a_line(bags, tmp_path: Path) -> None:
    code = "import sys; sys.modules['jinja2'] = None; from knee_contact_ros.commands.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "report", str(bags[0]), "--output", str(tmp_path / "out")]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert run.stderr == f"knee-contact: {not_installed('jinja2', 'report')}\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_report_leaves_nothing_behind(bags, tmp_path: Path, number: int) -> None:
    bag, output = tmp_path / "bag", tmp_path / "out"
    shutil.copytree(bags[0], bag)
    command = [
        sys.executable,
        "-m",
        "knee_contact_ros.commands.main",
        "report",
        *[str(bag)] * 50,
        "--output",
        str(output),
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60.0
    while not list(output.glob(".incomplete-*/*")) and time.monotonic() < deadline:
        time.sleep(0.01)
    process.send_signal(number)
    _, error = process.communicate(timeout=60.0)
    by_python = -signal.SIGINT  # where the signal meets generated code Python ends so; a shell says 130 to both
    assert (process.returncode, error.strip()) in [(code, "knee-contact: interrupted") for code in (130, by_python)]
    assert not output.exists()
