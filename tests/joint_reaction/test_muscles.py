"""Forces of the muscles: they hold the moment that is asked for, antagonists pull, and nothing jumps."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.muscles import (
    GASTROCNEMIUS,
    HAMSTRINGS,
    QUADRICEPS,
    Muscles,
    gastrocnemius_of,
    muscles_of,
)

ROUNDINGS = 1e-12
"""Of the largest moment or force that is added: some of 1e-16"""
moments, flexions = st.floats(-300.0, 300.0), st.floats(-0.1745, 1.9199)
calves, floors, scales = (
    st.just(0.0) | st.floats(0.0, 3000.0),
    st.just(0.0) | st.floats(0.0, 2000.0),
    st.floats(0.7, 1.4),
)


class Arms(NamedTuple):
    """[m] of a person at a flexion."""

    quadriceps: float
    hamstrings: float
    gastrocnemius: float

    def moment(self, muscles: Muscles) -> float:
        extension = self.quadriceps * muscles.quadriceps
        return extension - self.hamstrings * muscles.hamstrings - self.gastrocnemius * muscles.gastrocnemius

    def at_rest(self, gastrocnemius: float, floor: float) -> float:
        """The moment that antagonists alone make, with no more than the floor: where the sides change."""
        half = 0.5 * floor
        return self.moment(Muscles(half, max(half - gastrocnemius, 0.0), gastrocnemius))


def arms(flexion: float, scale: float = 1.0) -> Arms:
    """By NumPy's polynomials."""
    told = (QUADRICEPS, HAMSTRINGS, GASTROCNEMIUS)
    return Arms(*[scale * float(np.polynomial.polynomial.polyval(flexion, one)) for one in told])


@given(moment=moments, flexion=flexions, calf=calves, floor=floors, scale=scales)
def test_the_forces_make_the_moment_that_is_asked_for(
    moment: float, flexion: float, calf: float, floor: float, scale: float
) -> None:
    muscles = muscles_of(moment, flexion, calf, floor, scale)
    assert muscles.gastrocnemius == calf
    assert arms(flexion, scale).moment(muscles) == pytest.approx(moment, abs=ROUNDINGS * 400.0)


@given(moment=moments, flexion=flexions, calf=calves, floor=floors, scale=scales)
def test_no_muscle_pushes_and_both_sides_pull_with_half_the_floor(
    moment: float, flexion: float, calf: float, floor: float, scale: float
) -> None:
    muscles = muscles_of(moment, flexion, calf, floor, scale)
    assert min(muscles) >= 0.0
    assert muscles.quadriceps >= 0.5 * floor
    assert muscles.hamstrings + muscles.gastrocnemius >= 0.5 * floor * (1.0 - ROUNDINGS)
    assert muscles.total == sum(muscles)


@given(moment=moments, flexion=flexions, calf=calves, floor=floors, scale=scales)
def test_beyond_the_floor_one_side_alone_pulls(
    moment: float, flexion: float, calf: float, floor: float, scale: float
) -> None:
    muscles = muscles_of(moment, flexion, calf, floor, scale)
    flexors = muscles.hamstrings == max(0.5 * floor - calf, 0.0)
    assert flexors or muscles.quadriceps == 0.5 * floor


@given(flexion=flexions, calf=calves, floor=floors, scale=scales, step=st.floats(0.0, 1e-6))
def test_where_the_sides_change_nothing_jumps(
    flexion: float, calf: float, floor: float, scale: float, step: float
) -> None:
    arm = arms(flexion, scale)
    change = arm.at_rest(calf, floor)
    below, above = (np.array(muscles_of(change + side * step, flexion, calf, floor, scale)) for side in (-1.0, 1.0))
    # Of either side no more than the step by its arm; and some roundings of moments up to 400 N m by it
    assert above == pytest.approx(below, abs=(2.0 * step + ROUNDINGS * 400.0) / min(arm))


@given(flexion=flexions, calf=calves, floor=floors, scale=scales, extends=st.booleans())
def test_the_more_a_side_must_hold_the_more_the_muscles_press(
    flexion: float, calf: float, floor: float, scale: float, extends: bool
) -> None:
    change, sign = arms(flexion, scale).at_rest(calf, floor), 1.0 if extends else -1.0
    more = [change + sign * beyond for beyond in np.linspace(0.0, 300.0, 30).tolist()]
    total = [muscles_of(moment, flexion, calf, floor, scale).total for moment in more]
    assert all(later > earlier for earlier, later in pairwise(total))
    arm = arms(flexion, scale).quadriceps if extends else arms(flexion, scale).hamstrings
    assert total[-1] - total[0] == pytest.approx(300.0 / arm, rel=1e-9)  # 1e-12 of the moments, with levers apart


@given(flexion=flexions, scale=scales, pair=st.tuples(moments, moments))
def test_without_floor_and_calf_a_larger_moment_presses_more(
    flexion: float, scale: float, pair: tuple[float, float]
) -> None:
    less, more = sorted(pair, key=abs)
    for sign in (-1.0, 1.0):
        total = [muscles_of(sign * abs(moment), flexion, 0.0, 0.0, scale).total for moment in (less, more)]
        assert total[1] >= total[0]


@given(flexion=flexions, floor=floors, scale=scales)
def test_a_moment_of_nothing_leaves_the_floor(flexion: float, floor: float, scale: float) -> None:
    """Half of it on the side with the longer arm, and on the other one what holds it."""
    muscles, (extends, bends, _) = muscles_of(0.0, flexion, 0.0, floor, scale), arms(flexion, scale)
    longer, shorter = max(extends, bends), min(extends, bends)
    assert min(muscles[:2]) == pytest.approx(0.5 * floor, rel=ROUNDINGS)
    assert max(muscles[:2]) == pytest.approx(0.5 * floor * longer / shorter, rel=1e3 * ROUNDINGS)  # by differences
    assert muscles.gastrocnemius == 0.0


def test_forces_by_hand() -> None:
    """Of a straight knee: arms of 44.63, 26.16 and 22.20 mm."""
    assert muscles_of(44.63, 0.0, 0.0, 0.0, 1.0) == pytest.approx((1000.0, 0.0, 0.0), rel=ROUNDINGS)
    assert muscles_of(-26.16, 0.0, 0.0, 0.0, 1.0) == pytest.approx((0.0, 1000.0, 0.0), rel=ROUNDINGS)
    assert muscles_of(44.63, 0.0, 0.0, 0.0, 2.0) == pytest.approx((500.0, 0.0, 0.0), rel=ROUNDINGS)
    against_calf = (1000.0 + 22.20 / 44.63 * 500.0, 0.0, 500.0)
    assert muscles_of(44.63, 0.0, 500.0, 0.0, 1.0) == pytest.approx(against_calf, rel=ROUNDINGS)
    against_both = (1000.0 + (22.20 * 50.0 + 26.16 * 150.0) / 44.63, 150.0, 50.0)
    assert muscles_of(44.63, 0.0, 50.0, 400.0, 1.0) == pytest.approx(against_both, rel=ROUNDINGS)


def test_the_gastrocnemius_by_hand() -> None:
    """A third of 100 N m, rather 0.342, at 45.73 mm; it does not push."""
    assert gastrocnemius_of(100.0, 0.0, 1.0) == pytest.approx(34.2 / 0.04573, rel=ROUNDINGS)
    assert gastrocnemius_of(100.0, 0.0, 0.9) == pytest.approx(38.0 / 0.04573, rel=ROUNDINGS)
    dorsiflexed = 0.04573 - 0.01311 * 0.3 - 0.02042 * 0.09
    assert gastrocnemius_of(100.0, 0.3, 1.0) == pytest.approx(34.2 / dorsiflexed, rel=ROUNDINGS)
    assert gastrocnemius_of(-100.0, 0.3, 1.0) == 0.0


def test_what_is_not_known_is_not_made_up() -> None:
    assert math.isnan(muscles_of(math.nan, 0.3, 0.0, 100.0, 1.0).total)
