"""Forces of the muscles: by their arms they hold the moment that is asked for, antagonists pull, and nothing jumps."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction import muscles as package
from knee_contact_ros.joint_reaction.leg import Joints, NetMoments
from knee_contact_ros.joint_reaction.muscles import (
    ActivationLag,
    Muscles,
    moment_arm,
    muscles_of,
    reaction_of,
)
from tests.joint_reaction.examples import PERSON

MUSCLES = {
    "quadriceps": (
        package.QUADRICEPS_ARM,
        (-10.0, 110.0),
        {0: 44.63, 30: 45.84, 60: 37.52, 90: 27.32},
    ),
    "hamstrings": (
        package.HAMSTRINGS_ARM,
        (-10.0, 110.0),
        {0: 26.16, 30: 34.25, 60: 31.20, 90: 18.83},
    ),
    "gastrocnemius": (
        package.GASTROCNEMIUS_ARM,
        (-10.0, 110.0),
        {0: 22.20, 30: 20.92, 60: 17.74, 90: 13.73},
    ),
    "achilles": (
        package.ACHILLES_ARM,
        (-30.0, 25.0),
        {-20: 47.82, -10: 47.40, 0: 45.73, 20: 38.67},
    ),
}
"""Coefficients, range [deg], and arms [mm] at angles [deg]; each is a sum of powers, by hand"""
ROUNDINGS = 1e-12
"""Of the largest moment or force that is added: some of 1e-16"""
WEIGHT = 75.0 * 9.80665
moments, flexions = st.floats(-300.0, 300.0), st.floats(-0.1745, 1.9199)
calves, floors = st.just(0.0) | st.floats(0.0, 3000.0), st.just(0.0) | st.floats(0.0, 2000.0)
scales = st.floats(0.7, 1.4)


@pytest.mark.parametrize("name", MUSCLES)
def test_arms_are_the_polynomials_and_constant_beyond_their_range(name):
    coefficients, span, known = MUSCLES[name]
    for degrees, millimetres in known.items():  # with two decimals
        assert 1e3 * moment_arm(coefficients, math.radians(degrees)) == pytest.approx(
            millimetres, abs=0.0051
        )
    for angle in np.linspace(*np.radians(span), 200)[1:-1].tolist():
        expected = float(np.polynomial.polynomial.polyval(angle, coefficients))
        assert moment_arm(coefficients, angle) == pytest.approx(expected, rel=1e-14)  # roundings
        assert 0.005 < moment_arm(coefficients, angle) < 0.06
    for end, sign in zip(np.radians(span).tolist(), (-1.0, 1.0), strict=True):
        # the end is given with four decimals of a radian, and no arm changes by more than 0.05 m/rad
        assert moment_arm(coefficients, end + sign) == pytest.approx(
            moment_arm(coefficients, end), abs=0.05 * 5e-5
        )
        assert moment_arm(coefficients, end + 9.0 * sign) == moment_arm(coefficients, end + sign)


class Arms(NamedTuple):
    """[m] of a person at a flexion."""

    quadriceps: float
    hamstrings: float
    gastrocnemius: float

    def moment(self, muscles):
        extension = self.quadriceps * muscles.quadriceps
        return (
            extension
            - self.hamstrings * muscles.hamstrings
            - self.gastrocnemius * muscles.gastrocnemius
        )

    def at_rest(self, gastrocnemius, floor):
        """The moment that antagonists alone make, with no more than the floor: where the sides change."""
        return self.moment(
            Muscles(0.5 * floor, max(0.5 * floor - gastrocnemius, 0.0), gastrocnemius)
        )


def arms(flexion, scale=1.0):
    """By NumPy's polynomials."""
    curves = (package.QUADRICEPS_ARM, package.HAMSTRINGS_ARM, package.GASTROCNEMIUS_ARM)
    return Arms(*[scale * float(np.polynomial.polynomial.polyval(flexion, one)) for one in curves])


@given(moment=moments, flexion=flexions, calf=calves, floor=floors, scale=scales)
def test_the_forces_make_the_moment_that_is_asked_for_and_both_sides_pull_with_half_the_floor(
    moment, flexion, calf, floor, scale
):
    muscles, moment_arm = muscles_of(moment, flexion, calf, floor, scale), arms(flexion, scale)
    assert muscles.gastrocnemius == calf
    assert moment_arm.moment(muscles) == pytest.approx(moment, abs=ROUNDINGS * 400.0)
    assert min(muscles) >= 0.0
    assert muscles.quadriceps >= 0.5 * floor
    assert muscles.hamstrings + calf >= 0.5 * floor * (1.0 - ROUNDINGS)
    assert muscles.total == sum(muscles)
    # Beyond the floor, only the side that is needed pulls.
    if moment > moment_arm.at_rest(calf, floor) + ROUNDINGS * 400.0:
        assert muscles.hamstrings == max(0.5 * floor - calf, 0.0)
    elif moment < moment_arm.at_rest(calf, floor) - ROUNDINGS * 400.0:
        assert muscles.quadriceps == 0.5 * floor


MS = 1_000_000
"""[ns]"""


@pytest.mark.parametrize("step", [MS // 7, MS, 20 * MS, 500 * MS])
def test_the_lag_is_that_of_a_first_order_at_any_rate(step):
    """Of a need that rises by 1000 N/s from 200 N on: it is behind by 25 ms of that, once e^(-t / 25 ms) has faded."""
    lag = ActivationLag()
    for stamp in range(0, 1000 * MS + 1, step):
        found = lag.forces_at(stamp, Muscles(200.0 + 1e-6 * stamp, 0.0, 0.0), 0.025).quadriceps
        expected = 200.0 + 1e-6 * stamp - 25.0 * (1.0 - math.exp(-1e-9 * stamp / 0.025))
        assert found == pytest.approx(expected, rel=1e-9)  # sums of up to 7000 roundings
    assert lag.forces_at(stamp, Muscles(7.0, 8.0, 9.0), 0.025) == (
        7.0,
        8.0,
        9.0,
    )  # a stamp that is not later begins anew
    assert lag.forces_at(stamp + MS, Muscles(1.0, 2.0, 3.0), 0.0) == (1.0, 2.0, 3.0)
    lag.forget_forces()
    assert lag.forces_at(stamp + 2 * MS, Muscles(4.0, 5.0, 6.0), 0.025) == (4.0, 5.0, 6.0)


def test_the_gastrocnemius_by_hand():
    """A third of 100 N m, rather 0.342, at 45.73 mm; it does not push."""

    def calf(moment, ankle, scale=1.0):
        person = PERSON._replace(moment_arm_scale=scale)
        return reaction_of(
            person, Joints(0.3, 0.1, ankle), net(0.0, moment), 500.0
        ).muscles.gastrocnemius

    assert (
        calf(100.0, 0.0) == calf(100.0, math.nan) == pytest.approx(34.2 / 0.04573, rel=ROUNDINGS)
    )
    assert calf(100.0, 0.0, 0.9) == pytest.approx(38.0 / 0.04573, rel=ROUNDINGS)
    dorsiflexed = 0.04573 - 0.01311 * 0.3 - 0.02042 * 0.09
    assert calf(100.0, 0.3) == pytest.approx(34.2 / dorsiflexed, rel=ROUNDINGS)
    assert calf(-100.0, 0.3) == 0.0
    assert math.isnan(muscles_of(math.nan, 0.3, 0.0, 100.0, 1.0).total)


def net(extension, plantarflexion, compression=400.0):
    return NetMoments(extension, plantarflexion, compression, 0.0)


@given(
    extension=moments,
    plantarflexion=moments,
    knee=moments,
    ankle=moments,
    flexion=st.floats(0.0, 1.5),
)
def test_what_an_actuator_takes_is_as_if_it_were_not_asked_for(
    extension, plantarflexion, knee, ankle, flexion
):
    """One that takes all leaves the floor."""
    joints, asked = Joints(flexion, 0.1, 0.1), net(extension, plantarflexion)
    helped = reaction_of(
        PERSON, joints._replace(knee_assistance=knee, ankle_assistance=ankle), asked, 500.0
    )
    assert helped == reaction_of(
        PERSON, joints, net(extension - knee, plantarflexion - ankle), 500.0
    )
    assert helped.axial == pytest.approx(400.0 + sum(helped.muscles), rel=ROUNDINGS)
    floor = 0.2 * 500.0 + 0.05 * WEIGHT
    assert helped.muscles.total >= floor * (1.0 - ROUNDINGS)
    all_taken = joints._replace(knee_assistance=extension, ankle_assistance=plantarflexion)
    bears = reaction_of(PERSON, all_taken, asked, 500.0)
    assert (bears.extension, bears.plantarflexion, bears.muscles.gastrocnemius) == (0.0, 0.0, 0.0)
    assert min(bears.muscles[:2]) == pytest.approx(0.5 * floor, rel=ROUNDINGS)
    lazy = PERSON._replace(co_contraction=0.0, tone=0.0)
    assert reaction_of(lazy, all_taken, asked, 500.0).axial == 400.0
