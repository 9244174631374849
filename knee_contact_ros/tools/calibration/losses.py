"""How much a residual counts: by its square, or less where it is far off.

Each loss ρ is a function of z = (residual / noise)², given with its first two derivatives, shape (3, n), as
`scipy.optimize.least_squares` takes it. With ψ(r) = r ρ'(r²), twice the rise of the cost times Σψ'/Σψ² is distributed
as χ² where a parameter has its true value (Schrader & Hettmansperger 1980, Biometrika 67:93-101); for squares that
factor is one over the variance.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Loss = Callable[[Floats], Floats]
LINEAR = "linear"
BEND = 1.345
"""Of Huber's loss, in units of the noise: 95 % as efficient as squares where the noise is normal"""
NORMAL_MEDIAN = 0.6744897501960817
"""Of the size of a standard normal number"""


def squares(z: Floats) -> Floats:
    """Least squares."""
    return np.stack((z, np.ones_like(z), np.zeros_like(z)))


def soft_l1(z: Floats) -> Floats:
    """2 (√(1 + z) - 1): squares near 0, sizes far off."""
    root = np.sqrt(1.0 + z)
    return np.stack((2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3))


def huber(z: Floats) -> Floats:
    """Squares up to `BEND`, sizes beyond (Huber 1964)."""
    size = np.sqrt(np.maximum(z, BEND**2))
    inside = z <= BEND**2
    value = np.where(inside, z, 2.0 * BEND * size - BEND**2)
    return np.stack((value, np.where(inside, 1.0, BEND / size), np.where(inside, 0.0, -0.5 * BEND / size**3)))


LOSSES: dict[str, Loss] = {LINEAR: squares, "soft_l1": soft_l1, "huber": huber}


def cost(loss: Loss, residuals: Floats) -> float:
    """Half the sum of ρ over residuals in units of their noise."""
    return float(0.5 * loss(residuals**2)[0].sum())


def calibration(loss: Loss, residuals: Floats) -> float:
    """Σψ'/Σψ²; 1 for squares of residuals whose mean square is 1."""
    _, first, second = loss(residuals**2)
    return float((first + 2.0 * residuals**2 * second).sum() / max(((residuals * first) ** 2).sum(), 1e-300))


def noise_of(name: str, misfits: Floats, part_free: float) -> float:
    """Standard deviation of a column's noise from what is left of it.

    `part_free` is the part of the measurements that no parameter was fitted to. A loss that is robust takes the median
    size, which no outlier moves.
    """
    if name == LINEAR:
        return float(np.sqrt(np.mean(misfits**2) / part_free))
    return float(np.median(np.abs(misfits)) / NORMAL_MEDIAN / np.sqrt(part_free))
