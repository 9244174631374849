"""The contact laws for the reference solution, written down once more from their sources."""

from __future__ import annotations

from collections.abc import Callable, Sequence

Force = Callable[[float, float, float], float]
"""(depth [m], rate [m/s], rate at first touch [m/s]) to the force [N]."""
Layers = Sequence[tuple[float, Force]]
"""Depth at which each layer begins [m], and its force."""


def power(stiffness: float, exponent: float, depth: float) -> float:
    """Force K δⁿ [N] of a depth δ [m]; 0 for δ <= 0."""
    return stiffness * depth**exponent if depth > 0.0 else 0.0


def kelvin_voigt(stiffness: float, exponent: float, damping: float) -> Layers:
    """Layers of Kelvin and Voigt's law, Eq. 10 of the paper."""
    return [(0.0, lambda depth, rate, _impact: power(stiffness, exponent, depth) + damping * rate)]


def two_layer(
    stiffness: float, exponent: float, damping: float, layer_depth: float, stiffness_2: float, damped: bool
) -> Layers:
    """Layers of the two-layer law, Eq. 12 of the paper, with the dashpot in both layers if `damped`."""
    above = damping if damped else 0.0
    base = stiffness * layer_depth**exponent
    return [
        (0.0, lambda depth, rate, _impact: power(stiffness, exponent, depth) + above * rate),
        (
            layer_depth,
            lambda depth, rate, _impact: base + power(stiffness_2, exponent, depth - layer_depth) + damping * rate,
        ),
    ]


def impact_damped(stiffness: float, exponent: float, loss: float, least_impact_speed: float) -> Layers:
    """Layers of the force K δⁿ (1 + D δ̇ / v₀), with v₀ the speed at first touch, or the least one [m/s]."""

    def force(depth: float, rate: float, impact: float) -> float:
        return power(stiffness, exponent, depth) * (1.0 + loss * rate / max(impact, least_impact_speed))

    return [(0.0, force)]
