"""What makes no sense in parameters and runs, and the words for it: one sentence each, for log, summary and report.

Nothing is refused here: somebody may model a rat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.statics import NO_LIMIT, static_depth
from knee_contact_ros.core.types import Status
from knee_contact_ros.parameters.schema import ContactParameters, Parameters
from knee_contact_ros.parameters.sections import Pairing

GRAVITY = 9.80665
LIGHTEST = 150.0
"""Body weight [N] below which kg were meant: 15 kg"""
STIFF = math.radians(3.5)
"""[rad] Less movement is that of no joint, or of numbers in rad that count as degrees"""
LEAST_PEAK, MOST_PEAK = 0.75, 8.0
"""[BW] Peaks of measured knees: from 1.07 on two legs to some 6 in stumbling (OrthoLoad); walking 2 to 3"""
SHARES = {"total": 1.0, "moment_balance": 0.5, "measured_share": 0.6}
"""Part of the body weight that a compartment is tried with, where the parameters do not say it"""
ONE_SIDED_TICKS, ONE_SIDED_TIME = 100, 1.0
"""Ticks, and time [s], from which on a load that was never positive is no swing phase"""
PULLING = -50.0
"""Mean load [N] that no knee is pulled apart with"""
MM, NANOSECONDS = 1e3, 1e9
IMPLAUSIBLE = int(Status.IMPLAUSIBLE)
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def parameter_doubts(parameters: Parameters, law: ContactLaw, plausible_depth: float) -> list[str]:
    """What is likely given in another unit: body weight in kg, stiffness in N/mm^n, modulus in MPa; a wait too short.

    `law` is that of the parameters; beyond `plausible_depth` [m] a depth makes no sense.
    """
    return [
        doubt
        for doubt in (
            _body_weight(parameters.body_weight),
            _stiffness(parameters, law, plausible_depth),
            _second_layer(parameters.contact, law),
            _wait(parameters.pairing),
        )
        if doubt
    ]


def _body_weight(weight: float) -> str:
    if weight >= LIGHTEST:
        return ""
    return f"body_weight {weight:.7g} N: is it kg? {weight:.7g} kg weigh {weight * GRAVITY:.1f} N"


def _stiffness(parameters: Parameters, law: ContactLaw, plausible_depth: float) -> str:
    """A depth under the body weight that no knee has."""
    contact, share = parameters.contact, SHARES.get(parameters.load.rule, parameters.load.share)
    load = share * parameters.body_weight
    depth = static_depth(law, load, 0.0, 0.0, NO_LIMIT).depth
    if depth <= plausible_depth:
        return ""
    under = f"{load:.1f} N ({share:g} body weights)"
    told = f"gives {MM * depth:.3g} mm of depth under {under}, {_beyond(law, plausible_depth)}"
    if contact.stiffness_from == "material" or contact.law == "elastic_foundation":
        value = contact.youngs_modulus
        meant = (
            f"; {value:.7g} MPa would be {1e6 * value:.7g} Pa" if _harder(depth, contact, 1e6, plausible_depth) else ""
        )
        return f"contact.youngs_modulus {value:.7g} Pa {told}{meant}"
    meant = _per_millimetre(contact, contact.stiffness)
    fits = _harder(depth, contact, MM**contact.exponent, plausible_depth)
    return f"contact.stiffness {_per_metre(contact, contact.stiffness)} {told}" + (f"; {meant}" if fits else "")


def _harder(depth: float, contact: ContactParameters, factor: float, plausible_depth: float) -> bool:
    """Whether a law that is stiffer by a factor has a depth that makes sense; near enough for one of two layers."""
    exponent = 2.0 if contact.law == "elastic_foundation" else contact.exponent
    return bool(depth / factor ** (1.0 / exponent) <= plausible_depth)


def _second_layer(contact: ContactParameters, law: ContactLaw) -> str:
    """Bone that is softer than cartilage."""
    soft, hard = contact.stiffness, contact.stiffness_2
    if len(law.layers) < 2 or contact.stiffness_from != "value" or hard >= soft:
        return ""
    told = f"contact.stiffness_2 {_per_metre(contact, hard)} is below contact.stiffness {_per_metre(contact, soft)}"
    meant = f"; {_per_millimetre(contact, hard)}" if MM**contact.exponent * hard >= soft else ""
    return f"{told}: bone softer than cartilage{meant}"


def _wait(pairing: Pairing) -> str:
    """A wait that ends before the angle that is waited for can come."""
    if pairing.angle_delay <= 0.0 or pairing.wait > pairing.angle_delay:
        return ""
    return (
        f"pairing.wait {pairing.wait:.7g} s does not exceed pairing.angle_delay {pairing.angle_delay:.7g} s: live, "
        "every force is answered before its angle has come (INPUT_HELD)"
    )


def _per_metre(contact: ContactParameters, stiffness: float) -> str:
    return f"{stiffness:.7g} N/m^{contact.exponent:g}"


def _per_millimetre(contact: ContactParameters, stiffness: float) -> str:
    """What a number of N/m^n would be if it had been one of N/mm^n."""
    meant = _per_metre(contact, MM**contact.exponent * stiffness)
    return f"{stiffness:.7g} N/mm^{contact.exponent:g} would be {meant}"


def doubts_about(parameters: Parameters, model: KneeModel) -> Doubts:
    """What is to be said of parameters, and the watch for a run of their model."""
    limit = model.plausible_depth
    law = model.modes.law
    return Doubts(limit, _beyond(law, limit), parameter_doubts(parameters, law, limit))


def _beyond(law: ContactLaw, plausible_depth: float) -> str:
    """The largest depth [m] that makes sense, in words."""
    what = "the cartilage's thickness" if plausible_depth == law.thickness else "a fifth of the femoral radius"
    return f"beyond {MM * plausible_depth:.3g} mm, {what}"


@dataclass
class Doubts:
    """Watches a run: depths that make no sense, and a load of the wrong sign."""

    plausible_depth: float = float("nan")
    """[m]; not a number if it is not known"""
    limit: str = ""
    """The same in words"""
    about_parameters: list[str] = field(default_factory=list)
    """See `parameter_doubts`"""
    ticks: int = 0
    too_deep: int = 0
    """Ticks that are `IMPLAUSIBLE`, or would be: recordings from before have no such bit"""
    deepest: float = 0.0
    """[m]"""
    lowest: float = float("inf")
    """Load [N]"""
    highest: float = float("-inf")
    """Load [N]"""
    _sum: float = field(default=0.0, compare=False)
    """Of all loads [N]; its rounding depends on the blocks they came in"""
    _first: int = 0
    """Stamp [ns]"""
    _last: int = 0

    def go_on_with(self, other: Doubts) -> None:
        """Go on with what is to be said of other parameters."""
        self.plausible_depth, self.limit, self.about_parameters = (
            other.plausible_depth,
            other.limit,
            other.about_parameters,
        )

    def add(self, stamp: int, load: float, depth: float, status: int) -> None:
        """Take an answer: stamp [ns], load [N], penetration depth [m] and status."""
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
        """Take many answers into account, at least one; all have shape (n,)."""
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
        """What is to be said of depths; empty if nothing is."""
        if not self.too_deep:
            return ""
        limit = f", {self.limit}" if self.limit else ""
        return f"{self.too_deep} of {self.ticks} ticks are up to {MM * self.deepest:.3g} mm deep{limit} (IMPLAUSIBLE)"

    @property
    def about_load(self) -> str:
        """What is odd about the load; empty if nothing is."""
        long = self.ticks >= ONE_SIDED_TICKS and self._last - self._first >= ONE_SIDED_TIME * NANOSECONDS
        if not long or self.highest > 0.0 or self._sum > PULLING * self.ticks:
            return ""
        return (
            f"the load was negative throughout ({self.lowest:.0f} to {self.highest:.0f} N): compression is force.y < 0 "
            "in joint_reaction_force; is the sign another convention's?"
        )

    @property
    def sentences(self) -> list[str]:
        """All that is to be said."""
        return [sentence for sentence in (*self.about_parameters, self.about_depth, self.about_load) if sentence]
