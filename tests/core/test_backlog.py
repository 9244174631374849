"""Ticks that their budget does not suffice for, and what is known until the run has caught up or forgotten."""

from __future__ import annotations

import math

import numpy as np
import pytest

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import Fidelity, Status
from tests.helpers.scenes import RADIUS, law, model, quick

TIME = np.arange(1500) * 1e-3
STILL = np.zeros_like(TIME)
PULLING = 1000.0 * (1.0 + 1.2 * np.sin(math.tau * TIME))
"""[N]: lets the knee go for 0.2 s, and presses it again"""
TIGHT = 1e-11
"""Tolerance [m] of the run that stands for the exact solution"""


def knee(name: str, budget: int, tolerance: float = 1e-6, level: str = "auto") -> KneeModel:
    """A circle under a law."""
    return quick(model(law(name), tolerance, budget=budget, level=level))


def signed(series: np.recarray) -> np.ndarray:
    """Signed depth [m]."""
    return series.penetration_depth - series.gap


@pytest.mark.parametrize("level", ["dynamic", "auto", "first_order"])
@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic", "flores", "hertz"])
@pytest.mark.parametrize("budget", [100, 200, 400])
def test_a_tick_never_costs_more_than_the_budget(name: str, budget: int, level: str) -> None:
    series = knee(name, budget, 1e-9, level).run(TIME[::5], STILL[::5], PULLING[::5])
    assert series.evaluations.max() <= budget
    for field in ("penetration_depth", "gap", "contact_force", "error_estimate", "force_error_estimate"):
        assert np.isfinite(series[field]).all(), field


@pytest.mark.parametrize("budget", [100, 200, 400])
def test_a_budget_does_not_forget_a_flight(budget: int) -> None:
    series = knee("two_layer_viscoelastic", budget).run(TIME, STILL, PULLING)
    exact = knee("two_layer_viscoelastic", 0, TIGHT, "dynamic").run(TIME, STILL, PULLING)
    error = np.abs(signed(series) - signed(exact))
    known = exact.error_estimate < 0.02 * np.maximum(error, 1e-12)
    right = series.status & Status.NOT_CONVERGED == 0
    assert known.mean() > 0.5
    assert signed(exact).min() < -0.1
    assert not (known & right & (error > 1e-6)).any()
    assert np.mean(error[known] <= series.error_estimate[known]) > 0.995


def test_a_run_that_has_caught_up_is_as_exact_as_one_without_a_budget() -> None:
    # Landings take more than 150 evaluations, the flights between them none: the run falls behind and catches up.
    tight, free = knee("kelvin_voigt", 150, 1e-6, "dynamic"), knee("kelvin_voigt", 0, 1e-6, "dynamic")
    short, long = (one.run(TIME, STILL, PULLING) for one in (tight, free))
    behind = short.fidelity == Fidelity.QUASI_STATIC
    assert 0 < behind.sum() < 50
    assert (short.status[behind] & Status.NOT_CONVERGED != 0).all()
    assert np.abs(signed(short) - signed(long))[-300:].max() <= 1e-6
    assert (
        np.abs(signed(short) - signed(long)) <= short.error_estimate + long.error_estimate + 1e-15
    ).all()  # rounding


def test_an_answer_of_a_run_that_lies_behind_is_the_static_contact() -> None:
    series = knee("kelvin_voigt", 100, 1e-7, "dynamic").run(TIME, STILL, PULLING)
    behind = series[(series.fidelity == Fidelity.QUASI_STATIC) & (series.load > 1.0)]
    assert len(behind)
    # what Newton's method leaves of a depth after a correction of a thousandth
    assert behind.contact_force == pytest.approx(behind.load, rel=1e-5)
    assert RADIUS - behind.femoral_height == pytest.approx(behind.penetration_depth, abs=1e-15)  # rounding of 34 mm


def test_a_lost_run_forgets_where_the_dashpot_provably_makes_it() -> None:
    time = np.arange(3000) * 1e-3
    load = np.where(time < 0.05, -500.0, 800.0)
    series = knee("kelvin_voigt", 0, 1e-6, "quasi_static").run(time, 0.0 * time, load)
    exact = knee("kelvin_voigt", 0, TIGHT, "dynamic").run(time, 0.0 * time, load)
    error = np.abs(signed(series) - signed(exact))
    assert np.all(error[1:] <= series.error_estimate[1:] + 1e-15)  # rounding of 34 mm
    assert error.max() > 0.05
    assert series.status[-1] == 0


@pytest.mark.parametrize("level", ["dynamic", "auto"])
def test_chaos_is_told_and_stays_a_number(level: str) -> None:
    # Bouncing on an undamped layer: the estimate once grew to 1e152 m, then to nan, and nan said OK.
    time = np.arange(3000) * 1e-3
    load = 300.0 + 350.0 * np.cos(8.0 * math.pi * time)
    series = knee("two_layer_viscoelastic", 0, 1e-6, level).run(time, 0.0 * time, load)
    assert np.isfinite(series.error_estimate).all()
    assert np.isfinite(series.force_error_estimate).all()
    assert (series.status[-500:] & Status.NOT_CONVERGED != 0).all()


@pytest.mark.parametrize("level", ["dynamic", "auto", "first_order", "quasi_static"])
@pytest.mark.parametrize("name", ["hertz", "two_layer_elastic"])
def test_loads_of_nearly_nothing_keep_the_budget(name: str, level: str) -> None:
    # Their static depth takes hundreds of halvings; the first tick has a budget, too.
    load = np.where(np.arange(24) % 2 == 0, 0.0, 10.0 ** -np.linspace(300.0, 323.0, 24))
    load[0], load[12] = 1e-305, 800.0
    series = knee(name, 100, 1e-6, level).run(TIME[:24], STILL[:24], load)
    assert series.evaluations.max() <= 100
    assert np.isfinite(series.error_estimate).all()
