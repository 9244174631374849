"""The exact answers do not depend on how a piecewise linear motion is cut into ticks: no touch is missed."""

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")
pytest.importorskip("numba", reason="needs the extra compile")

from studies.honesty.cut import rows
from tests.helpers.needs import needs_compiler
from tests.helpers.scenes import law, model
from tests.model.scenes import ellipse, signed, thrown

pytestmark = needs_compiler


def test_a_motion_that_is_cut_otherwise_has_the_same_answers():
    """Next to no load, slow ticks, fast turns, live changes: in 1 and 4 parts as in 64."""
    found = [one for seed in range(1_000_000, 1_000_016) for one in rows(seed)]
    assert [one for one in found if one.wrong or one.not_finite] == []
    assert sum(one.known for one in found) > 300
    assert sum(one.covered for one in found) >= 0.99 * sum(one.known for one in found)


@pytest.mark.parametrize("seed", [5013002149, 5013002600])
def test_a_released_contact_that_leaps_from_dent_to_dent_presses_after_a_leap(seed):
    """A dashpot pulls, and lets go; the next dent comes down fast, and presses for a moment between two looks."""
    assert [one for one in rows(seed) if one.wrong or one.known != 20 or one.covered < 19] == []


def test_a_contact_that_parts_within_a_step_and_meets_the_next_dent_begins_anew():
    """The law remembers how a contact began: 0.37 m/s instead of a tenth of it."""
    assert [one for one in rows(6301051493) if one.wrong] == []


@pytest.mark.parametrize("seed", [6700000088, 6700000472])
def test_a_leap_from_dent_to_dent_counts_what_the_dashpot_jumps_by_at_an_unknown_time(seed):
    """12 and 9 of 40 depths were not covered, by up to five times."""
    assert [one for one in rows(seed) if one.wrong or one.covered < one.known] == []


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("brush", [0.07, 0.31, 0.62, 0.93])
@pytest.mark.parametrize("deep", [1e-4, 3e-4])
def test_a_flight_sees_a_turning_profile_brush_the_plateau(deep, brush, parts):
    """Half axes of 34 and 28 mm: the longer one points down at a right angle, at a part of the tick."""
    begin, end = 0.5 * np.pi - 0.6 * brush, 0.5 * np.pi + 0.6 * (1.0 - brush)
    knee, geometry = model(law("hertz"), 1e-8, ellipse(320), mass=2.0), ellipse(320)
    above = geometry.support(0.5 * np.pi)[0] - deep - geometry.support(begin)[0]
    if above <= 0.0 or geometry.support(end)[0] - geometry.support(begin)[0] >= above:
        above = 0.5 * (geometry.support(0.5 * np.pi)[0] - geometry.support(begin)[0])
    found, exact = (
        thrown(knee, -above, 0.0, 0.01, turn=(begin, end), parts=n) for n in (parts, 60)
    )
    assert found.femoral_height > geometry.support(begin)[0] + above + 1e-8  # thrown off
    assert abs(signed(found) - signed(exact)) <= found.error_estimate + exact.error_estimate


@pytest.mark.parametrize(
    ("depth", "rate", "load", "end_load"),
    [
        (0.0, -0.0028, 8.0, -56.0),  # leaves, turns back, touches and is let go
        (-1e-7, -0.0028, 8.0, -56.0),
        (-2e-6, 0.0, 3.0, -30.0),
        (0.0, -0.07, 50.0, 50.0),
        (-1e-12, -0.07, 50.0, 50.0),
        (
            1e-4,
            -0.01578,
            50.0,
            -200.0,
        ),  # released, presses again for a moment while the surfaces overlap
        (1e-4, -0.02, 50.0, 50.0),
        (1e-4, -0.5, 5e3, 0.0),
    ],
)
@pytest.mark.parametrize("duration", [0.01, 0.016, 0.03, 0.1])
def test_a_flight_sees_a_load_press_the_surfaces_together_for_a_moment(
    depth, rate, load, end_load, duration
):
    """A circle on a plane, of which the exact flight is a parabola: one tick has the answer of 60."""
    knee = model(law("kelvin_voigt"), 1e-8)
    found, exact = (
        thrown(knee, depth, rate, duration, load, end_load, parts=parts) for parts in (1, 60)
    )
    assert (
        abs(signed(found) - signed(exact)) <= found.error_estimate + exact.error_estimate + 1e-14
    )
    # What has touched is not known better than that; nothing here is out of the tolerance by more than a late landing
    assert found.error_estimate < 1e-6
