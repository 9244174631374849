"""Estimates of every level for a walk, with constants of the other walk and with defaults, beside a regression."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from knee_contact_ros.joint_reaction.estimator import LEVELS, Deviation
from studies.load_validation.fitting import fitted, regression
from studies.load_validation.walks import DEFAULTS, Constants, Floats, Walk, axial

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
