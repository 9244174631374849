"""Implausible parameters and runs, described in one sentence each, for log, summary and report.

Nothing is refused here: somebody may model a rat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import ContactLaw
from knee_contact_ros.model.statics import plain_static_depth
from knee_contact_ros.model.types import NANOSECOND, Status
from knee_contact_ros.parameters.schema import ContactParameters, Parameters
from knee_contact_ros.parameters.sections import Pairing

LIGHTEST = 150.0
"""Body weight [N] below which the number must be in kg: the weight of 15 kg"""
STIFF = math.radians(3.5)
"""Range of motion [rad] below which a joint does not move, or its angles in rad were taken for degrees"""
LEAST_PEAK, MOST_PEAK = 0.75, 8.0
"""Plausible range of load peaks [BW]: measured ones are from 1.07 on two legs to some 6 in stumbling (OrthoLoad)"""
SHARES = {"total": 1.0, "moment_balance": 0.5, "measured_share": 0.6}
"""Part of the body weight that a compartment is tried with, by the rule of its load; see also `load.share`"""
ONE_SIDED_TICKS, ONE_SIDED_TIME = 100, 1.0
"""Number of ticks, and time [s], from which a load that was never positive cannot be a swing phase"""
PULLING = -50.0
"""Mean load [N] that is too low even for an unloaded knee"""
MM = 1e3
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def parameter_doubts(parameters: Parameters, law: ContactLaw, plausible_depth: float) -> list[str]:
    """Sentences about parameters in a likely wrong unit (kg, N/mm^n, MPa), and about a wait that is too short.

    `law` is the contact law of the parameters; depths beyond `plausible_depth` [m] are implausible.
    """
    return [
        doubt
        for doubt in (
            weight_doubt(parameters.body_weight),
            _stiffness(parameters, law, plausible_depth),
            _second_layer(parameters.contact, law),
            _wait(parameters.pairing),
        )
        if doubt
    ]


def weight_doubt(weight: float) -> str:
    """Sentence about a body weight [N] that is likely in kg; empty if it is not."""
    if weight >= LIGHTEST:
        return ""
    return f"body_weight {weight:.7g} N: is it kg? {weight:.7g} kg weigh {weight * GRAVITY:.1f} N"


def _stiffness(parameters: Parameters, law: ContactLaw, plausible_depth: float) -> str:
    """Sentence about a stiffness or modulus that gives an implausible depth under the body weight; empty if it fits."""
    contact, share = parameters.contact, SHARES.get(parameters.load.rule, parameters.load.share)
    load = share * parameters.body_weight
    depth = plain_static_depth(law.rows, load)
    if depth <= plausible_depth:
        return ""
    under = f"{load:.1f} N ({share:g} body weights)"
    finding = f"gives {MM * depth:.3g} mm of depth under {under}, {_beyond(law, plausible_depth)}"
    if contact.stiffness_from == "material" or contact.law == "elastic_foundation":
        value = contact.youngs_modulus
        meant = (
            f"; {value:.7g} MPa would be {1e6 * value:.7g} Pa" if _harder(depth, contact, 1e6, plausible_depth) else ""
        )
        return f"contact.youngs_modulus {value:.7g} Pa {finding}{meant}"
    meant = _per_millimetre(contact, contact.stiffness)
    fits = _harder(depth, contact, MM**contact.exponent, plausible_depth)
    return f"contact.stiffness {_per_metre(contact, contact.stiffness)} {finding}" + (f"; {meant}" if fits else "")


def _harder(depth: float, contact: ContactParameters, factor: float, plausible_depth: float) -> bool:
    """Whether a law that is stiffer by a factor has a plausible depth; approximate for laws with two layers."""
    exponent = 2.0 if contact.law == "elastic_foundation" else contact.exponent
    return bool(depth / factor ** (1.0 / exponent) <= plausible_depth)


def _second_layer(contact: ContactParameters, law: ContactLaw) -> str:
    """Sentence about bone that is softer than cartilage; empty if it is not."""
    soft, hard = contact.stiffness, contact.stiffness_2
    if len(law.layers) < 2 or contact.stiffness_from != "value" or hard >= soft:
        return ""
    finding = f"contact.stiffness_2 {_per_metre(contact, hard)} is below contact.stiffness {_per_metre(contact, soft)}"
    meant = f"; {_per_millimetre(contact, hard)}" if MM**contact.exponent * hard >= soft else ""
    return f"{finding}: bone softer than cartilage{meant}"


def _wait(pairing: Pairing) -> str:
    """Sentence about a wait that ends before the angle can come; empty if it does not."""
    if pairing.angle_delay <= 0.0 or pairing.wait > pairing.angle_delay:
        return ""
    return (
        f"pairing.wait {pairing.wait:.7g} s does not exceed pairing.angle_delay {pairing.angle_delay:.7g} s: live, "
        "every force is answered before its angle has come (INPUT_HELD)"
    )


def _per_metre(contact: ContactParameters, stiffness: float) -> str:
    return f"{stiffness:.7g} N/m^{contact.exponent:g}"


def _per_millimetre(contact: ContactParameters, stiffness: float) -> str:
    """Phrase that converts a number to N/m^n as if it were in N/mm^n."""
    meant = _per_metre(contact, MM**contact.exponent * stiffness)
    return f"{stiffness:.7g} N/mm^{contact.exponent:g} would be {meant}"


def doubts_about(parameters: Parameters, model: KneeModel) -> Doubts:
    """Doubts about parameters, ready to watch a run of their model."""
    limit = model.plausible_depth
    return Doubts(limit, _beyond(model.law, limit), parameter_doubts(parameters, model.law, limit))


def _beyond(law: ContactLaw, plausible_depth: float) -> str:
    """Phrase for the largest plausible depth [m], for people."""
    what = "the cartilage's thickness" if plausible_depth == law.thickness else "a fifth of the femoral radius"
    return f"beyond {MM * plausible_depth:.3g} mm, {what}"


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

    def add(self, stamp: int, load: float, depth: float, status: int) -> None:
        """Add an answer: stamp [ns], load [N], penetration depth [m] and status bits."""
        if not self.ticks:
            self._first = stamp
        self._last = max(self._last, stamp)
        self.ticks += 1
        self._sum += load
        self.lowest = min(self.lowest, load)
        self.highest = max(self.highest, load)
        if status & IMPLAUSIBLE or depth > self.plausible_depth:
            self.too_deep += 1
            self.deepest = max(self.deepest, depth)

    def add_all(self, stamps: Integers, loads: Floats, depths: Floats, status: Integers) -> None:
        """Add many answers, at least one; all arrays have shape (n,). See `add`."""
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
