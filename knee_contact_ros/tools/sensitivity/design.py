"""Where a knee is computed for its indices: the points that SALib draws, in the ranges of a study file.

The points are drawn in the unit cube and spread over the ranges, evenly or evenly in the logarithm. They are drawn in
groups, one after another: a larger n begins with the same groups, and so needs only the rest of the cases.

Sobol: Saltelli et al. 2010, Computer Physics Communications 181:259-270, doi:10.1016/j.cpc.2009.09.018. Morris: Morris
1991, Technometrics 33:161-174, doi:10.1080/00401706.1991.10484804.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from knee_contact_ros.cohort.study import Spaced, axes_of

FEWEST = 8
"""Groups that indices are made of"""
MOST = 65_536
"""Groups: SALib's bootstrap holds some 2 kB of each, for each index"""
LEVELS = 4
"""Of a range, that trajectories step on"""


class SalibDesign(BaseModel):
    """What a study file says under `sensitivity`; a `Design` of the study."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    method: Literal["sobol", "morris"] = "sobol"
    n: int = Field(256, ge=FEWEST, le=MOST)
    """Groups: base samples, or trajectories"""
    seed: int = Field(1, ge=0, lt=2**31)
    second_order: bool = False
    confidence: float = Field(0.95, ge=0.5, le=0.999)
    ranges: Annotated[dict[str, Any], Field(min_length=2)]

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
        """Of the parameters."""
        return list(self.ranges)

    @property
    def axes(self) -> list[Spaced]:
        """The ranges, in their order.

        Raises:
            UsageError: one is none.
        """
        return axes_of(self.ranges)

    @property
    def ends(self) -> list[tuple[float, float]]:
        """The least and the largest value of each."""
        return [(axis.start, axis.stop) for axis in self.axes]

    @property
    def group(self) -> int:
        """Points that belong together, of which none can be missed."""
        size = len(self.ranges)
        if self.method == "morris":
            return size + 1
        return 2 * size + 2 if self.second_order else size + 2

    @property
    def number(self) -> int:
        """Of the points."""
        return self.n * self.group

    @property
    def problem(self) -> dict[str, Any]:
        """What SALib calls so: the unit cube."""
        size = len(self.ranges)
        return {"num_vars": size, "names": self.names, "bounds": [[0.0, 1.0]] * size}

    def unit(self) -> NDArray[np.float64]:
        """The points in the unit cube, shape (number, names)."""
        if self.method == "morris":
            from SALib.sample import morris

            return np.asarray(morris.sample(self.problem, self.n, num_levels=LEVELS, seed=self.seed))
        from SALib.sample import sobol

        drawn = sobol.sample(self.problem, self.n, calc_second_order=self.second_order, seed=self.seed)
        return np.asarray(drawn)

    def points(self) -> NDArray[np.float64]:
        """The parameters' values, shape (number, names)."""
        unit = self.unit()
        return np.column_stack([axis.at(unit[:, i]) for i, axis in enumerate(self.axes)])
