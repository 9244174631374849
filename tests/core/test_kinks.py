"""Kinks of a profile's support: where its lowest point leaps from one bump to the next."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.core.contact_pairs import OnPlane
from knee_contact_ros.core.geometries import Circle, Profile
from knee_contact_ros.core.mechanisms import Hinge
from knee_contact_ros.core.prescribed import KINK_WIDTH, Interval, stretch_from
from tests.core.surfaces import ellipse
from tests.helpers.scenes import RADIUS

BUMP = 0.01


def two_bumps(lean: float = 0.0) -> Profile:
    """Two bumps at +-BUMP, alike but for a lean [rad] of the whole."""
    x = np.linspace(-0.03, 0.03, 121)
    y = -0.03 + 200.0 * (x**2 - BUMP**2) ** 2 / BUMP
    return Profile(math.cos(lean) * x - math.sin(lean) * y, math.sin(lean) * x + math.cos(lean) * y)


def kinks_between(pair: OnPlane, start: float, end: float) -> list[float]:
    found = []
    while not math.isnan(start := pair.next_kink(start, end)):
        found.append(start)
    return found


def interval(pair: OnPlane, start: float, end: float, duration: float = 0.01) -> Interval:
    return Interval(pair, Hinge(), duration, start, (end - start) / duration, 0.0, 0.0, math.nan)


@pytest.mark.parametrize("lean", [-0.2, 0.0, 0.3])
def test_two_equal_bumps_change_places_where_they_are_level(lean: float) -> None:
    # Turned by the angle, the points' lean comes on top: the bumps are level at minus the lean.
    profile = two_bumps(lean)
    kink = next(kink for kink in profile.kinks if abs(math.remainder(kink + lean, math.tau)) < 0.1)
    assert math.remainder(kink + lean, math.tau) == pytest.approx(
        0.0, abs=1e-12
    )  # bisection to 1e-13, spline's rounding
    behind, before = (profile.support(kink + side * 1e-9)[1] for side in (1, -1))
    assert behind - before == pytest.approx(2.0 * BUMP, rel=1e-6)  # the spline's 4th-order error of 0.5 mm chords


def test_a_smooth_profile_has_none_but_where_it_is_open() -> None:
    assert kinks_between(OnPlane(Circle(RADIUS)), -10.0, 10.0) == []
    kinks = ellipse(160).kinks
    assert len(kinks) == 1
    assert kinks[0] == pytest.approx(math.pi, abs=1e-9)  # from one end of the symmetric curve to the other


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10**6), reverse=st.booleans())
def test_no_leap_of_a_noisy_profile_is_missed(seed: int, reverse: bool) -> None:
    rng = np.random.default_rng(seed)
    turn = np.linspace(-math.pi - 0.9, 0.9, 60)[:: -1 if reverse else 1]
    radius = RADIUS + rng.normal(0.0, 2e-4, 60)
    profile = Profile(radius * np.cos(turn), radius * np.sin(turn))
    angles = np.linspace(0.0, math.tau, 4001)
    places = np.array([profile.lowest(angle)[1:3] for angle in angles])
    steps = np.hypot(*np.diff(places, axis=0).T)
    kinks = np.array(profile.kinks)
    for i in np.flatnonzero(steps > 2e-3):  # 1.6 mrad at a radius of 1.3 m: no glide of these curves is so quick
        assert np.any((kinks >= angles[i] - 1e-9) & (kinks <= angles[i + 1] + 1e-9))
    for kink in kinks:
        behind, before = (profile.support(kink + side * 1e-10)[1] for side in (1, -1))
        assert behind - before > 0.0  # h is a maximum of smooth functions: it can only bend upwards


def test_a_plane_gives_them_in_the_order_of_the_motion() -> None:
    pair = OnPlane(two_bumps(), 0.05)
    (only,) = [kink for kink in kinks_between(pair, -0.3, 0.3) if abs(kink - 0.05) < 0.1]
    assert only == pytest.approx(0.05, abs=1e-12)
    assert kinks_between(pair, 0.3, -0.3) == kinks_between(pair, -0.3, 0.3)[::-1]
    assert any(abs(kink - 0.05 - math.tau) < 1e-9 for kink in kinks_between(pair, 6.0, 7.0))  # a whole turn on
    assert any(abs(kink - 0.05 + math.tau) < 1e-9 for kink in kinks_between(pair, -6.0, -7.0))
    assert kinks_between(pair, 0.2, 0.3) == []


def stretches(cut: Interval) -> list[tuple[float, float]]:
    """All stretches of an interval, begin and end [s]."""
    found, begin = [], 0.0
    while begin < cut.duration:
        end, following = stretch_from(cut, begin)
        found.append((begin, end))
        begin = following
    return found


def test_an_interval_is_cut_at_them() -> None:
    cut = interval(OnPlane(two_bumps()), -0.02, 0.03)
    (first, before), (behind, last) = stretches(cut)
    assert (first, last) == (0.0, cut.duration)
    assert 0.5 * (before + behind) == pytest.approx(0.4 * cut.duration, abs=1e-12)
    assert (behind - before) * cut.angle_rate == pytest.approx(2.0 * KINK_WIDTH, rel=1e-3)
    assert stretches(interval(OnPlane(two_bumps()), 0.02, 0.02)) == [(0.0, 0.01)]
    assert stretches(interval(OnPlane(Circle(RADIUS)), -1.0, 1.0)) == [(0.0, 0.01)]


@pytest.mark.parametrize("tilt", [0.0, 0.3])
def test_a_straight_row_of_points_leaps_from_end_to_end_and_no_more(tilt: float) -> None:
    x = np.linspace(-0.02, 0.02, 9)
    kinks = Profile(x, -0.03 + tilt * x).kinks
    # Level at -atan(tilt) and upside down half a turn on; which of the two is seen as one is rounding's choice.
    level = [math.remainder(kink + math.atan(tilt), math.pi) for kink in kinks]
    assert 1 <= len(kinks) <= 2
    assert level == pytest.approx([0.0] * len(kinks), abs=1e-9)  # rounding of depths over a leap of 40 mm
