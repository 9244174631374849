"""The design of a sensitivity analysis: points that SALib draws in the ranges of a study file.

The points are drawn in the unit cube and scaled to the ranges, linearly or logarithmically. They are drawn in groups,
one after another: a larger n begins with the same groups, and so needs only the other cases.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from knee_contact_ros.cohort.study import Floats, Spaced, axes_of, in_ranges

FEWEST = 8
"""The least number of groups from which indices are computed"""
MOST = 65_536
"""The largest number of groups: SALib's bootstrap holds some 2 kB of each, for each index"""
LEVELS = 4
"""Number of levels of a range between which Morris's trajectories step"""


class SalibDesign(BaseModel):
    """The entry `sensitivity` of a study file, which is a `Design`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    method: Literal["sobol", "morris"] = "sobol"
    """Sobol: shares of the variance; Morris: effects over the whole range"""
    n: int = Field(256, ge=FEWEST, le=MOST)
    """Number of groups: of base samples, or of trajectories"""
    seed: int = Field(1, ge=0, lt=2**31)
    """Seed of the random numbers of design and bootstrap"""
    second_order: bool = False
    """Whether Sobol's indices of pairs of parameters are computed, too"""
    confidence: float = Field(0.95, ge=0.5, le=0.999)
    """Confidence level of the intervals"""
    ranges: Annotated[dict[str, Any], Field(min_length=2)]
    """Range of each parameter by name, as `axes_of` reads it"""

    @model_validator(mode="after")
    def _fits(self) -> SalibDesign:
        if self.method == "sobol" and self.n & (self.n - 1):
            less = 1 << (self.n.bit_length() - 1)
            raise ValueError(f"n: {self.n} is not allowed with method sobol; a power of two, {less} or {2 * less}")
        if self.method == "morris" and self.second_order:
            raise ValueError("second_order: True is not allowed with method morris; it is of method sobol")
        return self

    @property
    def names(self) -> list[str]:
        """Names of the parameters, in the order of the columns of `points`."""
        return list(self.ranges)

    @property
    def axes(self) -> dict[str, Spaced]:
        """Ranges of the parameters by name, see `Design.axes`.

        Raises:
            UsageError: one is no range.
        """
        return axes_of(self.ranges)

    @property
    def group(self) -> int:
        """Number of points in a group; indices need all of them."""
        size = len(self.ranges)
        if self.method == "morris":
            return size + 1
        return 2 * size + 2 if self.second_order else size + 2

    @property
    def number(self) -> int:
        """Number of points."""
        return self.n * self.group

    @property
    def problem(self) -> dict[str, Any]:
        """SALib's description of the problem: names of the parameters, and the unit cube as their ranges."""
        size = len(self.ranges)
        return {"num_vars": size, "names": self.names, "bounds": [[0.0, 1.0]] * size}

    def unit(self) -> Floats:
        """Draw the points in the unit cube, shape (number, parameters)."""
        if self.method == "morris":
            from SALib.sample import morris

            return np.asarray(morris.sample(self.problem, self.n, num_levels=LEVELS, seed=self.seed))
        from SALib.sample import sobol

        drawn = sobol.sample(self.problem, self.n, calc_second_order=self.second_order, seed=self.seed)
        return np.asarray(drawn)

    def points(self) -> Floats:
        """Draw the parameters' values, shape (number, parameters)."""
        return in_ranges(self.unit(), self.axes)
