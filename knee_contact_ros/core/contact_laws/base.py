"""Contact laws: one smooth formula per layer. `ContactLaw` states the contract of a law.

To add a law, write its formula (a named tuple of constants with the methods of `LayerFormula`) and a factory that
returns a `ContactLaw` in a file of its own, and name the factory in `CONTACT_LAWS` (`__init__.py`). The factory's
keyword arguments are the `contact.*` parameters that the law uses; a parameter that no other law has gets a `Range`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.kernel_source import in_kernel, kernel_interface

DEEPEST = 1e30
"""Depth [m] that larger ones are limited to: they occur only in trial steps of an integrator, and must not overflow"""


@kernel_interface
class LayerFormula(Protocol):
    """The formula of one layer; its contract is in `ContactLaw`."""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Return the force [N] and its slopes over depth [N/m] and over rate [N s/m].

        Depth [m] and rate [m/s] are those of the penetration; `impact_speed` [m/s] is the rate at first touch, 0 for a
        contact that began at rest.
        """
        ...

    def remembers_impact(self) -> bool:
        """Whether the force depends on the impact speed."""
        ...


class Range(NamedTuple):
    """Range of a law's own constant, in the signature of its factory: `edge: Annotated[float, Range(...)] = 0.001`.

    The constant then is the parameter `contact.edge`, and its default is what tests use.
    """

    least: float
    most: float
    meaning: str
    """Description of the parameter with its unit, for users"""


class Layer(NamedTuple):
    """One layer of a contact law."""

    begin: float
    """Depth [m] at which the layer begins; 0 for the first layer"""
    formula: LayerFormula


class ContactLaw(NamedTuple):
    """Normal contact force [N] as a function of penetration depth δ [m] and rate δ̇ [m/s], layer by layer.

    The clauses below are the whole contract of a law. `contract.py` tests every law that a model is made with, and
    rejects one that breaks a clause; its message begins with the name of the clause.

    layers: The first layer begins at 0 m, each other one deeper than the one before. All formulas are of one type (the
        kernel is compiled for it), and all or none of them remember the impact. The thickness is > 0.
    finite: Force and slopes are finite numbers at every depth from -10 m to 1e9 m, rate up to ±1e4 m/s and impact speed
        from -1 m/s (rounding) to 1e4 m/s: integrators, and the search for the depth at rest, try out far more than a
        knee does.
    pure: The same arguments give the same numbers, always.
    impact: A formula whose `remembers_impact` is false gives the same at every impact speed; and at rest every formula
        does, for the static contact is solved at an impact speed of 0.
    touch: At depth 0 and at rest the first layer's force is 0. (At a rate it may jump there, as a dashpot does.)
    joint: At rest the force is the same on both sides of a layer's beginning. (At a rate it may jump.)
    smooth: From its layer's beginning on, and beyond its end, a formula has neither jump nor kink, whatever the rate:
        steps do not end there, and their errors are estimated for what is smooth. Where a law has one, another layer
        begins. At its layer's beginning it may be as rough as δⁿ, n >= 1. Just before that it goes on without a jump:
        steps look there to find the crossing.
    affine: F(δ, δ̇) = F₀(δ) + c(δ) δ̇ at every rate: quasi-static answers weigh what they leave out by c, and a contact
        without mass is solved for its rate. So a formula does not clamp itself at 0 either, where it would pull: the
        mode does (`contact_modes.py`), with an event.
    rising: At rest the force does not fall with the depth, and within a layer neither does its slope (it is convex):
        there is one static depth, and Newton's method finds an implicit stage from anywhere (`esdirk4.py`).
    slopes: Both are the true ones: errors are carried by them. That over the rate, c(δ), is >= 0; that over the depth
        is >= 0 wherever the formula presses (F >= 0): every implicit stage has one solution there. Where it pulls, the
        slope over the depth may be negative (a damping that grows with the depth): the contact is released there,
        unless `allow_tension` keeps it (docs/decisions/0028-law-contract.md).
    """

    layers: tuple[Layer, ...]
    """The layers in the order of their depths"""
    thickness: float = math.inf
    """Thickness [m] of what the law models, beyond which no depth is plausible; infinite if it is not known"""

    def static_force(self, depth: float) -> float:
        """Return the force [N] at rest at a depth [m]; 0 when apart."""
        return static_force(self, depth)[0]


@in_kernel
def layer_at(law: ContactLaw, depth: float) -> int:
    """Return the index of the layer at a depth [m]; -1 when apart; on the beginning of a layer, that layer."""
    index = -1
    for layer in law.layers:
        if layer.begin <= depth:
            index += 1
    return index


@in_kernel
def static_force(law: ContactLaw, depth: float) -> tuple[float, float, float]:
    """Return force [N] and slopes at rest at a depth [m]; 0 when apart.

    On the beginning of a layer they are those of the layer before.
    """
    return law_force(law, depth, 0.0, 0.0)


@in_kernel
def law_force(law: ContactLaw, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
    """Return force [N] and slopes at a depth [m], a rate and an impact speed [m/s], not clamped; 0 when apart.

    On the beginning of a layer they are those of the layer before.
    """
    index = -1
    for layer in law.layers:
        if layer.begin < depth:
            index += 1
    if index < 0:
        return 0.0, 0.0, 0.0
    return law.layers[index].formula.force_at(depth, rate, impact_speed)


@in_kernel
def power_law(stiffness: float, exponent: float, depth: float) -> tuple[float, float]:
    """Return the elastic force K δⁿ [N] and its slope [N/m]; both are 0 for δ <= 0 (Hertz: n = 1.5)."""
    if depth <= 0.0:
        return 0.0, 0.0
    depth = min(depth, DEEPEST)
    slope_over_exponent = stiffness * (math.sqrt(depth) if exponent == 1.5 else depth ** (exponent - 1.0))
    return slope_over_exponent * depth, exponent * slope_over_exponent
