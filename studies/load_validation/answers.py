"""Estimates of the load of a walk: by default, fitted, varied; and how well they do."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from knee_contact_ros.joint_reaction.estimator import LEVELS, Deviation
from knee_contact_ros.joint_reaction.muscles import (
    ACHILLES,
    GASTROCNEMIUS,
    GASTROCNEMIUS_SHARE,
    HAMSTRINGS,
    QUADRICEPS,
    arm,
    muscles_of,
)
from studies.load_validation.walks import DEFAULTS, Constants, Flags, Floats, Walk, axial, moments_of

HALVES = ("first", "second")
LANDING = 0.1
"""Part of a stance, at its beginning, without peaks: the force still falls from the heel strike's own peak"""
MIDDLE = 0.5


class Score(NamedTuple):
    """Errors over the samples that are used, in body weights."""

    rms: float
    r: float
    mean: float
    stance: float
    """RMS error while the foot is on the ground"""
    swing: float
    """RMS error while it is not"""


class Peak(NamedTuple):
    """Largest force in a half of a stance."""

    half: str
    measured: float
    """Measured force [N]"""
    error: float
    """Error as a part of the measured force"""
    late: float
    """Time [s] by which it comes after the measured peak"""
    place: int
    """Index of the sample of the measured peak"""


def rms(error: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


def score(walk: Walk, force: Floats) -> Score:
    """Scores of an axial force [N], shape (n,), for a walk."""
    error = (force - walk.reference) / walk.weight
    used, stance = walk.used, walk.stance
    return Score(
        rms(error[used]), float(np.corrcoef(force[used], walk.reference[used])[0, 1]), float(error[used].mean()),
        rms(error[used & stance]), rms(error[used & ~stance]),
    )  # fmt: skip


def peaks(walk: Walk, force: Floats) -> list[Peak]:
    """Largest forces of both halves of every stance that is used as a whole."""
    found = []
    for first, last in walk.steps():
        begin, end = walk.time[first], walk.time[last]
        edges = [begin + part * (end - begin) for part in (LANDING, MIDDLE, 1.0)]
        for half, since, until in zip(HALVES, edges[:-1], edges[1:], strict=True):
            part = np.flatnonzero((walk.time >= since) & (walk.time < until))
            ours, theirs = int(part[force[part].argmax()]), int(part[walk.reference[part].argmax()])
            measured = float(walk.reference[theirs])
            late = float(walk.time[ours] - walk.time[theirs])
            found.append(Peak(half, measured, float(force[ours]) / measured - 1.0, late, theirs))
    return found


def covered(walk: Walk, force: Floats, deviation: Floats, within: Flags) -> tuple[float, float]:
    """Parts of the used samples `within`, shape (n,), whose error is below one and two standard deviations [N]."""
    off = (np.abs(force - walk.reference) / deviation)[walk.used & within]
    return float(np.mean(off < 1.0)), float(np.mean(off < 2.0))


FITTED, BY_DEFAULT, LINE = "fitted to the other", "defaults", "regression on the other"
REGRESSIONS = {"line in the ground force": False, "line in ground force and both moments": True}


class Answer(NamedTuple):
    """Estimate of the axial force of a walk, made without the walk's own reference."""

    walk: Walk
    level: str
    """Name of the level, or of the regression"""
    how: str
    constants: Constants | None
    force: Floats
    """Axial force [N], shape (n,)"""

    @property
    def deviation(self) -> Deviation:
        """Standard deviation of the force as the node states it."""
        error = LEVELS[self.level].error
        return error.calibrated if self.how == FITTED else error.uncalibrated

    def told(self) -> str:
        """The constants in the form of the tables."""
        return " / ".join(f"{each:.2f}" for each in self.constants) if self.constants else "-"


def answers(pair: Sequence[Walk]) -> list[Answer]:
    """Estimates for two walks of one person, with constants that were fitted to the other walk and with defaults."""
    found = []
    for walk, other in zip(pair, reversed(pair), strict=True):
        for level in LEVELS:
            for how, constants in ((FITTED, fitted(other, level)), (BY_DEFAULT, DEFAULTS)):
                found.append(Answer(walk, level, how, constants, axial(walk, level, constants)))
    return found


def lines(pair: Sequence[Walk]) -> list[Answer]:
    """Estimates by regressions on the other walk, for comparison."""
    return [
        Answer(walk, name, LINE, None, regression(other, walk, with_moments))
        for walk, other in zip(pair, reversed(pair), strict=True)
        for name, with_moments in REGRESSIONS.items()
    ]


LEAST, MOST = Constants(0.5, 0.0, 0.0), Constants(2.0, 2.0, 1.0)
"""Bounds of the constants in a fit"""
START = Constants(1.2, 0.4, 0.3)
Force = Callable[[Walk, str, Constants], Floats]


def fitted(walk: Walk, level: str, force: Force = axial, most_scale: float = MOST.moment_arm_scale) -> Constants:
    """Fit the constants by least squares of the error over the used samples of a walk.

    Args:
        walk: the one that is fitted to.
        level: of `LEVELS`.
        force: how an axial force comes from constants.
        most_scale: the most that `moment_arm_scale` may be.
    """

    def errors(numbers: Floats) -> Floats:
        found: Floats = (force(walk, level, Constants(*numbers.tolist())) - walk.reference)[walk.used] / walk.weight
        return found

    most = MOST._replace(moment_arm_scale=most_scale)
    start = START._replace(moment_arm_scale=min(START.moment_arm_scale, 0.5 * (LEAST.moment_arm_scale + most_scale)))
    found = least_squares(errors, start, bounds=(LEAST, most), xtol=1e-6, ftol=1e-6)
    return Constants(*(round(float(each), 4) for each in found.x))


def fitted_together(walks: Sequence[Walk], levels: Sequence[str], scale: float) -> Constants:
    """Fit co-contraction and tone to several walks at several levels, each of equal weight; the scale is given."""

    def errors(numbers: Floats) -> Floats:
        constants = Constants(scale, *numbers.tolist())
        parts = [
            (axial(walk, level, constants) - walk.reference)[walk.used] / walk.weight / np.sqrt(walk.used.sum())
            for walk in walks
            for level in levels
        ]
        return np.concatenate(parts)

    found = least_squares(errors, START[1:], bounds=(LEAST[1:], MOST[1:]), xtol=1e-6, ftol=1e-6)
    return Constants(scale, *(round(float(each), 4) for each in found.x))


def regression(fitted_to: Walk, walk: Walk, with_moments: bool) -> Floats:
    """Axial force [N], shape (n,), by a regression on the ground force and, if `with_moments`, on both moments.

    Args:
        fitted_to: least squares, where it is used.
        walk: what it is asked for.
        with_moments: of knee and ankle.
    """

    def columns(one: Walk) -> Floats:
        moments = moments_of(one) if with_moments else ()
        return np.stack([np.ones(len(one.time)), *(each / one.weight for each in (one.vertical, *moments))], axis=1)

    known, used = columns(fitted_to)[fitted_to.used], fitted_to.reference[fitted_to.used] / fitted_to.weight
    weights = np.linalg.lstsq(known, used, rcond=None)[0]
    found: Floats = walk.weight * (columns(walk) @ weights)
    return found


COSINE = math.cos(math.radians(20.0))
COACTIVE = 0.2
"""Part of the agonist's force beyond the floor that the antagonist exerts as well"""


class Held(NamedTuple):
    """Moment that muscles must balance, and the constants of the person."""

    extension: float
    """Net extending moment [N m]"""
    flexion: float
    """Flexion angle [rad]"""
    calf: float
    """Force of the gastrocnemius [N]"""
    floor: float
    """Least force of the muscles [N]"""
    scale: float
    """Scale of the moment arms"""

    def arms(self) -> tuple[float, float]:
        """Moment arms of extensors and flexors [m]."""
        return self.scale * arm(QUADRICEPS, self.flexion), self.scale * arm(HAMSTRINGS, self.flexion)

    def alone(self) -> float:
        """Force [N] of the side that is needed, without a floor and without the gastrocnemius' own."""
        extensor, flexor = self.arms()
        moment = self.extension + self.scale * arm(GASTROCNEMIUS, self.flexion) * self.calf
        return moment / extensor if moment > 0.0 else -moment / flexor


Rule = Callable[[Held], float]
"""Force [N] with which muscles compress the knee, as a function of the moment that they hold"""


def shipped(held: Held) -> float:
    """The rule of the package."""
    return muscles_of(held.extension, held.flexion, held.calf, held.floor, held.scale).total


def at_least(held: Held) -> float:
    """The floor counts for all muscles together: there is no force beyond the agonists' where they pull that much."""
    return max(held.alone() + held.calf, held.floor)


def on_top(held: Held) -> float:
    """The floor is added to the agonists' force."""
    return held.alone() + held.calf + held.floor


def coactive(held: Held) -> float:
    """Antagonists pull with a part of the agonists' force, which must balance these too."""
    extensor, flexor = held.arms()
    holding = held.extension + held.scale * arm(GASTROCNEMIUS, held.flexion) * held.calf
    antagonist_to_agonist = flexor / extensor if holding > 0.0 else extensor / flexor
    return shipped(held) + COACTIVE * held.alone() * (1.0 + antagonist_to_agonist)


def inclined(held: Held) -> float:
    """Tendons are inclined to the tibia by 20 degrees."""
    return COSINE * shipped(held)


def passive(held: Held) -> float:
    """Passive structures bear a part of the moment (Riener & Edrich 1999, doi:10.1016/S0021-9290(99)00009-3).

    Hip and ankle at 0 degrees.
    """
    degrees = math.degrees(held.flexion)
    flexing = math.exp(1.8 - 0.0352 * degrees) - math.exp(-3.971 + 0.0495 * degrees)
    flexing += math.exp(2.22 - 0.15 * degrees) - 4.82
    return shipped(held._replace(extension=held.extension + flexing))


class Variant(NamedTuple):
    """A rule, and the other changes that belong to it."""

    name: str
    rule: Rule = shipped
    share: float = GASTROCNEMIUS_SHARE
    most_scale: float = 2.0

    @property
    def of_the_calf(self) -> bool:
        """Whether it differs only where the ankle is known."""
        return self.share != GASTROCNEMIUS_SHARE


VARIANTS = (
    Variant("as it is"),
    Variant("moment arms of up to 3 times the published ones", most_scale=3.0),
    Variant("moment arms as published", most_scale=1.001),
    Variant("gastrocnemius share 0.2", share=0.2),
    Variant("gastrocnemius share 0.5", share=0.5),
    Variant("the floor is the least of all muscles together", at_least),
    Variant("the floor comes on top of the agonists", on_top),
    Variant(f"antagonists also pull with {COACTIVE:g} of what agonists do beyond the floor", coactive),
    Variant("tendons at 20° to the tibia", inclined),
    Variant("passive moment of the knee (Riener & Edrich 1999)", passive),
)


def force_by(variant: Variant, walk: Walk, level: str, constants: Constants) -> Floats:
    """The axial force [N], shape (n,), as `walks.axial` gives it, by a variant's rule."""
    person, found = walk.person(constants), []
    for joints, net, vertical in zip(walk.joints, walk.nets[level], walk.vertical.tolist(), strict=True):
        ankle = joints.ankle if math.isfinite(joints.ankle) else 0.0
        plantarflexion = max(net.plantarflexion, 0.0) if math.isfinite(net.plantarflexion) else 0.0
        calf = plantarflexion * variant.share / (person.moment_arm_scale * arm(ACHILLES, ankle))
        held = Held(net.extension, joints.flexion, calf, person.floor(vertical), person.moment_arm_scale)
        found.append(net.compression + variant.rule(held))
    return np.array(found)
