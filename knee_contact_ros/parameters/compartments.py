"""The compartment's part of a joint reaction, and checks whether the split between compartments makes sense.

The joint reaction acts on the tibia, in the tibia frame (x anterior, y superior, z to the right; left legs are mirrored
to this): an axial compression F = -F_y and a frontal moment M_x. Two compartments a spacing 2d apart, the medial one
at z = -d, carry both if the medial one takes (d F - M_x) / 2d.

A rule takes axial compression [N], frontal moment [N m] and flexion angle [rad], numbers or arrays of one shape, to the
compartment's load [N]: the same bits either way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.parameters.measured_share import PARAMETER as SHARE_FILE
from knee_contact_ros.parameters.measured_share import MeasuredShare, read_share_table

if TYPE_CHECKING:
    from knee_contact_ros.parameters.schema import Parameters

Rule = Callable[[Any, Any, Any], Any]
"""Function of axial compression [N], frontal moment [N m] and flexion angle [rad], as described above"""
LOADED = 0.5
"""Axial compression [BW] from which a leg is taken to stand; below it a share says little"""


def total(_parameters: Parameters, _texts: Mapping[str, str]) -> Rule:
    """Rule for the whole axial joint reaction."""
    return lambda axial, _moment, _flexion: axial


def fixed_share(parameters: Parameters, _texts: Mapping[str, str]) -> Rule:
    """Rule for the share `load.share` of the axial joint reaction."""
    share = parameters.load.share
    return lambda axial, _moment, _flexion: share * axial


def moment_balance(parameters: Parameters, _texts: Mapping[str, str]) -> Rule:
    """Rule for the load that balances the frontal moment, with compartments `load.compartment_spacing` [m] apart."""
    spacing = parameters.load.compartment_spacing
    return lambda axial, moment, _flexion: 0.5 * axial - moment / spacing


def measured_share(parameters: Parameters, texts: Mapping[str, str]) -> Rule:
    """Rule for the share that the table `load.share_file` has at this load, in body weights, and flexion."""
    name = parameters.load.share_file
    return MeasuredShare(read_share_table(name, texts[SHARE_FILE]), parameters.body_weight)


COMPARTMENTS: Mapping[str, Callable[[Parameters, Mapping[str, str]], Rule]] = {
    "total": total,
    "fixed_share": fixed_share,
    "moment_balance": moment_balance,
    "measured_share": measured_share,
}
"""Rules by which a compartment's load follows from the joint reaction, by the name in `load.compartment`.

Each entry makes a rule from the parameters and the contents of the files that they name (`curve_texts`).
"""
BOTH = "both"
"""Value of `load.compartment` for medial and lateral contact at once; a rule of `SPLITS` gives the medial load"""
SPLITS = tuple(name for name in COMPARTMENTS if name != "total")
"""Names of the rules that leave a load to the lateral compartment"""
BY_MOMENT = frozenset({"moment_balance"})
"""Names of the rules that need the moment, and may give a compartment a share above 1 or below 0"""
VARYING = BY_MOMENT | {"measured_share"}
"""Names of the rules whose share varies from tick to tick"""
MOST_BEYOND = 0.1
"""Largest part of the samples under load that may lie beyond a table of shares without a warning"""


@dataclass
class Split:
    """Statistics of a compartment's share of the axial load while the leg stood, in a run of any length."""

    body_weight: float
    """Body weight [N]"""
    samples: int = 0
    """Number of samples while the leg stood"""
    above: int = 0
    """Number of samples with a share above 1: the other compartment would have to pull"""
    below: int = 0
    """Number of samples with a share below 0: this compartment would have to pull"""
    at_bound: int = 0
    """Number of samples with a share of 0 or 1"""
    beyond: int = 0
    """Number of samples whose load or flexion lies beyond the table of shares"""
    smallest: float = math.inf
    """Smallest share"""
    largest: float = -math.inf
    """Largest share"""

    def add(self, axial: float, load: float, beyond: bool = False) -> None:
        """Add a sample: axial compression [N], the compartment's load [N], and whether it lies beyond the table."""
        if axial >= LOADED * self.body_weight:
            share = load / axial
            self.samples += 1
            self.above += share > 1.0
            self.below += share < 0.0
            self.at_bound += load in (0.0, axial)
            self.beyond += beyond
            self.smallest, self.largest = min(self.smallest, share), max(self.largest, share)

    def add_all(
        self, axial: NDArray[np.float64], loads: NDArray[np.float64], beyond: NDArray[np.bool_] | None = None
    ) -> None:
        """Add many samples, given as arrays of one shape; see `add`."""
        stands = axial >= LOADED * self.body_weight
        shares = loads[stands] / axial[stands]
        if len(shares):
            self.samples += len(shares)
            self.above += int((shares > 1.0).sum())
            self.below += int((shares < 0.0).sum())
            self.at_bound += int(((loads == 0.0) | (loads == axial))[stands].sum())
            self.beyond += int(beyond[stands].sum()) if beyond is not None else 0
            self.smallest = min(self.smallest, float(shares.min()))
            self.largest = max(self.largest, float(shares.max()))

    @property
    def text(self) -> str:
        """Range of the shares, and how often they were 0 or 1, or beyond the table, for a person."""
        if not self.samples:
            return "the leg never stood"
        counted = (("0 or 1", self.at_bound), ("beyond the table", self.beyond))
        parts = [f"{what} in {100.0 * number / self.samples:.1f} %" for what, number in counted if number]
        return ", ".join([f"{self.smallest:.2f} to {self.largest:.2f}", *parts])

    @property
    def problem(self) -> str:
        """Reason why the split cannot be used; empty if it can."""
        if self.beyond > MOST_BEYOND * self.samples:
            return (
                f"load or flexion lie beyond the table of shares in {100.0 * self.beyond / self.samples:.1f} % of the "
                "samples under load, and its edge is taken there: load.share_file is of another gait, or body_weight "
                "of another person"
            )
        if not self.above and not self.below:
            return ""
        above, below = (100.0 * number / self.samples for number in (self.above, self.below))
        return (
            f"the compartment's share of the axial load is {self.text}, above 1 in {above:.1f} % and below 0 in "
            f"{below:.1f} % of the samples under load: the frontal moment cannot be split between two compartments so "
            "far apart (load.compartment_spacing); load.compartment fixed_share needs no moment"
        )
