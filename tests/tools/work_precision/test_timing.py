"""How often runs are timed, and what the turns come to."""

from __future__ import annotations

import pytest

from knee_contact_ros.tools.work_precision import yardstick
from knee_contact_ros.tools.work_precision.problems import find_problems
from knee_contact_ros.tools.work_precision.solver import stopwatch
from knee_contact_ros.tools.work_precision.study import Row, Run, what_failed
from knee_contact_ros.tools.work_precision.timing import LEAST_TURNS, RUNS, runs_for, summed_up, turns_for
from knee_contact_ros.tools.work_precision.worker import Task


@pytest.mark.parametrize(
    ("seconds", "most", "expected"), [(1e-4, 5, 5), (0.3, 5, 3), (7.0, 5, LEAST_TURNS), (7.0, 1, 1), (0.0, 5, 5)]
)
def test_long_runs_have_fewer_turns_and_no_run_more_than_asked_for(seconds: float, most: int, expected: int) -> None:
    assert turns_for(seconds, most) == expected


def test_short_runs_are_repeated_within_a_turn() -> None:
    assert runs_for(1e-4) == runs_for(0.0) == RUNS
    assert runs_for(0.02) == 2
    assert runs_for(3.0) == 1


def test_turns_come_to_least_median_and_spread() -> None:
    times = summed_up([4.0, 2.0, 3.0])
    assert (times.least, times.median, times.turns) == (2.0, 3.0, 3)
    assert times.spread_percent == pytest.approx(100.0 * 2.0 / 3.0)
    assert summed_up([2.0]).spread_percent == 0.0


def test_a_row_tells_its_turns_in_microseconds_per_tick() -> None:
    (problem,) = find_problems(("impact",))
    row = Row("impact", "a", "b", "whole", "1e-6", 1e-9, float("nan"), 4.0)
    run = Run(row, Task("", "a", False, problem, yardstick.SETTING))
    run.turns += [8e-3, 4e-3]
    ticks = len(problem.time) - 1
    assert run.row.microseconds_per_tick == pytest.approx(4e3 / ticks)
    assert run.row.median_microseconds == pytest.approx(6e3 / ticks)
    assert run.row.turns == 2
    assert run.due(4, 5)
    assert not run.due(5, 5)


def test_a_failed_run_is_not_timed_again() -> None:
    (problem,) = find_problems(("impact",))
    row = Row("impact", "a", "b", "whole", "1e-6", float("nan"), float("nan"), 4.0, failure="diverged")
    run = Run(row, Task("", "a", False, problem, yardstick.SETTING))
    assert not run.due(1, 5)
    assert run.row == row


def test_the_yardstick_is_a_solver_that_takes_time() -> None:
    (problem,) = find_problems(("impact",))
    (solver,) = yardstick.solvers()
    assert solver.whole is not None
    outcome = solver.whole(problem, yardstick.SETTING)
    assert outcome.seconds > 0.0
    assert what_failed(outcome, outcome.depth) == ""


def test_the_stopwatch_counts_processor_time() -> None:
    with stopwatch() as watch:
        total = sum(range(100_000))
    assert total > 0
    assert watch.seconds > 0.0
