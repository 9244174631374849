"""The compartment's part of a joint reaction, and whether its split can be used.

The joint reaction acts on the tibia, in the tibia frame (x anterior, y superior, z to the right; left legs are mirrored
to this): an axial compression F = -F_y and a frontal moment M_x. Two compartments a spacing 2d apart, the medial one
at z = -d, carry both if the medial one takes (d F - M_x) / 2d.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Number = TypeVar("Number", float, NDArray[np.float64])
LOADED = 0.5
"""Axial compression [BW] from which on a leg is taken to stand; below it a share says little"""


def total(force_y: Number, _moment_x: Number, _load: Any) -> Number:
    """All of the axial joint reaction."""
    return -force_y


def fixed_share(force_y: Number, _moment_x: Number, load: Any) -> Number:
    """The share `load.share` of it."""
    return load.share * -force_y  # type: ignore[no-any-return]


def moment_balance(force_y: Number, moment_x: Number, load: Any) -> Number:
    """What balances the frontal moment, with the compartments `load.compartment_spacing` [m] apart."""
    return 0.5 * -force_y - moment_x / load.compartment_spacing  # type: ignore[no-any-return]


COMPARTMENTS: Mapping[str, Callable[..., Any]] = {
    "total": total,
    "fixed_share": fixed_share,
    "moment_balance": moment_balance,
}
"""Load [N] of a compartment from force.y [N], torque.x [N m] and the parameters `load.*`; numbers or arrays"""


BY_MOMENT = frozenset({"moment_balance"})
"""Those that need the moment, and may give a compartment more than all of the load, or less than nothing"""


@dataclass
class Split:
    """What shares of the axial load a compartment got while the leg stood, in a run of any length."""

    body_weight: float
    """[N]"""
    samples: int = 0
    """Taken while the leg stood"""
    above: int = 0
    """With more than all of the load: the other compartment would have to pull"""
    below: int = 0
    """With less than nothing of it: this one would have to"""
    smallest: float = math.inf
    """Share [1]"""
    largest: float = -math.inf

    def add(self, force_y: float, load: float) -> None:
        """Take a sample: force.y and the compartment's load, both in N."""
        if -force_y >= LOADED * self.body_weight:
            share = load / -force_y
            self.samples += 1
            self.above += share > 1.0
            self.below += share < 0.0
            self.smallest, self.largest = min(self.smallest, share), max(self.largest, share)

    def add_all(self, force_y: NDArray[np.float64], loads: NDArray[np.float64]) -> None:
        """Take many samples into account: force.y and the compartment's load [N] in arrays of one shape."""
        stands = -force_y >= LOADED * self.body_weight
        shares = loads[stands] / -force_y[stands]
        if len(shares):
            self.samples += len(shares)
            self.above += int((shares > 1.0).sum())
            self.below += int((shares < 0.0).sum())
            self.smallest = min(self.smallest, float(shares.min()))
            self.largest = max(self.largest, float(shares.max()))

    @property
    def text(self) -> str:
        """The range of the shares."""
        return f"{self.smallest:.2f} to {self.largest:.2f}" if self.samples else "the leg never stood"

    @property
    def problem(self) -> str:
        """Why the split cannot be used; empty if it can."""
        if not self.above and not self.below:
            return ""
        above, below = (100.0 * number / self.samples for number in (self.above, self.below))
        return (
            f"the compartment's share of the axial load is {self.text}, above 1 in {above:.1f} % and below 0 in "
            f"{below:.1f} % of the samples under load: the frontal moment cannot be split between two compartments so "
            "far apart (load.compartment_spacing); load.compartment fixed_share needs no moment"
        )
