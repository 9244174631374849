"""A person, a leg, and what its sensors tell, drawn at random."""

import math
from random import Random

from knee_contact_ros.joint_reaction.leg import (
    NOT_TURNING,
    Ground,
    Joints,
    LegMotion,
    Turning,
    leg_of,
)
from knee_contact_ros.joint_reaction.muscles import Person

PERSON = Person(75.0, 1.8, 0.9, 0.2, 0.05, 0.0, 0.0)
"""Of muscles that pull at once, by the sensors alone"""
LEG = leg_of(PERSON.mass, PERSON.height)
MS = 1_000_000
"""[ns]"""
EPOCH = 1_700_000_000_000_000_000
"""[ns] a stamp of today"""
STANDING_STILL = LegMotion(NOT_TURNING, NOT_TURNING, NOT_TURNING)


def angles(draw):
    return Joints(draw.uniform(-0.2, 2.2), draw.uniform(-1.5, 1.5), draw.uniform(-0.8, 0.6))


def motion(draw):
    return LegMotion(
        *[Turning(draw.uniform(-10.0, 10.0), draw.uniform(-200.0, 200.0)) for _ in range(3)]
    )


def ground(draw):
    """Of more than a person who jumps."""
    force = (draw.uniform(-500.0, 500.0), draw.uniform(-50.0, 3000.0), draw.uniform(-300.0, 300.0))
    return Ground(
        force, (draw.uniform(-50.0, 50.0), draw.uniform(-50.0, 50.0), draw.uniform(-200.0, 200.0))
    )


def walking(count, step=MS, shaken=0.0):
    """Angles of joints that turn about as in walking; stamps [ns] a step apart, shaken by a part of it at most."""
    draw, samples, stamp = Random(3), [], EPOCH
    for _ in range(count):
        stamp += round(step * (1.0 + shaken * draw.uniform(-1.0, 1.0)))
        time = 1e-9 * (stamp - EPOCH)
        joints = Joints(
            0.5 + 0.5 * math.sin(6.0 * time),
            0.3 * math.sin(5.0 * time),
            0.2 * math.sin(7.0 * time),
        )
        samples.append((stamp, joints))
    return samples
