"""Rows, frontiers, targets, and the command with its three files."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from knee_contact_ros.cli.main import knee_contact, main
from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.tools.work_precision import frontier, plot, report, run, steadiness, study, targets, worker
from knee_contact_ros.tools.work_precision.peers import PEERS, entries
from knee_contact_ros.tools.work_precision.problems import Problem, find_problems
from knee_contact_ros.tools.work_precision.solver import LOOP, STREAM, WHOLE
from knee_contact_ros.tools.work_precision.study import Row

OURS, PEER = "knee-contact dynamic", "SciPy DOP853"


def row(solver: str, peer: str, error: float, time: float, mode: str = STREAM) -> Row:
    return Row("gait", solver, peer, mode, "1e-6", error, time, 4.0)


ROWS = [
    row(OURS, "knee-contact", 1e-7, 1.0),
    row(OURS, "knee-contact", 1e-11, 10.0),
    row(PEER, "SciPy", 1e-6, 50.0),
    row(PEER, "SciPy", 1e-9, 400.0),
    row(PEER, "SciPy", 1e-10, 300.0),
    row(PEER, "SciPy", 1e-9, 20.0, WHOLE),
    row(PEER, "SciPy", math.nan, math.nan)._replace(failure="diverged"),
]


def test_a_streamed_run_is_also_a_whole_run_but_not_the_other_way() -> None:
    assert len(frontier.of(ROWS, "gait", WHOLE)) == 6
    assert len(frontier.of(ROWS, "gait", STREAM)) == 5
    rows = [*ROWS, row("CyRK RK45", "CyRK", 1e-9, 2.0, LOOP)]
    assert [len(frontier.of(rows, "gait", mode)) for mode in (WHOLE, LOOP, STREAM)] == [7, 6, 5]


def test_the_cheapest_run_is_not_the_one_that_comes_closest() -> None:
    peers = [each for each in frontier.of(ROWS, "gait", STREAM) if each.peer == "SciPy"]
    assert frontier.cheapest(peers, 1e-8) == 300.0
    assert math.isnan(frontier.cheapest(peers, 1e-12))


def test_targets_are_judged_by_their_ratios() -> None:
    judged = {line[0]: line[1] for line in targets.judged(ROWS, ["gait"])}
    assert judged["tick by tick: 1000x less time than SciPy's best"] == "30x, no"
    assert judged["whole run: 50x less time than the best peer"] == "2x, no"
    assert judged["1e-10 m is reachable; smallest error [m]"] == "1e-11, yes"
    # From 1 to 10 µs between 1e-6 and 1e-10 m.
    assert judged["cost grows like error^-p, p at most 1/4"] == "0.25, yes"


def test_a_peer_that_is_quicker_is_said_to_be() -> None:
    rows = [*ROWS, row("CyRK RK45", "CyRK", 1e-9, 2.0, LOOP)]
    judged = {line[0]: line[1] for line in targets.judged(rows, ["gait"])}
    compiled = "less time than the best of CyRK, numbalsoda, diffrax"
    # Ours needs 10 µs for 1e-8 m, in every way to run.
    assert judged[f"tick by tick in a loop: 10x {compiled}"] == "0.2x, no"
    assert judged[f"whole run: 5x {compiled}"] == "0.2x, no"
    assert f"tick by tick, a call each: 10x {compiled}" not in judged
    (line,) = report.against_the_quickest(rows, ["gait"])
    assert line[1:] == [
        "0.2x (CyRK RK45: 2; ours: 10)", "0.2x (CyRK RK45: 2; ours: 10)", "30x (SciPy DOP853: 300; ours: 10)"
    ]  # fmt: skip


def test_a_curve_is_the_mean_over_problems_where_all_are_solved() -> None:
    pair = [row(OURS, "knee-contact", 1e-9, 1.0), row(OURS, "knee-contact", 1e-7, 4.0)._replace(problem="bag, right")]
    errors, times = plot.curves(pair, ["gait", "bag, right"], STREAM)["knee-contact"]
    assert min(errors) == pytest.approx(1e-7)
    # The geometric mean of 1 and 4.
    assert times == pytest.approx([2.0] * len(errors))
    assert plot.curves(pair, ["gait", "bag, right", "bag, left"], STREAM) == {}


def test_a_sweep_tells_what_failed_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = small_problem()
    monkeypatch.setattr(study, "LIMIT", 2.0)
    monkeypatch.setattr(worker, "GRACE", 0.0)
    rows = study.measure([problem], entries("tests.tools.work_precision.faulty"), 1).rows
    failures = {(each.solver, each.failure) for each in rows}
    assert ("raises", "ZeroDivisionError: ") in failures
    assert ("ends", "ended the process") in failures
    assert sum(each.solver == "ends" for each in rows) == study.MOST_LOSSES
    assert [each.failure for each in rows if each.solver == "hangs"] == ["given up after 2 s"]
    answered = [each for each in rows if each.solver == "answers"]
    assert len(answered) == 3
    assert all(each.error > 0.0 and not each.failure for each in answered)


def test_the_command_writes_its_three_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("tabulate")
    monkeypatch.setattr(run, "find_problems", lambda _names: [small_problem()])
    monkeypatch.setattr(steadiness, "TICKS", (10,))
    arguments = ["trade", "--output", str(tmp_path), "--problem", "gait", "--solver", "knee-contact"]
    arguments += ["--solver", "scipy dop853", "--repeat", "1"]
    result = CliRunner().invoke(knee_contact, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert "peers as a multiple of ours" in " ".join(result.output.split())
    page = (tmp_path / "trade.md").read_text(encoding="utf-8")
    for expected in ("SciPy DOP853, events", OURS, "## Targets", "## Long runs", "cores", "numpy"):
        assert expected in page
    with (tmp_path / "trade.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {each["mode"] for each in rows} == {WHOLE, LOOP, STREAM}
    ours = [each for each in rows if each["solver"] == OURS and each["setting"] == "1e-8"]
    assert all(float(each["error"]) < 1e-8 for each in ours)
    assert (tmp_path / "trade.png").read_bytes().startswith(b"\x89PNG")


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "PEERS", (PEERS[0]._replace(name="Nothing", module="no_such_module"),))
    found, absent = run.available()
    assert {entry.solver.peer for entry in found} == {"knee-contact"}
    assert absent == [not_installed("Nothing", "trade")]


def test_unknown_names_end_the_command_with_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    for option, name in (("--problem", "hop"), ("--solver", "abacus")):
        assert main(["trade", option, name]) == 2
        said = capsys.readouterr().err
        assert name in said
        assert said.count("\n") == 1


def test_time_and_memory_are_told_at_every_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steadiness, "TICKS", (100, 300, 500))
    first, second, third = steadiness.moments("dynamic")
    assert (first.ticks, second.ticks, third.ticks) == (100, 300, 500)
    assert first.microseconds_per_tick > 0.0
    # A run holds its last state and nothing else; the first collection of garbage empties free lists of Python.
    assert third.kilobytes - second.kilobytes < 1.0


def small_problem() -> Problem:
    (problem,) = find_problems(("gait",))
    return problem._replace(time=problem.time[:21], load=problem.load[:21])


def test_a_small_problem_is_small() -> None:
    assert np.ptp(small_problem().time) == pytest.approx(0.02)
