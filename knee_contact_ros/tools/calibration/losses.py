"""Loss functions: a residual counts by its square, or less where it is large.

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
"""Residual at the bend of Huber's loss, in units of the noise: 95 % as efficient as squares for normal noise"""
NORMAL_MEDIAN = 0.6744897501960817
"""Median of the absolute value of a standard normal number"""


def squares(z: Floats) -> Floats:
    """Compute the loss of least squares, z."""
    return np.stack((z, np.ones_like(z), np.zeros_like(z)))


def soft_l1(z: Floats) -> Floats:
    """Compute the loss 2 (√(1 + z) - 1): nearly the square of small residuals, and linear in large ones."""
    root = np.sqrt(1.0 + z)
    return np.stack((2.0 * (root - 1.0), 1.0 / root, -0.5 / root**3))


def huber(z: Floats) -> Floats:
    """Compute Huber's loss (1964): the square of residuals up to `BEND`, and linear in larger ones."""
    size = np.sqrt(np.maximum(z, BEND**2))
    inside = z <= BEND**2
    value = np.where(inside, z, 2.0 * BEND * size - BEND**2)
    return np.stack((value, np.where(inside, 1.0, BEND / size), np.where(inside, 0.0, -0.5 * BEND / size**3)))


LOSSES: dict[str, Loss] = {LINEAR: squares, "soft_l1": soft_l1, "huber": huber}


def cost(loss: Loss, residuals: Floats) -> float:
    """Compute half the sum of ρ over residuals in units of their noise."""
    return float(0.5 * loss(residuals**2)[0].sum())


def calibration(loss: Loss, residuals: Floats) -> float:
    """Compute Σψ'/Σψ² for residuals in units of their noise; 1 for squares of residuals whose mean square is 1."""
    _, first, second = loss(residuals**2)
    return float((first + 2.0 * residuals**2 * second).sum() / max(((residuals * first) ** 2).sum(), 1e-300))


def noise_of(name: str, misfits: Floats, part_free: float) -> float:
    """Estimate the standard deviation of a column's noise from its misfits.

    A robust loss takes their median size, which outliers do not change.

    Args:
        name: Name of the loss.
        misfits: Answers less measurements, in the column's unit.
        part_free: Degrees of freedom over the number of measurements.
    """
    if name == LINEAR:
        return float(np.sqrt(np.mean(misfits**2) / part_free))
    return float(np.median(np.abs(misfits)) / NORMAL_MEDIAN / np.sqrt(part_free))
