"""The levels of the model: what each of them solves, and that it knows how far it is from forward dynamics."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.types import Fidelity, Status
from tests.core.level_scenes import LevelScene, answers, exact, hopping, scenes, stepping, walking
from tests.helpers.scenes import DAMPING, STIFFNESS, law

pytestmark = pytest.mark.xdist_group("levels")
"""One process: its tests share what they compare with"""
SCENES = [pytest.param(i, id=scene.name) for i, scene in enumerate(scenes())]
SMOOTH = [pytest.param(i, id=scene.name) for i, scene in enumerate(scenes()) if scene.smooth]
TOLERANCES = (1e-5, 1e-6, 1e-8)
ROUNDING = 1e-15
"""[m]: of heights of 34 mm, with room"""
FIELDS = ("contact_force", "penetration_depth", "gap", "penetration_rate", "femoral_height", "error_estimate")
RANKS = {
    "quasi_static": Fidelity.QUASI_STATIC,
    "first_order": Fidelity.FIRST_ORDER,
    "dynamic": Fidelity.DYNAMIC,
}


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("index", SCENES)
def test_answers_are_finite_and_never_pull(index: int, level: str) -> None:
    for tolerance in TOLERANCES:
        series = answers(index, level, tolerance)
        for field in FIELDS:
            assert np.isfinite(series[field]).all(), field
        assert np.all(series.contact_force >= 0.0)
        assert np.all(series.penetration_depth >= 0.0)
        assert np.all(series.gap >= 0.0)
        assert np.all(series.penetration_depth * series.gap == 0.0)
        assert np.all((series.error_estimate <= tolerance) | (series.status & Status.NOT_CONVERGED != 0))


@pytest.mark.parametrize("level", RANKS)
@pytest.mark.parametrize("index", SCENES)
def test_the_fidelity_is_that_of_the_level(index: int, level: str) -> None:
    series = answers(index, level, 1e-6)
    said = series.status & Status.NOT_CONVERGED != 0
    # The start is the static contact that forward dynamics goes on from; a tick given up is answered quasi-statically.
    assert series.fidelity[0] == Fidelity.DYNAMIC
    settled = (series.fidelity == Fidelity.QUASI_STATIC) & said
    assert np.all((series.fidelity == RANKS[level])[1:] | settled[1:])


def residuals(scene: LevelScene, level: str, tolerance: float, fidelity: Fidelity) -> np.ndarray:
    """n_y F less the load over the load [-], at the ticks that a level computed; F by the law from depth and rate."""
    model = scene.model(level, tolerance)
    found = []
    for row in model.run(*scene.series)[1:]:
        if row.fidelity != fidelity:
            continue
        layers = [layer for layer in scene.law.layers if layer.begin < row.penetration_depth]
        rate = 0.0 if fidelity == Fidelity.QUASI_STATIC else row.penetration_rate
        force = layers[-1].formula.force_at(row.penetration_depth, rate, 0.0)[0] if layers else 0.0
        assert fidelity == Fidelity.QUASI_STATIC or row.contact_force == pytest.approx(force, rel=1e-12, abs=1e-9)
        upright = model.closest(row.flexion_angle, row.femoral_height).normal_y
        found.append((upright * force - max(row.load, 0.0)) / max(1.0, abs(row.load)))
    return np.array(found)


@pytest.mark.parametrize("index", SCENES)
def test_the_quasi_static_level_balances_the_load_at_rest(index: int) -> None:
    found = residuals(scenes()[index], "quasi_static", 1e-10, Fidelity.QUASI_STATIC)
    assert len(found) > 100
    # What Newton's method leaves of a depth of 0.1 mm after a correction of 1e-12 m is rounding, and n_y on a curved
    # tibia is that of a height that rounds to 7e-18 m
    assert np.abs(found).max() <= 1e-11


@pytest.mark.parametrize("level", ["first_order", "auto"])
def test_the_first_order_level_balances_the_load_with_the_dashpot(level: str) -> None:
    by_name = {scene.name: scene for scene in scenes()}
    for name in ("walking, C 1e6", "walking, circle on a hill, C 1e5, 0.1 kg", "walking, 1 g"):
        found = residuals(by_name[name], level, 1e-6, Fidelity.FIRST_ORDER)
        assert len(found) > 10
        # The last stage's velocity is what Newton's method found it to be within 1 % of the tolerance (1e-8 m), to
        # second order: of a depth of 0.2 mm that is (5e-5)². The dashpot's force is met to the same.
        assert np.abs(found).max() <= 1e-6


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("damping", [DAMPING, 1e5])
@pytest.mark.parametrize("series", [walking(81), hopping(), stepping(101)], ids=["walking", "hopping", "stepping"])
def test_the_first_order_level_agrees_with_a_general_solver(
    series: tuple[np.ndarray, np.ndarray, np.ndarray], damping: float, tolerance: float
) -> None:
    """C dδ/dt = max(L, 0) - K δ^1.5, by SciPy, restarted wherever the load's slope jumps."""
    scene = LevelScene("", law("kelvin_voigt", damping=damping), series)
    found = scene.model("first_order", tolerance).run(*series)
    time, _, load = series
    depth = (load[0] / STIFFNESS) ** (1 / 1.5)
    for i in range(1, len(time)):
        begin, end = load[i - 1], load[i]
        slope = (end - begin) / (time[i] - time[i - 1])
        turn = [time[i - 1] - begin / slope] if begin * end < 0.0 else []
        for s, t in itertools.pairwise([time[i - 1], *turn, time[i]]):
            pressed = begin + slope * (0.5 * (s + t) - time[i - 1]) >= 0.0

            def motion(
                x: float, z: np.ndarray, i: int = i, begin: float = begin, slope: float = slope, pressed: bool = pressed
            ) -> list[float]:
                pressing = begin + slope * (x - time[i - 1]) if pressed else 0.0
                return [(pressing - STIFFNESS * max(z[0], 0.0) ** 1.5) / damping]

            depth = solve_ivp(motion, (s, t), [depth], method="DOP853", rtol=1e-12, atol=1e-17).y[0, -1]
        assert found.penetration_depth[i] - found.gap[i] == pytest.approx(depth, abs=tolerance)


def known(index: int) -> np.ndarray:
    """Ticks at which the finest dynamic run may stand for the exact solution: until it ran out of budget."""
    return np.logical_and.accumulate(exact(index).fidelity == Fidelity.DYNAMIC)


def errors(index: int, level: str, tolerance: float) -> np.ndarray:
    """Error [m] of the signed depth against forward dynamics."""
    found, theirs = answers(index, level, tolerance), exact(index)
    return np.abs((found.penetration_depth - found.gap) - (theirs.penetration_depth - theirs.gap))


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("level", LEVELS)
def test_the_estimate_covers_the_distance_from_forward_dynamics(level: str, tolerance: float) -> None:
    covered, ratios = [], []
    for i in range(len(scenes())):
        error, estimate, theirs = errors(i, level, tolerance), answers(i, level, tolerance).error_estimate, exact(i)
        covered += (error <= estimate + theirs.error_estimate + ROUNDING)[known(i)].tolist()
        large = known(i) & (error > 1e-12) & (error > 10.0 * theirs.error_estimate)
        ratios += (estimate[large] / error[large]).tolist()
    assert len(covered) > 4500
    assert np.median(ratios) < 30.0
    assert np.mean(covered) >= 0.99


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("level", ["dynamic", "auto"])
@pytest.mark.parametrize("index", SCENES)
def test_what_is_said_to_be_in_tolerance_is(index: int, level: str, tolerance: float) -> None:
    series = answers(index, level, tolerance)
    trusted = known(index) & (exact(index).error_estimate <= 0.1 * tolerance)
    fine = trusted & (series.status == Status.OK)
    assert errors(index, level, tolerance)[fine].max(initial=0.0) <= tolerance


def given_up(index: int, level: str, tolerance: float) -> np.ndarray:
    """Ticks answered quasi-statically for want of anything better."""
    series = answers(index, level, tolerance)
    return (series.fidelity == Fidelity.QUASI_STATIC) & (series.error_estimate > tolerance)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("index", SCENES)
def test_a_tick_is_not_given_up_for_having_tried_a_simpler_level(index: int, tolerance: float) -> None:
    assert not np.any(given_up(index, "auto", tolerance) & ~given_up(index, "dynamic", tolerance))


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("index", SMOOTH)
def test_the_level_does_not_go_to_and_fro(index: int, tolerance: float) -> None:
    fidelity = answers(index, "auto", tolerance).fidelity.astype(int)
    load = scenes()[index].series[2]
    # A load that changes monotonically has one stretch at most where it changes too fast for a simpler level, between
    # two where it does not, and three levels have two steps between them.
    turns = np.count_nonzero(np.diff(np.sign(np.diff(load))) != 0)
    changes = np.count_nonzero(np.diff(fidelity))
    assert changes <= 4 * (turns + 1)
    assert changes <= 0.1 * len(load)


def test_a_pose_at_rest_is_answered_by_the_quasi_static_level() -> None:
    time = 5e-3 * np.arange(200.0)
    load = np.where(time < 0.2, 500.0 + 2000.0 * time, 900.0)
    series = (
        LevelScene("", law("kelvin_voigt"), (time, 0.0 * time, load)).model("auto", 1e-6).run(time, 0.0 * time, load)
    )
    assert series.fidelity[-1] == Fidelity.QUASI_STATIC
    assert series.fidelity[time > 0.4].max() == Fidelity.QUASI_STATIC
    assert series.penetration_depth[-1] == pytest.approx((900.0 / STIFFNESS) ** (1 / 1.5), rel=1e-9)
    assert math.isclose(series.error_estimate[-1], 0.0, abs_tol=1e-12)
