"""Rows, tables, and the command with its three files."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.peers import __main__ as command
from benchmarks.peers import measure, page, picture
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


def test_a_streamed_run_is_also_a_whole_run_but_not_the_other_way() -> None:
    assert len(page.of(ROWS, "gait", measure.WHOLE)) == 6
    assert len(page.of(ROWS, "gait", measure.STREAM)) == 5
    rows = [*ROWS, row("CyRK RK45", "CyRK", 1e-9, 2.0, measure.LOOP)]
    assert [len(page.of(rows, "gait", mode)) for mode in (measure.WHOLE, measure.LOOP, measure.STREAM)] == [7, 6, 5]


def test_the_cheapest_run_is_not_the_one_that_comes_closest() -> None:
    peers = [each for each in page.of(ROWS, "gait", measure.STREAM) if each.peer == "SciPy"]
    assert page.cheapest(peers, 1e-8) == 300.0
    assert math.isnan(page.cheapest(peers, 1e-12))


def test_a_peer_that_is_quicker_is_said_to_be() -> None:
    rows = [*ROWS, row("CyRK RK45", "CyRK", 1e-9, 2.0, measure.LOOP)]
    (line,) = page.against_the_quickest(rows, ["gait"])
    assert line[1:] == [
        "0.2x (CyRK RK45: 2; ours: 10)", "0.2x (CyRK RK45: 2; ours: 10)", "30x (SciPy DOP853: 300; ours: 10)"
    ]  # fmt: skip


def test_a_curve_is_the_mean_over_problems_where_all_are_solved() -> None:
    pair = [row(OURS, "knee-contact", 1e-9, 1.0), row(OURS, "knee-contact", 1e-7, 4.0)._replace(problem="bag, right")]
    errors, times = picture.curves(pair, ["gait", "bag, right"], measure.STREAM)["knee-contact"]
    assert min(errors) == pytest.approx(1e-7)
    # The geometric mean of 1 and 4.
    assert times == pytest.approx([2.0] * len(errors))
    assert picture.curves(pair, ["gait", "bag, right", "bag, left"], measure.STREAM) == {}


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


@pytest.mark.parametrize(
    ("seconds", "most", "expected"),
    [(1e-4, 5, 5), (0.3, 5, 3), (7.0, 5, measure.LEAST_TURNS), (7.0, 1, 1), (0.0, 5, 5)],
)
def test_long_runs_have_fewer_turns_and_no_run_more_than_asked_for(seconds: float, most: int, expected: int) -> None:
    assert measure.turns_for(seconds, most) == expected


def test_turns_come_to_least_median_and_spread() -> None:
    times = measure.summed_up([4.0, 2.0, 3.0])
    assert (times.least, times.median, times.turns) == (2.0, 3.0, 3)
    assert times.spread_percent == pytest.approx(100.0 * 2.0 / 3.0)
    assert measure.summed_up([2.0]).spread_percent == 0.0


def test_a_row_tells_its_turns_in_microseconds_per_tick_and_a_failed_run_is_not_timed_again() -> None:
    problem = PROBLEMS["impact"]
    before = measure.Row("impact", "a", "b", "whole", "1e-6", 1e-9, math.nan, 4.0)
    task = measure.Task("", "a", measure.WHOLE, problem, measure.Setting("", 0.0))
    run, ticks = measure.Run(before, task), len(problem.time) - 1
    run.turns += [8e-3, 4e-3]
    assert run.row.microseconds_per_tick == pytest.approx(4e3 / ticks)
    assert run.row.median_microseconds == pytest.approx(6e3 / ticks)
    assert run.row.turns == 2
    assert run.due(4, 5)
    assert not run.due(5, 5)
    failed = measure.Run(before._replace(failure="diverged"), task)
    assert not failed.due(1, 5)
    assert failed.row == before._replace(failure="diverged")
