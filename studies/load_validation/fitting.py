"""A person's constants, fitted to a walk; and a plain regression beside them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import least_squares

from studies.load_validation.knee import moments_of
from studies.load_validation.walks import Constants, Floats, Walk, axial

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
