"""Net moments against Lagrange's equations of the same leg, and against what is worked out by hand."""

from __future__ import annotations

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import (
    UNKNOWN,
    Ground,
    Joints,
    Leg,
    Motion,
    NetMoments,
    Turning,
    Vector,
    inclination,
    leg_of,
    net_moments,
)
from tests.joint_reaction.examples import LEG, STANDING_STILL, angles, ground, motion
from tests.joint_reaction.lagrange import GRAVITY, Chain, Holds, derivative, place, velocity

AIR = Ground((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
WEIGHTLESS = LEG._replace(shank_mass=0.0, shank_inertia=0.0, foot_mass=0.0, foot_inertia=0.0)
LOWER = (LEG.shank_mass + LEG.foot_mass) * GRAVITY
"""[N]"""
ROUNDINGS = 1e-10
"""[N m] or [N]: the reference subtracts powers up to 1e5 W, some ten roundings of 1e-16 of them"""
FEW = 1e-11
"""[N m] or [N]: some roundings of 1e-16 of the 3000 N at most that are added here"""
draws = st.integers(0, 2**32).map(Random)
bodies = st.builds(leg_of, st.floats(30.0, 200.0), st.floats(1.2, 2.2))


def by_lagrange(leg: Leg, joints: Joints, moving: Motion, under: Ground) -> Holds:
    turning = (moving.hip, moving.flexion, moving.ankle)
    return Chain(leg).holds(
        np.array([joints.hip, joints.flexion, joints.ankle]),
        np.array([one.rate for one in turning]),
        np.array([one.acceleration for one in turning]),
        np.array(under.force[:2]),
        under.torque[2],
    )


def still(joints: Joints, under: Ground, leg: Leg = LEG) -> NetMoments:
    return net_moments(leg, joints, STANDING_STILL, under)


def through(point: tuple[float, float], force: Vector, leg: Leg, joints: Joints) -> Ground:
    """A ground force whose line passes a point [m], told from the knee in the sagittal plane."""
    shank = inclination(joints)
    x, y = point[0] - leg.shank_length * math.sin(shank), point[1] + leg.shank_length * math.cos(shank)
    return Ground(force, (0.0, 0.0, x * force[1] - y * force[0]))


@given(draw=draws)
def test_the_velocities_of_the_reference_are_those_of_its_places(draw: Random) -> None:
    q, rate = np.array([[draw.uniform(-5.0, 5.0) for _ in range(3)] for _ in range(2)])
    for _, _, _, path in Chain(LEG).bodies:
        expected = derivative(lambda at, path=path: place(path, at), [q], [rate])
        assert velocity(path, q, rate) == pytest.approx(expected, abs=1e-13)  # roundings of 15 m/s


@given(leg=bodies, draw=draws)
def test_moments_and_compression_are_those_of_lagrange_and_newton(leg: Leg, draw: Random) -> None:
    joints, moving, under = angles(draw), motion(draw), ground(draw)
    expected = by_lagrange(leg, joints, moving, under)
    assert net_moments(leg, joints, moving, under)[:3] == pytest.approx(expected, abs=ROUNDINGS)


@given(draw=draws)
def test_a_foot_whose_ankle_is_not_known_is_one_body_with_the_shank(draw: Random) -> None:
    joints, moving, under = angles(draw), motion(draw), ground(draw)
    stiff = by_lagrange(LEG, joints._replace(ankle=0.0), moving._replace(ankle=Turning(0.0, 0.0)), under)
    found = net_moments(LEG, joints._replace(ankle=UNKNOWN), moving, under)
    assert found[:3] == pytest.approx(stiff, abs=ROUNDINGS)


@given(draw=draws)
def test_without_the_hip_the_foot_stands_flat_and_nothing_moves(draw: Random) -> None:
    joints, under = angles(draw), ground(draw)
    flat = joints._replace(hip=joints.flexion - joints.ankle)  # shank + ankle: 0
    expected = by_lagrange(LEG, flat, STANDING_STILL, under)
    found = net_moments(LEG, joints._replace(hip=UNKNOWN), motion(draw), under)
    assert found[:3] == pytest.approx(expected, abs=ROUNDINGS)
    assert found.frontal == pytest.approx(still(flat, under).frontal, abs=FEW)


def test_with_neither_hip_nor_ankle_nothing_is_known() -> None:
    assert all(map(math.isnan, still(Joints(0.3, UNKNOWN, UNKNOWN), AIR)))


@given(draw=draws)
def test_at_rest_it_counts_how_shank_and_foot_stand_and_not_how_the_thigh_does(draw: Random) -> None:
    joints, under, more = angles(draw), ground(draw), draw.uniform(-0.5, 0.5)
    leaning = joints._replace(hip=joints.hip + more, flexion=joints.flexion + more)
    assert still(leaning, under) == pytest.approx(still(joints, under), abs=FEW)


def test_standing_on_a_straight_leg() -> None:
    """Half of 75 kg through ankle and knee: the foot's weight alone bends the ankle, and the knee by as much."""
    found = still(Joints(0.0, 0.0, 0.0), Ground((0.0, 367.749375, 0.0), (0.0, 0.0, 0.0)))
    foot = 0.0145 * 75.0 * 9.80665 * 0.25 * 0.152 * 1.8  # [N m], its centre a quarter of a foot ahead
    assert found.plantarflexion == pytest.approx(-foot, abs=FEW)
    assert found.extension == pytest.approx(foot, abs=FEW)
    assert found.compression == pytest.approx(367.749375 - 0.061 * 75.0 * 9.80665, abs=FEW)
    assert found.frontal == pytest.approx(-367.749375 * 0.008 * 1.8, abs=FEW)


@given(draw=draws)
def test_a_force_through_the_knee_asks_nothing_of_it(draw: Random) -> None:
    joints, force = angles(draw), ground(draw).force
    assert still(joints, through((0.0, 0.0), force, WEIGHTLESS, joints), WEIGHTLESS).extension == pytest.approx(
        0, abs=FEW
    )


@given(draw=draws, ahead=st.floats(-0.2, 0.2))
def test_a_force_that_passes_behind_the_knee_asks_for_extension(draw: Random, ahead: float) -> None:
    joints = angles(draw)
    under = through((ahead, 0.0), (0.0, 800.0, 0.0), WEIGHTLESS, joints)
    assert still(joints, under, WEIGHTLESS).extension == pytest.approx(-800.0 * ahead, abs=FEW)


@pytest.mark.parametrize("ahead", [-0.05, 0.12])
def test_a_force_ahead_of_the_ankle_asks_for_plantarflexion(ahead: float) -> None:
    under = Ground((0.0, 800.0, 0.0), (0.0, 0.0, 800.0 * ahead))
    assert still(Joints(0.3, 0.2, 0.1), under, WEIGHTLESS).plantarflexion == pytest.approx(800.0 * ahead, abs=FEW)


@given(draw=draws)
def test_without_weight_the_knee_bears_the_forces_part_along_the_shank(draw: Random) -> None:
    joints, under = angles(draw), ground(draw)
    shank = joints.hip - joints.flexion
    along = -under.force[0] * math.sin(shank) + under.force[1] * math.cos(shank)
    assert still(joints, under, WEIGHTLESS).compression == pytest.approx(along, abs=FEW)


def test_a_shank_that_hangs_straight_pulls_with_its_weight_and_more_as_it_swings() -> None:
    hanging = Joints(0.0, 0.0, 0.0)
    assert still(hanging, AIR).compression == pytest.approx(-LOWER, abs=FEW)
    swinging = Motion(Turning(-6.0, 0.0), Turning(0.0, 0.0), Turning(0.0, 0.0))
    centres = LEG.shank_mass * LEG.shank_centre + LEG.foot_mass * (LEG.shank_length + LEG.foot_below)
    found = net_moments(LEG, hanging, swinging, AIR)
    assert found.compression == pytest.approx(-LOWER - 36.0 * centres, abs=FEW)


def test_a_shank_that_is_held_level_needs_an_extensor_for_its_weight() -> None:
    """Sitting: the foot at a right angle points up."""
    found = still(Joints(0.0, math.pi / 2.0, 0.0), AIR)
    arms = LEG.shank_mass * LEG.shank_centre + LEG.foot_mass * (LEG.shank_length + LEG.foot_below)
    assert found.extension == pytest.approx(GRAVITY * arms, abs=FEW)
    assert found.compression == pytest.approx(0.0, abs=FEW)


def test_a_shank_speeds_up_by_its_inertia_about_the_knee() -> None:
    """Hanging, with the foot as one body: inertia by Steiner's theorem."""
    kicked = Motion(Turning(0.0, -50.0), Turning(0.0, 0.0), Turning(0.0, 0.0))
    arm = math.hypot(LEG.foot_forward, LEG.shank_length + LEG.foot_below)
    inertia = LEG.shank_inertia + LEG.shank_mass * LEG.shank_centre**2 + LEG.foot_inertia + LEG.foot_mass * arm**2
    found = net_moments(LEG, Joints(0.0, 0.0, 0.0), kicked, AIR).extension - still(Joints(0.0, 0.0, 0.0), AIR).extension
    assert found == pytest.approx(50.0 * inertia, abs=FEW)


@given(draw=draws)
def test_mirrored_in_the_sagittal_plane_the_frontal_moment_alone_turns_round(draw: Random) -> None:
    joints, moving, (force, torque) = angles(draw), motion(draw), ground(draw)
    mirrored = Ground((force[0], force[1], -force[2]), (-torque[0], -torque[1], torque[2]))
    one = net_moments(LEG, joints, moving, Ground(force, torque))
    other = net_moments(LEG._replace(knee_offset=-LEG.knee_offset), joints, moving, mirrored)
    assert other == (*one[:3], -one.frontal)


@given(draw=draws)
def test_the_frontal_moment_is_that_of_all_the_grounds_wrench_about_the_knee(draw: Random) -> None:
    joints, (force, torque) = angles(draw), ground(draw)
    shank = joints.hip - joints.flexion
    down, forward = (
        np.array([math.sin(shank), -math.cos(shank), 0.0]),
        np.array([math.cos(shank), math.sin(shank), 0.0]),
    )
    ankle = LEG.shank_length * down - np.array([0.0, 0.0, LEG.knee_offset])
    moment = np.array(torque) + np.cross(ankle, force)
    assert still(joints, Ground(force, torque)).frontal == pytest.approx(-float(moment @ forward), abs=FEW)


def test_a_force_inwards_on_a_right_foot_is_borne_by_the_medial_side() -> None:
    """To the left, -z: what the femur exerts is about -x, as a compression at a medial place, of z < 0, is."""
    pushed = Ground((0.0, 0.0, -50.0), (0.0, 0.0, 0.0))
    assert still(Joints(0.0, 0.0, 0.0), pushed).frontal == pytest.approx(-50.0 * LEG.shank_length, abs=FEW)
