"""From net moments to what a knee bears: what the actuator takes, the muscles need not."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import UNKNOWN, Joints, NetMoments
from knee_contact_ros.joint_reaction.muscles import Person, reaction_of
from tests.joint_reaction.examples import PERSON

ROUNDINGS = 1e-12
"""Of what is added: some of 1e-16"""
moments, compressions, verticals = st.floats(-200.0, 200.0), st.floats(-100.0, 2000.0), st.floats(0.0, 2000.0)
WEIGHT = 75.0 * 9.80665


def net(extension: float, plantarflexion: float, compression: float = 400.0) -> NetMoments:
    return NetMoments(extension, plantarflexion, compression, 0.0)


@given(extension=moments, plantarflexion=moments, compression=compressions, vertical=verticals)
def test_the_knee_bears_compression_and_muscles(
    extension: float, plantarflexion: float, compression: float, vertical: float
) -> None:
    bears = reaction_of(PERSON, Joints(0.4, 0.1, 0.1), net(extension, plantarflexion, compression), vertical)
    assert bears.axial == pytest.approx(compression + sum(bears.muscles), rel=ROUNDINGS)
    assert (bears.extension, bears.plantarflexion) == (extension, plantarflexion)
    assert bears.muscles.total >= (0.2 * vertical + 0.05 * WEIGHT) * (1.0 - ROUNDINGS)


@given(extension=moments, plantarflexion=moments, knee=moments, ankle=moments)
def test_what_an_actuator_takes_is_as_if_it_were_not_asked_for(
    extension: float, plantarflexion: float, knee: float, ankle: float
) -> None:
    joints = Joints(0.4, 0.1, 0.1)
    helped = reaction_of(PERSON, joints._replace(knee_assistance=knee, ankle_assistance=ankle),
                         net(extension, plantarflexion), 500.0)  # fmt: skip
    assert helped == reaction_of(PERSON, joints, net(extension - knee, plantarflexion - ankle), 500.0)


@given(extension=moments, plantarflexion=moments, flexion=st.floats(0.0, 1.5))
def test_an_actuator_that_takes_all_leaves_the_floor(extension: float, plantarflexion: float, flexion: float) -> None:
    joints = Joints(flexion, 0.1, 0.1, extension, plantarflexion)
    bears = reaction_of(PERSON, joints, net(extension, plantarflexion), 500.0)
    floor = 0.2 * 500.0 + 0.05 * WEIGHT
    assert (bears.extension, bears.plantarflexion) == (0.0, 0.0)
    assert bears.muscles.gastrocnemius == 0.0
    assert min(bears.muscles[:2]) == pytest.approx(0.5 * floor, rel=ROUNDINGS)
    lazy = PERSON._replace(co_contraction=0.0, tone=0.0)
    assert reaction_of(lazy, joints, net(extension, plantarflexion), 500.0).axial == 400.0


def test_an_ankle_of_which_nothing_is_known_asks_for_no_calf() -> None:
    bears = reaction_of(PERSON, Joints(0.4, 0.1, UNKNOWN), net(20.0, UNKNOWN), 500.0)
    assert math.isnan(bears.plantarflexion)
    assert bears.muscles.gastrocnemius == 0.0
    assert math.isfinite(bears.axial)


def test_an_ankle_moment_without_its_angle_is_that_at_a_right_angle() -> None:
    told = [reaction_of(PERSON, Joints(0.4, 0.1, angle), net(20.0, 90.0), 500.0) for angle in (UNKNOWN, 0.0)]
    assert told[0] == told[1]
    assert told[0].muscles.gastrocnemius == pytest.approx(90.0 * 0.342 / (0.9 * 0.04573), rel=ROUNDINGS)


def test_the_floor_of_antagonists() -> None:
    assert PERSON.weight == pytest.approx(WEIGHT, rel=ROUNDINGS)
    assert PERSON.floor(1000.0) == pytest.approx(200.0 + 0.05 * WEIGHT, rel=ROUNDINGS)
    assert (
        PERSON.floor(-5.0) == PERSON.floor(0.0) == pytest.approx(0.05 * WEIGHT, rel=ROUNDINGS)
    )  # the ground does not pull


def test_longer_arms_need_less_force() -> None:
    weak, strong = (Person(75.0, 1.8, scale, 0.0, 0.0) for scale in (0.8, 1.6))
    one, other = (reaction_of(person, Joints(0.4, 0.1, 0.1), net(30.0, 60.0), 0.0).muscles for person in (weak, strong))
    assert tuple(one) == pytest.approx([2.0 * force for force in other], rel=ROUNDINGS)
