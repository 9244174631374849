"""The estimated total force: constants, errors, peaks, and whether the standard deviations that are told hold."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from knee_contact_ros import estimate_load
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, AxialDeviation, Estimator
from knee_contact_ros.joint_reaction.leg import GRAVITY, NOT_MEASURED, Ground
from knee_contact_ros.joint_reaction.muscles import Person as Constants
from knee_contact_ros.parameters.load_schema import PersonSection
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, MESSAGE_TYPES, stamp_to_ns
from studies.validation.data import SECOND, Flags, Floats, Walk

LANDING, MIDDLE = 0.1, 0.5
"""Parts of a stance: in the first one the force still falls from the heel strike's own peak, and has no peak"""
LEAST, MOST = (0.5, 0.0, 0.0), (2.5, 2.0, 1.0)
"""Bounds of moment_arm_scale, co_contraction and tone in a fit"""
DEFAULT = PersonSection()
FREE = ("moment_arm_scale", "co_contraction", "tone")


def constants(walk: Walk, values: Sequence[float] = (), delay: float | None = None) -> Constants:
    """Constants of a walk's person: `values` of `FREE`, or the defaults."""
    person = DEFAULT.constants._replace(
        mass=walk.person.body_weight / GRAVITY, height=walk.person.height
    )
    person = person._replace(**dict(zip(FREE, values, strict=bool(values))))
    return person if delay is None else person._replace(electromechanical_delay=delay)


def axial(walk: Walk, level: str, person: Constants) -> Floats:
    """Joint reaction [N] of a walk by a level, shape (n,), with the code of the node."""
    estimator, stamps = Estimator(level, person), np.rint(walk.time * SECOND).astype(np.int64)
    rows = zip(stamps.tolist(), walk.joints, walk.nets(level), walk.vertical.tolist(), strict=True)
    return np.array(
        [
            estimator.react(stamp, joints, Ground((0.0, force, 0.0), (NOT_MEASURED,) * 3), net, 0)[
                0
            ].axial
            for stamp, joints, net, force in rows
        ]
    )


def by_sensors(walk: Walk, level: str, values: Sequence[float]) -> float:
    """RMS error [body weights] of `estimate-load` on the bag of a walk, with our own inverse dynamics."""
    assert walk.sensors  # noqa: S101  (the caller chooses such walks)
    given = {"level": level} | {
        f"person.{name}": value for name, value in zip(FREE, values, strict=True)
    }
    body = {"person.mass": walk.person.body_weight / GRAVITY, "person.height": walk.person.height}
    found = estimate_load(str(walk.sensors), ["load/inverse_dynamics", given | body])
    measured = [
        (stamp_to_ns(each.message.header.stamp), -each.message.wrench.force.y)
        for each in read_bag(
            walk.sensors, {f"/{JOINT_REACTION_FORCE}": MESSAGE_TYPES[JOINT_REACTION_FORCE]}
        )
    ]
    stamps, forces = (np.array(column, dtype=np.float64) for column in zip(*measured, strict=True))
    error = found["axial_force"] - np.interp(found["stamp"].astype(np.float64), stamps, forces)
    return float(np.sqrt(np.mean(error**2))) / walk.person.body_weight


def weights(walks: Sequence[Walk]) -> list[float]:
    """Weight of each walk by which persons count the same, and walks of a person do."""
    names = [walk.person.name for walk in walks]
    return [1.0 / (names.count(name) * len(set(names))) for name in names]


def fitted(
    walks: Sequence[Walk], levels: Sequence[str], scale: float | None = None
) -> tuple[float, ...]:
    """Fit `FREE` to walks at levels by least squares of the error; `scale` is that of the moment arms, if given."""
    given = () if scale is None else (scale,)

    def misfit(numbers: Floats) -> Floats:
        return np.concatenate(
            [
                np.sqrt(weight / walk.used.sum())
                / walk.person.body_weight
                * (axial(walk, level, constants(walk, (*given, *numbers.tolist()))) - walk.total)[
                    walk.used
                ]
                for walk, weight in zip(walks, weights(walks), strict=True)
                for level in levels
            ]
        )

    begin = len(given)
    found = least_squares(
        misfit,
        (1.2, 0.4, 0.3)[begin:],
        bounds=(LEAST[begin:], MOST[begin:]),
        xtol=1e-4,
        ftol=1e-4,
        diff_step=1e-3,
    )
    return (*given, *(round(float(each), 3) for each in found.x))


def line(walks: Sequence[Walk]) -> Callable[[Walk], Floats]:
    """Line in the ground force, a + k F, fitted to walks: gives the axial force [N] of another one."""
    rows = [
        (
            np.sqrt(weight / walk.used.sum()),
            walk.vertical[walk.used] / walk.person.body_weight,
            walk.total[walk.used] / walk.person.body_weight,
        )
        for walk, weight in zip(walks, weights(walks), strict=True)
    ]
    known = np.concatenate(
        [np.stack((np.full(len(force), part), part * force), axis=1) for part, force, _ in rows]
    )
    offset, slope = np.linalg.lstsq(
        known, np.concatenate([part * total for part, _, total in rows]), rcond=None
    )[0]
    return lambda walk: np.asarray(offset * walk.person.body_weight + slope * walk.vertical)


def rms(walk: Walk, force: Floats, within: Flags | None = None) -> float:
    """RMS error [body weights] of an axial force [N], shape (n,), over the samples that are used."""
    error = (force - walk.total)[
        walk.used if within is None else walk.used & within
    ] / walk.person.body_weight
    return float(np.sqrt(np.mean(error**2)))


def peaks(walk: Walk, force: Floats) -> Floats:
    """Error of the largest force in both halves of every stance, as a part of the measured one, shape (m, 2)."""
    found = []
    for first, last in walk.steps():
        begin, duration = walk.time[first], walk.time[last] - walk.time[first]
        edges = [begin + part * duration for part in (LANDING, MIDDLE, 1.0)]
        halves = [(walk.time >= since) & (walk.time < until) for since, until in pairwise(edges)]
        found.append([force[half].max() / walk.total[half].max() - 1.0 for half in halves])
    return np.array(found).reshape(-1, 2)


class Estimate(NamedTuple):
    """An axial force that was estimated without what it is judged by."""

    walk: Walk
    level: str
    how: str
    """`OTHER_PERSON` or `OWN`"""
    values: tuple[float, ...]
    """Constants, see `FREE`"""
    force: Floats
    """Axial force [N], shape (n,)"""


OTHER_PERSON, OWN = "other man", "own trials"


def estimates(walks: Sequence[Walk]) -> list[Estimate]:
    """Estimates of all walks at all levels: with constants of the other person, and of the person's other trials."""
    found = []
    for walk in walks:
        others = [each for each in walks if each.person.name != walk.person.name]
        own = [each for each in walks if each.person.name == walk.person.name and each is not walk]
        shared = fitted(others, list(LOAD_LEVELS), DEFAULT.moment_arm_scale) if others else ()
        for level in LOAD_LEVELS:
            ways = [(OTHER_PERSON, shared)] if others else []
            ways += [(OWN, fitted(own, [level]))] if own else []
            found += [
                Estimate(walk, level, how, values, axial(walk, level, constants(walk, values)))
                for how, values in ways
            ]
    return found


def by_person(found: Sequence[Estimate], value: Callable[[Estimate], float]) -> dict[str, float]:
    """Mean of a value over the walks of each person."""
    names = dict.fromkeys(each.walk.person.name for each in found)
    return {
        name: float(np.mean([value(each) for each in found if each.walk.person.name == name]))
        for name in names
    }


def covered(each: Estimate, deviation: AxialDeviation, stance: bool) -> tuple[float, float]:
    """Parts of the used samples, in stance or in swing, whose error is within one and two standard deviations."""
    weight = each.walk.person.body_weight
    told = np.hypot(deviation.floor * weight, deviation.part * each.force)
    within = each.walk.used & (each.walk.stance == stance)
    off = (np.abs(each.force - each.walk.total) / told)[within]
    return float(np.mean(off < 1.0)), float(np.mean(off < 2.0))


WANTED = (0.68, 0.95)
"""Parts of the samples that one and two standard deviations shall cover"""
FLOORS, PARTS = np.arange(0.05, 0.61, 0.025), np.arange(0.0, 0.31, 0.025)


def deviation_of(found: Sequence[Estimate]) -> AxialDeviation:
    """Smallest deviation that covers `WANTED` in stance and in swing, on average over persons."""

    def short(deviation: AxialDeviation) -> float:
        parts = [
            by_person(found, lambda each, s=stance, w=which: covered(each, deviation, s)[w])  # type: ignore[misc]
            for stance in (True, False)
            for which in (0, 1)
        ]
        wanted = [*WANTED, *WANTED]
        return sum(
            max(want - float(np.mean(list(part.values()))), 0.0)
            for part, want in zip(parts, wanted, strict=True)
        )

    def size(deviation: AxialDeviation) -> float:
        return sum(
            float(
                np.mean(
                    np.hypot(
                        deviation.floor, deviation.part * each.force / each.walk.person.body_weight
                    )
                )
            )
            for each in found
        )

    tried = [AxialDeviation(float(floor), float(part)) for floor, part in product(FLOORS, PARTS)]
    return min(tried, key=lambda each: (round(float(short(each)), 4), size(each)))
