"""The levels of the model: what each of them solves, and that it knows how far it is from forward dynamics."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.gait import gait
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.model.types import Fidelity, Status
from tests.helpers.scenes import law, model
from tests.model.scenes import PAIRS, ROUNDING, fast, hopping, signed, stepping, walking

TOLERANCES = (1e-5, 1e-8)
FINEST = 1e-11
"""Tolerance [m] of the dynamic run that stands for the exact solution"""
SERIES = {
    "gait": tuple(column[:200] for column in gait("right")),
    "walking": walking(),
    "short ticks": walking(401, 5e-4),
    "hopping": hopping(),
    "stepping": stepping(),
}
LAYERS = {"layer_depth": 3e-4}
KNEES: dict[str, tuple[str, dict[str, Any], float, str]] = {
    "shipped": ("kelvin_voigt", {}, 9.3, "plane"),
    "1 g": ("kelvin_voigt", {}, 1e-3, "plane"),
    "0.1 g": ("kelvin_voigt", {}, 1e-4, "slope"),
    "1 t": ("kelvin_voigt", {}, 1e3, "plane"),
    "stuck": ("kelvin_voigt", {"damping": 1e6}, 9.3, "plane"),
    "swings": ("kelvin_voigt", {"damping": 30.0}, 0.01, "cup"),
    "Hertz": ("hertz", {}, 9.3, "plane"),
    "Flores": ("flores", {}, 9.3, "cup"),
    "foundation": ("elastic_foundation", {}, 9.3, "slope"),
    "two layers": ("two_layer_viscoelastic", LAYERS, 9.3, "plane"),
    "both damped": ("two_layer_viscoelastic", LAYERS | {"damp_first_layer": True}, 0.1, "plateau"),
    "elastic layers": ("two_layer_elastic", LAYERS, 9.3, "plane"),
    "dents": ("kelvin_voigt", {"damping": 1e5}, 0.1, "dents"),
}
"""Laws with their constants, masses [kg] and surfaces"""
EACH = pytest.mark.parametrize("name", KNEES)


@cache
def answers(name, series, level, tolerance):
    """The answers of a level."""
    law_name, constants, mass, pair = KNEES[name]
    knee = model(
        law(law_name, **constants),
        tolerance,
        mass=mass,
        pair=PAIRS[pair](),
        level=level,
        budget=20_000,
    )
    return fast(knee).run(*SERIES[series])


def test_auto_is_dynamic():
    assert LEVELS["auto"] == LEVELS["dynamic"]


@EACH
def test_the_quasi_static_level_balances_the_load_at_rest(name):
    law_name, constants, _, pair = KNEES[name]
    knee = model(law(law_name, **constants), pair=PAIRS[pair]())
    rows: Any = answers(name, "walking", "quasi_static", 1e-10)[1:]
    assert (rows.fidelity == Fidelity.QUASI_STATIC).all()
    forces = np.array([knee.law.static_force(row.penetration_depth) for row in rows])
    upright = np.array(
        [knee.pair.closest(row.flexion_angle, row.femoral_height).normal_y for row in rows]
    )
    # What Newton's method leaves of a depth of 0.1 mm after a correction of 1e-12 m is rounding, and n_y on a curved
    # tibia is that of a height that rounds to 7e-18 m
    assert np.abs(upright * forces - np.maximum(rows.load, 0.0)).max() <= 1e-11 * max(
        1.0, np.abs(rows.load).max()
    )


@pytest.mark.parametrize("level", ["quasi_static", "dynamic"])
@EACH
def test_a_level_knows_how_far_it_is_from_forward_dynamics(name, level):
    covered, ratios = [], []
    for series in SERIES:
        exact = answers(name, series, "dynamic", FINEST)
        # The finest run may stand for the exact solution until it ran out of budget.
        known = np.logical_and.accumulate(exact.fidelity == Fidelity.DYNAMIC)
        for tolerance in TOLERANCES:
            found = answers(name, series, level, tolerance)
            error, fine = (
                np.abs(signed(found) - signed(exact)),
                found.status & Status.NOT_CONVERGED == 0,
            )
            trusted = known & (exact.error_estimate <= 0.1 * tolerance)
            assert error[fine & trusted].max(initial=0.0) <= tolerance
            assert (fine <= (found.error_estimate <= tolerance)).all()
            covered += (error <= found.error_estimate + exact.error_estimate + ROUNDING)[
                known
            ].tolist()
            large = known & (error > 1e-12) & (error > 10.0 * exact.error_estimate)
            ratios += (found.error_estimate[large] / error[large]).tolist()
    assert len(covered) > 500
    assert np.mean(covered) >= 0.98
    assert name != "shipped" or np.median(ratios) < 30.0  # nor far too large


@pytest.mark.parametrize("level", ["quasi_static", "dynamic"])
def test_a_force_tolerance_is_kept_or_missing_it_is_said(level):
    knee = model(law("kelvin_voigt"), 1e-5, level=level)
    exact = fast(replace(knee, tolerance=FINEST, level=LEVELS["dynamic"])).run(*walking())
    for force_tolerance in (1e-3, 1e-1, 10.0):
        series = fast(replace(knee, force_tolerance=force_tolerance)).run(*walking())
        fine = series.status == Status.OK
        assert fine.mean() > (0.9 if level == "dynamic" else 0.0)
        assert (fine <= (series.force_error_estimate <= force_tolerance)).all()
        assert (
            np.abs(series.contact_force - exact.contact_force)[fine].max(initial=0.0)
            <= force_tolerance
        )
