"""Watches a run for answers that no knee gives: implausible depths, a load of the wrong sign, an impossible split.

Nothing is refused here: somebody may model a rat. Each finding is one sentence, for log, summary and report.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import NANOSECOND, Status
from knee_contact_ros.parameters.build import beyond_words, parameter_doubts
from knee_contact_ros.parameters.schema import Parameters

ONE_SIDED_TICKS, ONE_SIDED_TIME = 100, 1.0
"""Number of ticks, and time [s], from which a load that was never positive cannot be a swing phase"""
PULLING = -50.0
"""Mean load [N] that is too low even for an unloaded knee"""
LOADED = 0.5
"""Axial compression [BW] from which a leg is taken to stand; below it a share says little"""
MOST_BEYOND = 0.1
"""Largest part of the samples under load that may lie beyond a table of shares without a warning"""
MM = 1e3
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def doubts_about(parameters: Parameters, model: KneeModel) -> Doubts:
    """Doubts about parameters, ready to watch a run of their model."""
    return Doubts(model.plausible_depth, beyond_words(model), parameter_doubts(parameters, model))


@dataclass
class Doubts:
    """Watches a run for implausible depths and for a load of the wrong sign."""

    plausible_depth: float = float("nan")
    """Largest plausible depth [m]; not a number if it is not known"""
    limit: str = ""
    """Phrase for that depth"""
    about_parameters: list[str] = field(default_factory=list)
    """Sentences about the parameters; see `parameter_doubts`"""
    ticks: int = 0
    """Number of answers"""
    too_deep: int = 0
    """Number of answers that are `IMPLAUSIBLE`, or would be: older recordings have no such bit"""
    deepest: float = 0.0
    """Largest depth [m] among these"""
    lowest: float = float("inf")
    """Lowest load [N]"""
    highest: float = float("-inf")
    """Highest load [N]"""
    _sum: float = field(default=0.0, compare=False)
    """Sum of all loads [N]; its rounding depends on the blocks in which they came"""
    _first: int = 0
    """Stamp [ns] of the first answer"""
    _last: int = 0
    """Latest stamp [ns]"""

    def go_on_with(self, other: Doubts) -> None:
        """Continue with the limit and the sentences of other parameters."""
        self.plausible_depth, self.limit = other.plausible_depth, other.limit
        self.about_parameters = other.about_parameters

    def add_all(self, stamps: Integers, loads: Floats, depths: Floats, status: Integers) -> None:
        """Add answers, at least one: stamps [ns], loads [N], penetration depths [m] and status bits, shape (n,)."""
        if not self.ticks:
            self._first = int(stamps[0])
        self._last = max(self._last, int(stamps.max()))
        self.ticks += len(stamps)
        self._sum += float(loads.sum())
        self.lowest, self.highest = min(self.lowest, float(loads.min())), max(self.highest, float(loads.max()))
        absurd = ((status & IMPLAUSIBLE) != 0) | (depths > self.plausible_depth)
        if absurd.any():
            self.too_deep += int(np.count_nonzero(absurd))
            self.deepest = max(self.deepest, float(depths[absurd].max()))

    @property
    def about_depth(self) -> str:
        """Sentence about implausible depths; empty if there are none."""
        if not self.too_deep:
            return ""
        limit = f", {self.limit}" if self.limit else ""
        return f"{self.too_deep} of {self.ticks} ticks are up to {MM * self.deepest:.3g} mm deep{limit} (IMPLAUSIBLE)"

    @property
    def about_load(self) -> str:
        """Sentence about a load that was never positive; empty if it is plausible."""
        long = self.ticks >= ONE_SIDED_TICKS and self._last - self._first >= ONE_SIDED_TIME / NANOSECOND
        if not long or self.highest > 0.0 or self._sum > PULLING * self.ticks:
            return ""
        return (
            f"the load was negative throughout ({self.lowest:.0f} to {self.highest:.0f} N): compression is force.y < 0 "
            "in joint_reaction_force; is the sign another convention's?"
        )

    @property
    def sentences(self) -> list[str]:
        """All sentences: about parameters, depths and load."""
        return [sentence for sentence in (*self.about_parameters, self.about_depth, self.about_load) if sentence]


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

    def add_all(self, axial: Floats, loads: Floats, beyond: NDArray[np.bool_] | bool = False) -> None:
        """Add many samples, given as arrays of one shape; see `add`."""
        stands = axial >= LOADED * self.body_weight
        shares = loads[stands] / axial[stands]
        if len(shares):
            self.samples += len(shares)
            self.above += int((shares > 1.0).sum())
            self.below += int((shares < 0.0).sum())
            self.at_bound += int(((loads == 0.0) | (loads == axial))[stands].sum())
            self.beyond += int(np.count_nonzero(beyond & stands))
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
