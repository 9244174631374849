"""What is asked, and where it is answered from."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.tools.work_precision.problems import BASE, PEAK, Problem, find_problems, problems
from knee_contact_ros.tools.work_precision.start import exact_depth, start_depth

PROBLEMS = {problem.name: problem for problem in problems()}


@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_time_increases_and_loads_are_those_of_a_knee(problem: Problem) -> None:
    assert problem.time.shape == problem.load.shape
    assert problem.time[0] == 0.0
    assert np.all(np.diff(problem.time) > 0.0)
    assert problem.load[0] > 0.0
    assert np.all(np.abs(problem.load) < 2500.0)


def test_gait_has_the_base_and_the_peak_it_says() -> None:
    load = PROBLEMS["gait"].load
    # The neighbouring bump adds its tail to both.
    assert load.min() == pytest.approx(BASE, abs=0.1)
    assert load.max() == pytest.approx(PEAK, abs=0.1)


def test_lift_off_pulls_as_it_says() -> None:
    assert PROBLEMS["lift-off"].load.min() == pytest.approx(-80.0, abs=5.0)


def test_bags_are_recorded_at_200_hz() -> None:
    for side in ("right", "left"):
        assert np.diff(PROBLEMS[f"bag, {side}"].time) == pytest.approx(5e-3)


def test_the_reference_lifts_off_crosses_the_layer_and_bounces() -> None:
    lifted = exact_depth(PROBLEMS["lift-off"])
    assert np.count_nonzero(np.diff(np.sign(lifted))) == 2
    layered = PROBLEMS["osteoarthritis"]
    assert np.count_nonzero(np.diff(exact_depth(layered) > layered.layer_depth)) == 8
    thrown = exact_depth(PROBLEMS["impact"])
    assert np.count_nonzero(np.diff(np.sign(thrown))) >= 6


def test_runs_start_where_the_law_carries_the_first_load() -> None:
    problem = PROBLEMS["gait"]
    force = problem.stiffness * start_depth(problem) ** 1.5
    assert force == pytest.approx(problem.load[0], rel=1e-12)


def test_an_unknown_name_is_told() -> None:
    with pytest.raises(KeyError, match="hop"):
        find_problems(("hop",))
