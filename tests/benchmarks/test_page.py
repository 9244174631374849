"""Rows, tables, and the command with its three files."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.peers import __main__ as command
from benchmarks.peers import measure, page
from benchmarks.peers.problems import Problem, problems
from knee_contact_ros.system.files import not_installed

PROBLEMS = {problem.name: problem for problem in problems()}
OURS, PEER = "knee-contact dynamic", "SciPy DOP853"


def row(solver: str, peer: str, error: float, time: float, mode: str = measure.STREAM) -> measure.Row:
    return measure.Row("gait", solver, peer, mode, "1e-6", error, time, 4.0)


ROWS = [
    row(OURS, "knee-contact", 1e-7, 1.0),
    row(OURS, "knee-contact", 1e-11, 10.0),
    row(PEER, "SciPy", 1e-6, 50.0),
    row(PEER, "SciPy", 1e-9, 400.0),
    row(PEER, "SciPy", 1e-10, 300.0),
    row(PEER, "SciPy", 1e-9, 20.0, measure.WHOLE),
    row(PEER, "SciPy", math.nan, math.nan)._replace(failure="diverged"),
]


def test_a_peer_that_is_quicker_is_said_to_be() -> None:
    rows = [*ROWS, row("CyRK RK45", "CyRK", 1e-9, 2.0, measure.LOOP)]
    (line,) = page.against_the_quickest(rows, ["gait"])
    assert line[1:] == [
        "0.2x (CyRK RK45: 2; ours: 10)", "0.2x (CyRK RK45: 2; ours: 10)", "30x (SciPy DOP853: 300; ours: 10)"
    ]  # fmt: skip


def test_a_sweep_tells_what_failed_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = small_problem()
    monkeypatch.setattr(measure, "LIMIT", 2.0)
    monkeypatch.setattr(measure, "GRACE", 0.0)
    rows = measure.measure([problem], measure.entries("tests.benchmarks.faulty"), 1).rows
    failures = {(each.solver, each.failure) for each in rows}
    assert ("raises", "ZeroDivisionError: ") in failures
    assert ("ends", "ended the process") in failures
    assert sum(each.solver == "ends" for each in rows) == measure.MOST_LOSSES
    assert [each.failure for each in rows if each.solver == "hangs"] == ["given up after 2 s"]
    answered = [each for each in rows if each.solver == "answers"]
    assert len(answered) == 3
    assert all(each.error > 0.0 and not each.failure for each in answered)


def test_the_command_writes_its_three_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "find_problems", lambda _names: [small_problem()])
    arguments = ["--output", str(tmp_path), "--problem", "gait", "--solver", "knee-contact"]
    arguments += ["--solver", "scipy dop853", "--repeat", "1"]
    result = CliRunner().invoke(command.main, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert "time per tick [µs], over ours" in result.output
    text = (tmp_path / "trade.md").read_text(encoding="utf-8")
    for expected in (PEER, OURS, "## Solvers", "cores", "numpy"):
        assert expected in text
    with (tmp_path / "trade.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {each["mode"] for each in rows} == {measure.WHOLE, measure.LOOP, measure.STREAM}
    ours_there = [each for each in rows if each["solver"] == OURS and each["setting"] == "1e-8"]
    assert all(float(each["error"]) < 1e-8 for each in ours_there)
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "PEERS", (measure.PEERS[0]._replace(name="Nothing", module="no_such_module"),))
    found, absent = command.chosen_solvers(())
    assert {entry.solver.peer for entry in found} == {"knee-contact"}
    assert absent == [not_installed("Nothing", "peers")]


@pytest.mark.parametrize(("option", "name"), [("--problem", "hop"), ("--solver", "abacus")])
def test_unknown_names_end_the_command(option: str, name: str) -> None:
    result = CliRunner().invoke(command.main, [option, name])
    assert result.exit_code == 2
    assert name in result.output


def small_problem() -> Problem:
    problem = PROBLEMS["gait"]
    return problem._replace(time=problem.time[:21], load=problem.load[:21])
