"""Angles and ground forces of another convention are doubted; those of made-up persons in ours are not."""

import numpy as np
import pytest

from knee_contact_ros.joint_reaction.conventions import LegCheck
from knee_contact_ros.joint_reaction.leg import Ground, Joints

WEIGHT = 700.0


def stance(seed=None):
    """Flexion, hip, ankle [rad], force x, y, torque z of a stance, shape (n, 6), as published curves have them."""
    generator = np.random.default_rng(seed)

    def between(low, high):
        return 0.5 * (low + high) if seed is None else float(generator.uniform(low, high))

    part = np.linspace(0.02, 0.98, round(between(50, 140)))
    up = WEIGHT * between(0.9, 1.3) * np.sin(np.pi * part) ** between(0.3, 0.6)
    thigh = np.radians(between(18.0, 32.0) - between(35.0, 50.0) * part)
    flexion = np.radians(between(0.0, 12.0) + between(0.0, 20.0) * np.sin(2.0 * np.pi * part) ** 2)
    pitch = np.radians(between(-5.0, 0.0))
    forward = -WEIGHT * between(0.08, 0.25) * np.sin(2.0 * np.pi * part)
    place = between(-0.03, 0.03) + between(0.08, 0.16) * part
    ankle = pitch - thigh + flexion
    return np.column_stack([flexion, thigh, ankle, forward, up, place * up + 0.08 * forward])


def net(rows):
    """The same stance with the net moment of the knee as it is published, for torque z."""
    part = np.linspace(0.02, 0.98, len(rows))
    extends = 25.0 * np.sin(2.0 * np.pi * part) + 20.0 * np.sin(4.0 * np.pi * part - 0.6)
    flexion = np.radians(5.0 + 14.0 * np.sin(np.pi * np.minimum(part / 0.5, 1.0)) ** 2)
    flexion += np.radians(15.0) * np.clip((part - 0.7) / 0.3, 0.0, None) ** 2
    return np.column_stack([flexion + 0.1 * rows[:, 0], *rows[:, 1:5].T, extends])


STEP = 10_000_000
"""Time [ns] between two samples"""


def sentences(rows, is_net=False, weight=WEIGHT):
    seen = LegCheck(weight, is_net)
    for number, (flexion, hip, ankle, forward, up, moment) in enumerate(rows.tolist()):
        joints = Joints(flexion, hip, ankle)
        seen.add_sample(STEP * number, joints, Ground((forward, up, 0.0), (0.0, 0.0, moment)))
    return seen.sentences


def walk(seed=None, swing=0.42, strides=2):
    """Strides of an insole and an encoder: stances, and swings that last as long [s]."""
    stood = stance(seed)
    swung = np.tile([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], (round(1e9 * swing / STEP), 1))
    rows = np.concatenate([stood, swung] * strides + [stood])
    rows[:, [1, 2, 5]] = np.nan
    return rows


@pytest.mark.parametrize(
    ("rows", "kilograms", "told"),
    [
        (walk(), 150.0, True),  # for 71 kg
        (walk(strides=1), 150.0, True),
        (walk(), 80.0, False),
        (walk(swing=3.0), 150.0, False),  # stands up and sits down
        (walk() + np.radians([30, 0, 0, 0, 0, 0]), 150.0, False),  # pedals
        (stance(), 150.0, False),  # does not walk
    ],
)
def test_a_body_mass_of_another_person_is_doubted_where_a_leg_walks(rows, kilograms, told):
    said = sentences(rows, weight=9.80665 * kilograms)
    assert [each.startswith("the foot of a walking leg bears 0.5") for each in said] == [
        True
    ] * told
    assert sentences(rows, is_net=True, weight=9.80665 * kilograms) == []


@pytest.mark.parametrize("seed", range(0, 2000, 100))
def test_no_walker_of_two_thousand_is_too_heavy(seed):
    for one in range(seed, seed + 100):
        assert sentences(walk(one)) == [], one


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: rows + np.radians([0, 10, 0, 0, 0, 0]), "not to the pelvis"),
        (lambda rows: rows * [1, -1, 1, 1, 1, 1], "positive with the knee ahead"),
        (lambda rows: rows * [1, 1, 1, -1, 1, 1], "is the force's x forwards"),
        (lambda rows: rows * [1, 1, 1, 1, 1, -1], "mm behind the ankle"),
    ],
)
def test_another_convention_is_doubted(change, words):
    assert sentences(stance()) == []
    assert words in "; ".join(sentences(change(stance())))


def test_a_turned_net_moment_is_doubted():
    (said,) = sentences(net(stance()) * [1, 1, 1, 1, 1, -1], is_net=True)
    assert "is it positive if they extend it" in said


def test_two_thousand_persons_are_not_doubted():
    for seed in range(2000):
        rows = stance(seed)
        assert sentences(rows) == [], seed
        assert sentences(net(rows), is_net=True) == [], seed
        rows[:, [1, 2, 5]] = np.nan  # an insole and an encoder
        assert sentences(rows) == [], seed
