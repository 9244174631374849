"""What a contact law is: one smooth formula per layer.

To add a law, write its formula (a named tuple of constants with the method `force`) and a factory that returns a
`ContactLaw` in a file of its own, and name the factory in `CONTACT_LAWS` (`__init__.py`). The factory's keyword
arguments are the `contact.*` parameters that the law uses.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

from knee_contact_ros.core.kernel_source import in_kernel, kernel_interface

DEEPEST = 1e30
"""Depths beyond this [m] count as it: they occur in tries of an integrator only, and must not overflow"""


@kernel_interface
class LayerFormula(Protocol):
    """The force of one layer.

    It must go on smoothly a little beyond the layer's ends, for the integrator looks there to find the crossing. Both
    slopes must be >= 0: this makes every implicit step solvable (`integrators/esdirk4.py`).
    """

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        """Force [N] and its slopes over depth [N/m] and over rate [N s/m].

        Depth [m] and rate [m/s] are those of the penetration; `impact_speed` [m/s] is the rate at first touch, 0 for a
        contact that began at rest.
        """
        ...

    def remembers_impact(self) -> bool:
        """Whether the force depends on the impact speed."""
        ...


class Layer(NamedTuple):
    """One layer of a contact law."""

    begin: float
    """Depth at which the layer begins [m]; the first layer begins at 0."""
    formula: LayerFormula


class ContactLaw(NamedTuple):
    """Normal contact force [N] as a function of penetration depth [m] and rate [m/s], layer by layer."""

    layers: tuple[Layer, ...]
    """In the order of depth; all formulas of one type."""

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
