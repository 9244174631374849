"""What every level says of a walk, with constants of another one, with defaults; and a regression beside them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from knee_contact_ros.joint_reaction.levels import LEVELS, Deviation
from studies.load_validation.fitting import fitted, regression
from studies.load_validation.walks import DEFAULTS, Constants, Floats, Walk, axial

FITTED, BY_DEFAULT, LINE = "fitted to the other", "defaults", "regression on the other"
REGRESSIONS = {"line in the ground force": False, "line in ground force and both moments": True}


class Answer(NamedTuple):
    """An axial force of a walk, none of whose reference was seen."""

    walk: Walk
    level: str
    """Or what the regression is in"""
    how: str
    constants: Constants | None
    force: Floats
    """[N], shape (n,)"""

    @property
    def deviation(self) -> Deviation:
        """The standard deviation that the node tells."""
        error = LEVELS[self.level].error
        return error.calibrated if self.how == FITTED else error.uncalibrated

    def told(self) -> str:
        """The constants, for a table."""
        return " / ".join(f"{each:.2f}" for each in self.constants) if self.constants else "-"


def answers(pair: Sequence[Walk]) -> list[Answer]:
    """Of two walks of one person: either with constants that were fitted to the other."""
    found = []
    for walk, other in zip(pair, reversed(pair), strict=True):
        for level in LEVELS:
            for how, constants in ((FITTED, fitted(other, level)), (BY_DEFAULT, DEFAULTS)):
                found.append(Answer(walk, level, how, constants, axial(walk, level, constants)))
    return found


def lines(pair: Sequence[Walk]) -> list[Answer]:
    """The yardstick: of either walk, a regression on the other."""
    return [
        Answer(walk, name, LINE, None, regression(other, walk, with_moments))
        for walk, other in zip(pair, reversed(pair), strict=True)
        for name, with_moments in REGRESSIONS.items()
    ]
