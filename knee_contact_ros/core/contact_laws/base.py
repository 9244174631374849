"""What a contact law is: one smooth formula per layer. `ContactLaw` states all that is asked of it.

To add a law, write its formula (a named tuple of constants with the methods of `LayerFormula`) and a factory that
returns a `ContactLaw` in a file of its own, and name the factory in `CONTACT_LAWS` (`__init__.py`). The factory's
keyword arguments are the `contact.*` parameters that the law uses; those that no other law has come with a `Range`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.kernel_source import in_kernel, kernel_interface

DEEPEST = 1e30
"""Depths beyond this [m] count as it: they occur in tries of an integrator only, and must not overflow"""


@kernel_interface
class LayerFormula(Protocol):
    """The force of one layer. What is asked of it stands in `ContactLaw`."""

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Force [N] and its slopes over depth [N/m] and over rate [N s/m].

        Depth [m] and rate [m/s] are those of the penetration; `impact_speed` [m/s] is the rate at first touch, 0 for a
        contact that began at rest.
        """
        ...

    def remembers_impact(self) -> bool:
        """Whether the force depends on the impact speed."""
        ...


class Range(NamedTuple):
    """What a law's own constant may be, in its factory's signature: `edge: Annotated[float, Range(...)] = 0.001`.

    It is the parameter `contact.edge` then, and the default what the law is tried with.
    """

    least: float
    most: float
    meaning: str
    """With its unit, for who sets the parameter"""


class Layer(NamedTuple):
    """One layer of a contact law."""

    begin: float
    """Depth at which the layer begins [m]; the first layer begins at 0."""
    formula: LayerFormula


class ContactLaw(NamedTuple):
    """Normal contact force [N] as a function of penetration depth δ [m] and rate δ̇ [m/s], layer by layer.

    The contract of a law, whole. `contract.py` tries every law that a model is made with, and refuses one that breaks a
    clause; each name is that of its message.

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
    """In the order of depth"""
    thickness: float = math.inf
    """[m] of what the law models: no depth beyond it makes sense; infinite if the law does not say"""

    def static_force(self, depth: float) -> float:
        """Force [N] at rest at a depth [m]; 0 when apart."""
        return static_force(self, depth)[0]


@in_kernel
def layer_at(law: ContactLaw, depth: float) -> int:
    """Index of the layer that a depth [m] lies in; -1 when apart. On a layer's beginning: that layer."""
    index = -1
    for layer in law.layers:
        if layer.begin <= depth:
            index += 1
    return index


@in_kernel
def static_force(law: ContactLaw, depth: float) -> tuple[float, float, float]:
    """Force [N] at rest at a depth [m] and its slopes; 0 when apart. On a layer's beginning those of the one before."""
    index = -1
    for layer in law.layers:
        if layer.begin < depth:
            index += 1
    if index < 0:
        return 0.0, 0.0, 0.0
    return law.layers[index].formula.force_at(depth, 0.0, 0.0)


@in_kernel
def power_law(stiffness: float, exponent: float, depth: float) -> tuple[float, float]:
    """Elastic force K δⁿ [N] and its slope [N/m]; both 0 for δ <= 0 (Hertz: n = 1.5)."""
    if depth <= 0.0:
        return 0.0, 0.0
    depth = min(depth, DEEPEST)
    slope_over_exponent = stiffness * (math.sqrt(depth) if exponent == 1.5 else depth ** (exponent - 1.0))
    return slope_over_exponent * depth, exponent * slope_over_exponent
