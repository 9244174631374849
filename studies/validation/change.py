"""The sign of a peak's change under simulated assistance at the knee: as it is estimated, and as it is simulated.

Simulated is the measured force of a walk, changed by what the person's own muscles would do: the rule of the level that
knows most, with constants of this person, an actuator's torque, and co-contraction that changes with it by an amount
that nobody is told. The estimate has constants of the other person, and knows the torque alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.validation.data import SENSOR_LEVELS, Floats, Walk
from studies.validation.total import DEFAULT, LEAST_CHANGE, axial, constants, fitted, peaks

TORQUES = (-15.0, -10.0, 10.0, 15.0, 20.0)
"""Largest torques [N m]; positive ones extend the knee"""
TIMINGS = ((0.0, 0.5), (0.4, 1.0), (0.0, 1.0))
"""Parts of a stance between which an actuator pulls, as half a sine"""
HABITS = (-0.1, 0.0, 0.1)
"""Changes of `co_contraction` with assistance"""


def torque_of(walk: Walk, largest: float, timing: tuple[float, float]) -> Floats:
    """Torque [N m] of an actuator in every stance, shape (n,)."""
    found = np.zeros(len(walk.time))
    for first, last in walk.steps():
        phase = (walk.time - walk.time[first]) / (walk.time[last] - walk.time[first])
        part = (phase - timing[0]) / (timing[1] - timing[0])
        found += np.where(
            (part > 0.0) & (part < 1.0), largest * np.sin(np.pi * np.clip(part, 0.0, 1.0)), 0.0
        )
    return found


def assisted(walk: Walk, torque: Floats) -> Walk:
    """A walk with an actuator that extends the knee by a torque [N m], shape (n,)."""
    pairs = zip(walk.joints, torque.tolist(), strict=True)
    return walk._replace(joints=[joints._replace(knee_assistance=each) for joints, each in pairs])


def right(walks: Sequence[Walk]) -> dict[str, tuple[float, float, int, int]]:
    """Parts of the changes at first and second peaks whose sign is right, and how many were asked for, by level."""
    found: dict[str, list[list[float]]] = {level: [[], []] for level in SENSOR_LEVELS}
    for name in dict.fromkeys(walk.person.name for walk in walks):
        own = [walk for walk in walks if walk.person.name == name]
        others = [walk for walk in walks if walk.person.name != name]
        own_values = fitted(own, ["ankle_moment"])
        values = fitted(others, SENSOR_LEVELS, DEFAULT.moment_arm_scale)
        for walk in own:
            truly, guessed = constants(walk, own_values), constants(walk, values)
            before = axial(walk, "ankle_moment", truly)
            alone = {level: peaks(walk, axial(walk, level, guessed)) for level in SENSOR_LEVELS}
            for largest in TORQUES:
                for timing in TIMINGS:
                    helped = assisted(walk, torque_of(walk, largest, timing))
                    changed = {
                        level: peaks(walk, axial(helped, level, guessed)) - alone[level]
                        for level in SENSOR_LEVELS
                    }
                    for habit in HABITS:
                        person = truly._replace(
                            co_contraction=truly.co_contraction * (1.0 + habit)
                        )
                        after = walk.total + axial(helped, "ankle_moment", person) - before
                        asked = peaks(walk, after) - peaks(walk, walk.total)
                        for which in (0, 1):
                            large = np.abs(asked[:, which]) >= LEAST_CHANGE
                            for level, guess in changed.items():
                                same = np.sign(guess[:, which]) == np.sign(asked[:, which])
                                found[level][which] += (
                                    [float(same[large].mean())] if large.any() else []
                                )
    return {
        level: (float(np.mean(one)), float(np.mean(two)), len(one), len(two))
        for level, (one, two) in found.items()
    }
