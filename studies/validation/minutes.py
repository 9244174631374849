"""What `calibrate` finds in a walk without an implant, and what that is worth on strides that it has not seen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import fmean
from typing import NamedTuple

import numpy as np

from knee_contact_ros.joint_reaction.leg import Joints
from knee_contact_ros.joint_reaction.walking import StrideLoads
from knee_contact_ros.lab.calibrate.walk import (
    CLOCK,
    DEVIATIONS,
    KEPT,
    MASS,
    MEAN_FLEXION,
    ZERO,
    Recorded,
    StrideFlexion,
    Walked,
    compare_walk,
    stride_points,
    strides_of,
    weight_walked,
)
from studies.validation.data import MARGIN, SENSOR_LEVELS, Walk, nets_of
from studies.validation.total import (
    OTHERS,
    Estimate,
    axial,
    constants,
    mean_loads,
    person_mean,
    rms,
    weights,
)

LONG = 8.0
"""Duration [s] beyond which a walk is cut into halves, so that one is judged by what the other one tells"""
ROWS = ("time", "vertical", "total", "medial", "frontal", "external", "joints", "grounds", "used")
"""Fields of a walk that have a value for each sample"""
STANCE_POINTS = len(MEAN_FLEXION.stance)


class Fault(NamedTuple):
    """What is wrong with the sensors of a leg."""

    name: str
    offset: float = 0.0
    """Flexion [rad] that is told beyond the true one"""
    delay: float = 0.0
    """Time [s] by which all angles are late"""
    mass: float = 1.0
    """Body mass that is given, relative to the true one"""


FAULTS = (
    Fault("none"),
    Fault("30 ms late", delay=0.03),
    Fault("30 ms early", delay=-0.03),
    Fault("zero 5° high", offset=math.radians(5.0)),
    Fault("zero 20° high", offset=math.radians(20.0)),
    Fault("mass 5 % high", mass=1.05),
    Fault("mass 30 % high", mass=1.3),
)


def cut(walks: Sequence[Walk]) -> list[Walk]:
    """Walks, and those that are long as two halves."""
    found = []
    for walk in walks:
        middle = len(walk.time) // 2
        long = walk.time[-1] - walk.time[0] > LONG
        parts = (slice(middle), slice(middle, None)) if long else (slice(None),)
        for number, part in enumerate(parts):
            rows = {name: getattr(walk, name)[part] for name in ROWS}
            nets = {level: each[part] for level, each in walk.nets.items()}
            found.append(walk._replace(name=f"{walk.name} {number}", nets=nets, **rows))
    return found


def recorded(walk: Walk) -> Recorded:
    """What the leg's sensors recorded; the file of one stride ends at the next heel strike, which is added."""
    time, flexion, force = walk.time, walk.flexion, walk.vertical / walk.person.body_weight
    if not strides_of(Recorded(time, flexion, force)):
        time = np.append(time, 2.0 * time[-1] - time[-2])
        flexion, force = np.append(flexion, 2.0 * flexion[-1] - flexion[-2]), np.append(force, 1.0)
    return Recorded(time, flexion, force)


def mean_flexion(walks: Sequence[Walk]) -> StrideFlexion:
    """Mean flexion [rad] over the strides of walks; persons count the same, and so do the sessions of one."""
    curves, parts = [], []
    walks = [walk for walk in walks if strides_of(recorded(walk))]
    for walk, part in zip(walks, weights(walks), strict=True):
        each = recorded(walk)
        strides = strides_of(each)
        curves += [
            np.interp(stride_points(stride, MEAN_FLEXION), each.time, each.flexion)
            for stride in strides
        ]
        parts += [part / len(strides)] * len(strides)
    mean = np.average(curves, axis=0, weights=parts).tolist()
    return StrideFlexion(tuple(mean[:STANCE_POINTS]), tuple(mean[STANCE_POINTS:]))


def with_fault(walk: Walk, fault: Fault) -> Walk:
    """Return the walk as faulty sensors tell it: angles, mass, and the moments that follow at levels of sensors."""
    rows = np.array([joints[:3] for joints in walk.joints]).T
    late = np.array([np.interp(walk.time - fault.delay, walk.time, row) for row in rows])
    late[0] += fault.offset
    joints = [Joints(*row) for row in late.T.tolist()]
    person = walk.person._replace(body_weight=walk.person.body_weight * fault.mass)
    nets = nets_of(person, walk.time, joints, walk.grounds, levels(walk))
    return walk._replace(person=person, joints=joints, nets=nets)


def levels(walk: Walk) -> list[str]:
    """Levels whose moments follow from the sensors of a walk."""
    return SENSOR_LEVELS if math.isfinite(walk.grounds[0].torque[2]) else SENSOR_LEVELS[:1]


def left_over(fault: Fault, walked: Walked, weight: float) -> Fault:
    """Return what is left of a fault after calibration, from what right sensors of the same walk would tell."""
    found = {
        ZERO: fault.offset + walked.offset,
        CLOCK: fault.delay + walked.delay,
        MASS: weight / fault.mass - 1.0,
    }
    used = {
        name: value if abs(value) > KEPT * DEVIATIONS[name] else 0.0
        for name, value in found.items()
    }
    return Fault(
        fault.name,
        fault.offset - used[ZERO],
        fault.delay - used[CLOCK],
        fault.mass * (1.0 + used[MASS]),
    )


def error(
    walk: Walk, fault: Fault, level: str, values: Sequence[float], loads: StrideLoads
) -> float:
    """RMS error [true body weights] of the estimate with faulty sensors, `MARGIN` away from the recording's ends."""
    told = with_fault(walk, fault)
    inside = (walk.time > walk.time[0] + MARGIN) & (walk.time < walk.time[-1] - MARGIN)
    return rms(walk, axial(told, level, constants(told, values), loads), inside)


class Told(NamedTuple):
    """What the walk of a session tells by the mean of the other persons."""

    offset: float
    """Flexion [rad] beyond theirs"""
    delay: float
    """Time [s] by which the angles are late"""
    weight: float
    """Twice the mean force of a stride, relative to the body weight"""


def told(walks: Sequence[Walk]) -> dict[str, Told]:
    """What the walks of each session tell; right sensors would tell 0, 0 and 1 if all people were alike."""
    found = {}
    for key in dict.fromkeys(walk.key for walk in walks):
        mine = [recorded(walk) for walk in walks if walk.key == key]
        others = [walk for walk in walks if walk.person.name != key.split()[0]]
        walked = compare_walk(mine, mean_flexion(others))
        found[key] = Told(walked.offset, walked.delay, weight_walked(mine))
    return found


def worth(
    walks: Sequence[Walk], timed: Sequence[Walk], found: Sequence[Estimate]
) -> dict[Fault, dict[str, tuple[float, float]]]:
    """Errors [BW] by fault and level: with the fault, and calibrated on the other strides of the session.

    Args:
        walks: Level walks as recorded.
        timed: The same with implants on the sensors' clock, for the mean loads of the other persons.
        found: Estimates, which have the constants of the other persons.
    """
    values = {each.walk.person.name: each.values for each in found if each.how == OTHERS}
    parts, errors = cut(walks), dict[tuple[Fault, str], dict[str, list[tuple[float, float]]]]()
    for name, given in values.items():
        shape = mean_flexion([walk for walk in walks if walk.person.name != name])
        loads = mean_loads([walk for walk in timed if walk.person.name != name])
        for walk in parts:
            if walk.person.name != name:
                continue
            rest = [
                recorded(each) for each in parts if each.key == walk.key and each.name != walk.name
            ]
            walked, weight = compare_walk(rest, shape), weight_walked(rest)
            for fault in FAULTS:
                left = left_over(fault, walked, weight)
                for level in levels(walk):
                    pair = [error(walk, each, level, given, loads) for each in (fault, left)]
                    mine = errors.setdefault((fault, level), {})
                    mine.setdefault(walk.key, []).append((pair[0], pair[1]))
    means = dict[Fault, dict[str, tuple[float, float]]]()
    for (fault, level), sessions in errors.items():
        before, after = (
            person_mean(
                {key: fmean(pair[which] for pair in pairs) for key, pairs in sessions.items()}
            )
            for which in (0, 1)
        )
        means.setdefault(fault, {})[level] = before, after
    return means
