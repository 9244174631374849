"""Watches a run for what no knee does: implausible inputs, depths and gaps, and an impossible split of the load.

Nothing is refused here: somebody may model a rat. Each finding is one sentence, for log, summary and report.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.compartments import LOADED
from knee_contact_ros.joint_reaction.estimator import weight_doubt
from knee_contact_ros.model.inputs import Axes, Inputs
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import EXTENDS, FARTHEST_GAP, FARTHEST_POINT, FLAT, FLEXES, NANOSECOND, Rows, Status
from knee_contact_ros.parameters.build import beyond_words, parameter_doubts
from knee_contact_ros.parameters.schema import Parameters

MOST_BEYOND = 0.1
"""Largest part of the samples under load that may lie beyond a table of shares without a warning"""
MM = 1e3
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)
Floats = NDArray[np.float64]


def doubts_about(parameters: Parameters, model: KneeModel) -> Doubts:
    """Doubts about parameters, ready to watch a run of their model."""
    weight = parameters.body_weight
    inputs = Inputs(None if weight_doubt(weight) else weight, driven=not model.height_prescribed)
    doubts = parameter_doubts(parameters, model)
    return Doubts(model.plausible_depth, beyond_words(model), doubts, inputs, Axes(parameters.frame.tibia))


@dataclass
class Doubts:
    """Watches a run for implausible inputs and answers."""

    plausible_depth: float = float("nan")
    """Largest plausible depth [m]; not a number if it is not known"""
    limit: str = ""
    """Phrase for that depth"""
    about_parameters: list[str] = field(default_factory=list)
    """Sentences about the parameters; see `parameter_doubts`"""
    inputs: Inputs = field(default_factory=Inputs)
    """Angles and loads of the run"""
    axes: Axes = field(default_factory=Axes, compare=False)
    """Forces of the run as they came, where they are known: a recording's answers do not tell them"""
    too_deep: int = 0
    """Number of answers that are too deep, by their bit or by the limit: older recordings have no such bit"""
    deepest: float = 0.0
    """Largest depth [m] among these"""
    flown: int = 0
    """Number of answers with a gap that no knee has, or shortly after one"""
    farthest: float = 0.0
    """Largest gap [m]"""
    off: int = 0
    """Number of answers with a contact that is on no plateau"""
    off_by: float = 0.0
    """Largest distance [m] of such a contact from the tibia's origin, along x"""

    def go_on_with(self, other: Doubts) -> None:
        """Continue with the limit and the sentences of other parameters."""
        self.plausible_depth, self.limit = other.plausible_depth, other.limit
        self.about_parameters, self.axes.frame = other.about_parameters, other.axes.frame
        self.inputs.body_weight, self.inputs.driven = other.inputs.body_weight, other.inputs.driven

    def add_all(self, answers: Mapping[str, NDArray[Any]] | Rows) -> None:
        """Add answers, at least one, by the names of their fields."""
        if isinstance(answers, np.ndarray):
            answers = answers.view(FLAT)
        depths, gaps = answers["penetration_depth"], answers["gap"]
        self.inputs.add_all(answers["stamp"], answers["flexion_angle"], answers["load"])
        angles, places = answers["flexion_angle"], np.abs(answers["contact_point_x"])
        off = (depths > 0.0) & (places > FARTHEST_POINT)
        if off.any():
            self.off += int(np.count_nonzero(off))
            self.off_by = max(self.off_by, float(places[off].max()))
        flagged = ((answers["status"] & IMPLAUSIBLE) != 0) & ~off & (angles >= EXTENDS) & (angles <= FLEXES)
        self.farthest = max(self.farthest, float(gaps.max()))
        # After a flight that no knee makes the bit tells of this, and not of a depth.
        flown = (gaps > FARTHEST_GAP) | (flagged & ((depths <= 0.0) | (self.farthest > FARTHEST_GAP)))
        self.flown += int(np.count_nonzero(flown))
        absurd = (flagged & ~flown) | (depths > self.plausible_depth)
        if absurd.any():
            self.too_deep += int(np.count_nonzero(absurd))
            self.deepest = max(self.deepest, float(depths[absurd].max()))

    @property
    def ticks(self) -> int:
        """Number of answers."""
        return self.inputs.ticks

    @property
    def about_depth(self) -> str:
        """Sentence about implausible depths; empty if there are none."""
        if not self.too_deep:
            return ""
        limit = f", {self.limit}" if self.limit else ""
        return f"{self.too_deep} of {self.ticks} ticks are up to {MM * self.deepest:.3g} mm deep{limit} (IMPLAUSIBLE)"

    @property
    def about_gap(self) -> str:
        """Sentence about implausible gaps; empty if there are none."""
        if not self.flown:
            return ""
        return (
            f"the femur is up to {MM * self.farthest:.4g} mm above the tibia, beyond {MM * FARTHEST_GAP:.3g} mm: "
            f"{self.flown} of {self.ticks} ticks belong to this flight or its landing (IMPLAUSIBLE); does the load "
            "pull, "
            "by its sign or by the share of the compartment?"
        )

    @property
    def about_place(self) -> str:
        """Sentence about contacts that are on no plateau; empty if there are none."""
        if not self.off:
            return ""
        return (
            f"the contact is up to {MM * self.off_by:.3g} mm ahead of the tibia's origin or behind it, outside any "
            f"plateau, in {self.off} of {self.ticks} ticks (IMPLAUSIBLE): is the femur's profile in the femur's axes, "
            "with the origin in the knee (fit-profile --origin)?"
        )

    @property
    def about_inputs(self) -> list[str]:
        """Sentences about angle, load and time; of a load along another axis, that one alone."""
        load = self.axes.sentence or self.inputs.about_load
        return [sentence for sentence in (self.inputs.about_angle, load, self.inputs.about_time) if sentence]

    @property
    def sentences(self) -> list[str]:
        """All sentences: about parameters, depths, gaps and inputs."""
        gap = "" if self.inputs.pulls else self.about_gap  # whose cause is told
        found = (*self.about_parameters, self.about_place, self.about_depth, gap, *self.about_inputs)
        return [sentence for sentence in found if sentence]


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
                "samples under load, where its edge is used: is load.share_file of another gait, or body_weight of "
                "another person?"
            )
        if not self.above and not self.below:
            return ""
        above, below = (100.0 * number / self.samples for number in (self.above, self.below))
        return (
            f"the compartment's share of the axial load is {self.text}, above 1 in {above:.1f} % and below 0 in "
            f"{below:.1f} % of the samples under load: the frontal moment cannot be split between two compartments so "
            "far apart (load.compartment_spacing); load.compartment fixed_share needs no moment"
        )


DIFFERENT_ANGLES, DIFFERENT_FORCES = 0.03, 50.0
"""Differences [rad] and [N] from which two publishers disagree"""
UNSURE = 4.0
"""Multiple of these where it is not known that there are two publishers: one sensor may be noisy"""
SHORT = 0.05
"""Longest time [s] in which a quantity cannot change and change back"""
BACK = 0.5
"""Largest part of a change that is left after the way back"""
OFTEN, ENOUGH = 0.05, 10
"""Part of the samples, and their number, from which an alternation is told"""
MOST = 8192
"""Number of samples that are looked at together"""


class Publishers:
    """Notices that several publishers give one quantity, and disagree: their samples alternate.

    A message does not say who sent it. But a knee does not turn back and forth between two samples, and back again:
    where samples do so often, they are of two sources.
    """

    def __init__(self, topic: str, difference: float, unit: str) -> None:
        """Begin without samples: of a topic, whose publishers disagree from a `difference` in a unit on."""
        self._topic, self._difference, self._unit = topic, difference, unit
        self._waiting: list[tuple[int, float]] = []  # samples that have yet to be looked at
        self._last = np.empty(0, np.int64), np.empty(0)  # the last two of those that were
        self._samples = 0
        self._found = np.empty(0)  # sizes of the changes back and forth

    def add(self, stamp: int, value: float) -> None:
        """Add a sample with its stamp [ns]."""
        self._waiting.append((stamp, value))
        if len(self._waiting) >= MOST:
            self.look()

    def look(self) -> None:
        """Look at the samples that have come since the last look."""
        waiting, self._waiting = self._waiting, []
        self.add_all(np.array([stamp for stamp, _ in waiting], np.int64), np.array([value for _, value in waiting]))

    def add_all(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add many samples, shape (n,), and look at them."""
        if self._waiting:
            self.look()
        stamps, values = np.append(self._last[0], stamps), np.append(self._last[1], values)
        self._last = stamps[-2:], values[-2:]
        if len(stamps) < 3:
            return
        steps, lasts = np.diff(values), stamps[2:] - stamps[:-2]
        sizes = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
        left = np.abs(steps[:-1] + steps[1:])
        found = (sizes > self._difference) & (left < BACK * sizes) & (np.abs(lasts) * NANOSECOND < SHORT)
        self._samples += len(lasts)
        self._found = np.concatenate([self._found, sizes[found]])[-MOST:]

    def sentence(self, several: str = "", joint: str = "") -> str:
        """Sentence that publishers disagree, which are `several` if it is known; empty if they agree."""
        self.look()
        found = self._found if several else self._found[self._found > UNSURE * self._difference]
        if len(found) < max(ENOUGH, OFTEN * min(self._samples, MOST)):
            return ""
        what = f"the joint {joint!r} of {self._topic}" if joint else self._topic
        apart = float(np.median(found))
        often = f"{what} goes back and forth by about {apart:.{0 if apart >= 10 else 2}f} {self._unit} between samples"
        if several:
            return f"{often}: {several} send it and disagree; remap or stop one of them"
        return f"{often}: do two publishers send it, or is the sensor that noisy?"

    def forget(self) -> None:
        """Forget what was found: once a second live, so that it is about now."""
        self.look()
        self._samples, self._found = 0, np.empty(0)
