"""A leg's proportions, worked out from the published table."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import leg_of


def test_a_leg_of_100_kg_and_2_m() -> None:
    """Winter 2009: table 4.1 (leg and foot; the foot from ankle to second metatarsal), figure 4.1 (lengths)."""
    leg = leg_of(100.0, 2.0)
    told = (leg.thigh_length, leg.shank_length, leg.shank_mass, leg.foot_mass)
    assert told == pytest.approx((0.490, 0.492, 4.65, 1.45), rel=1e-14)  # roundings, here as below
    assert leg.shank_centre == pytest.approx(0.433 * 0.492, rel=1e-14)
    assert leg.shank_inertia == pytest.approx(4.65 * (0.302 * 0.492) ** 2, rel=1e-14)
    foot = (0.152**2 + 0.078**2) ** 0.5  # [m] half a foot's length ahead, an ankle's height down
    assert (leg.foot_forward, leg.foot_below) == pytest.approx((0.076, 0.039), rel=1e-14)
    assert leg.foot_inertia == pytest.approx(1.45 * (0.475 * foot) ** 2, rel=1e-14)
    assert leg.knee_offset == pytest.approx(0.016, rel=1e-14)


@given(mass=st.floats(20.0, 250.0), height=st.floats(0.8, 2.4), factor=st.floats(0.5, 2.0))
def test_lengths_grow_with_the_height_and_masses_with_the_mass(mass: float, height: float, factor: float) -> None:
    one, taller, heavier = leg_of(mass, height), leg_of(mass, factor * height), leg_of(factor * mass, height)
    for name, value in one._asdict().items():
        by_height, by_mass = (0, 1) if name.endswith("mass") else (2, 1) if name.endswith("inertia") else (1, 0)
        assert getattr(taller, name) == pytest.approx(value * factor**by_height, rel=1e-14)  # roundings
        assert getattr(heavier, name) == pytest.approx(value * factor**by_mass, rel=1e-14)
