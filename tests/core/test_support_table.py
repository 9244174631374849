"""Polynomials of the support function against the closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.core.geometries import Profile
from knee_contact_ros.core.geometries.profile import lowest_point
from knee_contact_ros.core.geometries.support_table import CELLS, tabulated
from tests.core.surfaces import DEGENERATE, ellipse, noisy_femur, wavy

ROUNDING = 1e-16
"""Several rounding errors of lengths below 0.05 m, in m"""
CLOSE = 3e-16
"""The same of a slope, with what a polynomial may be wrong by"""


def held_against_the_closed_form(profile: Profile, angles: np.ndarray) -> int:
    """Compare at some angles; return at how many of them there is a polynomial."""
    found = 0
    for angle in angles.tolist():
        h, slope = tabulated(profile.table, angle)
        if not math.isnan(h):
            depth, x, y, _ = lowest_point(profile.curve, angle)
            assert h == pytest.approx(depth, abs=ROUNDING)
            assert slope == pytest.approx(math.sin(angle) * y - math.cos(angle) * x, abs=CLOSE)
            found += 1
    return found


@given(
    points=st.integers(8, 90), height=st.sampled_from([0.0, 1e-6, 1e-5, 1e-4, 3e-4]), waves=st.integers(2, 12),
    phase=st.floats(0.0, 6.3), seed=st.integers(0, 1000), backwards=st.booleans(),
)  # fmt: skip
@settings(max_examples=30, deadline=None)
def test_polynomials_are_the_support(
    points: int, height: float, waves: int, phase: float, seed: int, backwards: bool
) -> None:
    profile, _ = wavy(points, height, waves, phase)
    if backwards:
        profile = Profile(*profile.outline(1)[::-1].T)
    held_against_the_closed_form(profile, np.random.default_rng(seed).uniform(-10.0, 10.0, 500))


@given(noise=st.sampled_from([1e-6, 1e-5, 1e-4]), seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_polynomials_are_the_support_of_noisy_points(noise: float, seed: int) -> None:
    held_against_the_closed_form(noisy_femur(noise, seed=seed), np.random.default_rng(seed).uniform(0.0, 6.4, 500))


@pytest.mark.parametrize("points", DEGENERATE.values(), ids=DEGENERATE)
def test_odd_profiles_have_a_table(points: tuple[np.ndarray, np.ndarray]) -> None:
    held_against_the_closed_form(Profile(*points), np.linspace(0.0, math.tau, 3001))


def test_edges_of_cells_and_points_of_the_spline_are_on_no_wrong_side() -> None:
    profile = ellipse(80)
    edges = np.arange(-10, CELLS + 10) * (math.tau / CELLS)
    angles = np.concatenate([edges, np.nextafter(edges, -math.inf), np.nextafter(edges, math.inf)])
    assert held_against_the_closed_form(profile, angles) > 0.98 * len(angles)


def test_a_smooth_profile_has_polynomials_nearly_everywhere() -> None:
    assert held_against_the_closed_form(ellipse(120), np.linspace(-0.6, 2.3, 3000)) > 2990
