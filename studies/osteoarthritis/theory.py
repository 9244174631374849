"""Predictions before any computation: where two laws at the same depth give the same force."""

from __future__ import annotations

import numpy as np

from studies.osteoarthritis.grid import FIRST, SHIPPED, Floats
from studies.osteoarthritis.knees import Knees, Table


def equal_second(layers: Floats, depth: float) -> Floats:
    """K₂ [N/m^1.5] with which a layer h at a depth gives the healthy knee's force; infinite if h is not passed.

    K₁ hⁿ + K₂ (δ - h)ⁿ = K₁ δⁿ.
    """
    n = SHIPPED.exponent
    over = np.maximum(depth - layers, 0.0) ** n
    missing = FIRST * (depth**n - layers**n)
    return np.asarray(np.divide(missing, over, out=np.full_like(layers, np.inf), where=over > 0.0))


def rest_force(layers: Floats, seconds: Floats, depth: Floats | float) -> Floats:
    """Force at rest [N] of the two-layer law."""
    n = SHIPPED.exponent
    first, over = np.minimum(depth, layers), np.maximum(depth - layers, 0.0)
    return np.asarray(FIRST * first**n + seconds * over**n)


def ratio(knees: Knees, table: Table) -> Floats:
    """Peak force over the healthy knee's of the same share, in the grid's shape."""
    return np.asarray(table.peak_force / knees.healthy.peak_force[:, None, None])


def needed_depth(layers: Floats, seconds: Floats, force: Floats) -> Floats:
    """Depth [m] at which the two-layer law carries a force [N] at rest."""
    n = SHIPPED.exponent
    over = np.maximum(force - FIRST * layers**n, 0.0)
    return np.asarray(np.where(over > 0.0, layers + (over / seconds) ** (1.0 / n), (force / FIRST) ** (1.0 / n)))


def turning_loss(knees: Knees) -> Floats:
    """How much higher than the healthy path [m] a knee must be led for the healthy peak force, in the grid's shape.

    That is the healthy knee's largest depth less the one at which the other law carries the same force: the depth that
    it would have under the load.
    """
    _, layers, seconds = np.meshgrid(*knees.grid, indexing="ij")
    force, depth = (column[:, None, None] for column in (knees.healthy.peak_force, knees.healthy.peak_depth))
    return np.asarray(depth - needed_depth(layers, seconds, np.broadcast_to(force, layers.shape)))


def turning(knees: Knees, layer: float, second: float, share: int = 0) -> float:
    """Rise [m] of the healthy path as by `turning_loss`, for one knee."""
    force, depth = float(knees.healthy.peak_force[share]), float(knees.healthy.peak_depth[share])
    return depth - float(needed_depth(np.array(layer), np.array(second), np.array(force)))
