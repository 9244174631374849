"""Intervals of small problems whose answers are known, and of a cost that is not smooth."""

import sys
from collections.abc import Callable

import numpy as np
import pytest

from knee_contact_ros import UsageError, calibrate
from knee_contact_ros.lab.calibrate.fit import Data, Fit, FitProblem
from knee_contact_ros.lab.calibrate.intervals import find_intervals
from knee_contact_ros.lab.calibrate.unknowns import Unknown
from knee_contact_ros.system.progress import no_progress
from tests.lab.calibrate.trials import START, trial

NOISE = 0.1
MEASURED = 2.0 + NOISE * np.random.default_rng(1).standard_normal(50)


class OneColumn(FitProblem):
    """A parameter, 1 to 4, and an answer that follows from it at every sample."""

    answer: Callable[[float], float]

    def answers(self, values):
        return {"gap": np.full(len(MEASURED), self.answer(values["a"]))}


def intervals_of(answer):
    """The fitted value, and its interval where the noise is known."""
    unknown = Unknown("a", 2.5, 1.0, 4.0, "", 1.0)
    problem = OneColumn(Data("table", "", {"gap": MEASURED}), (unknown,))
    object.__setattr__(problem, "answer", answer)
    fit = Fit.at_start(problem, "linear", {"gap": NOISE}).converged()
    return fit.values()["a"], find_intervals(fit, 0.95, no_progress)


def test_the_interval_of_a_mean_is_that_of_the_normal_distribution():
    value, found = intervals_of(lambda a: a)
    ((low, high, *opened),) = found.intervals
    assert value == pytest.approx(MEASURED.mean(), rel=1e-6)
    assert [low, high] == pytest.approx(
        value + 1.96 * NOISE / 50**0.5 * np.array([-1.0, 1.0]), abs=2e-5
    )
    assert (opened, found.better, found.failed) == ([False, False], None, False)


def test_an_end_beyond_the_range_is_open():
    _, found = intervals_of(lambda a: 2.0 + 1e-3 * a)
    assert found.intervals[0] == (1.0, 4.0, True, True)
    assert not found.failed


def test_a_lower_cost_beside_the_fit_is_found():
    """The search ends where the answer stands still; behind a step it fits better."""
    _, found = intervals_of(lambda a: MEASURED.mean() + 0.02 * (a < 2.9) + 1e-3 * (a - 3.0))
    assert found.better[0] > 2.9


def test_intervals_need_a_library(monkeypatch):
    monkeypatch.setitem(sys.modules, "iminuit", None)
    with pytest.raises(UsageError, match=r"iminuit is not installed; .*\[calibrate\]"):
        calibrate(trial(1), ["healthy", START], [*START])
    assert calibrate(trial(1), ["healthy", START], [*START], with_intervals=False).intervals == {}
