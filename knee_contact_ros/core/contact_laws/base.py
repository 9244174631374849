"""What a contact law is: one smooth formula per layer.

To add a law, write a factory that returns a `ContactLaw` in a file of its own and name it in `CONTACT_LAWS`
(`__init__.py`). The factory's keyword arguments are the `contact.*` parameters that the law uses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

LayerForce = Callable[[float, float], tuple[float, float, float]]
"""(penetration depth [m], penetration rate [m/s]) to (force [N], its slopes over depth [N/m] and over rate [N s/m]).

The formula of a layer must go on smoothly a little beyond the layer's ends, for the integrator looks there to find the
crossing. Both slopes must be >= 0: this makes every implicit step solvable (`integrators/esdirk4.py`).
"""


class Layer(NamedTuple):
    """One layer of a contact law."""

    begin: float
    """Depth at which the layer begins [m]; the first layer begins at 0."""
    force: LayerForce


class ContactLaw(NamedTuple):
    """Normal contact force [N] as a function of penetration depth [m] and rate [m/s], layer by layer."""

    layers: tuple[Layer, ...]
    """In the order of depth."""
    at_impact: Callable[[float], tuple[Layer, ...]] | None = None
    """For laws whose damping depends on how the contact began: speed of first touch [m/s] to the layers."""

    def after_impact(self, speed: float) -> ContactLaw:
        """The law for a contact that began at a speed of approach [m/s]; most laws do not care."""
        return self if self.at_impact is None else self._replace(layers=self.at_impact(speed))

    def static_force(self, depth: float) -> float:
        """Force [N] at rest at a depth [m]; 0 when apart."""
        if depth <= 0.0:
            return 0.0
        layer = max(index for index, layer in enumerate(self.layers) if layer.begin < depth)
        return self.layers[layer].force(depth, 0.0)[0]


def power_law(stiffness: float, exponent: float, depth: float) -> tuple[float, float]:
    """Elastic force K δⁿ [N] and its slope [N/m]; both 0 for δ <= 0 (Hertz: n = 1.5)."""
    if depth <= 0.0:
        return 0.0, 0.0
    slope_over_exponent = stiffness * depth ** (exponent - 1.0)
    return slope_over_exponent * depth, exponent * slope_over_exponent
