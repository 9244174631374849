"""The number of independent values that a column of autocorrelated residuals is worth.

n values whose correlation over k samples is ρ(k) determine a mean as well as n / τ independent ones, τ = 1 + 2 Σ ρ(k)
(Bayley & Hammersley 1946, doi:10.2307/2983560). The sum ends where ρ is first 0 or less: the rest is mostly the
estimate's own noise. This holds for what changes as slowly as the residuals do; what changes faster is known better.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SURE = 4.0
"""The least ratio of the correlation with the next sample to its own standard deviation, for it to count"""


def correlations(misfit: Floats) -> Floats:
    """Compute the correlations of values with those k samples later, shape (n,); 1 at k = 0."""
    spectrum = np.fft.rfft(misfit, 2 * len(misfit))
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: len(misfit)]
    normed: Floats = products / max(float(products[0]), np.finfo(float).tiny)
    return normed


def alike(misfit: Floats) -> float:
    """Give the correlation with the next sample if it is significantly above 0, else 0."""
    if len(misfit) < 2:
        return 0.0
    next_one = float(correlations(misfit)[1])
    return next_one if next_one * np.sqrt(len(misfit)) > SURE else 0.0


def samples_per_value(misfit: Floats) -> float:
    """Give τ, 1 or more; 1 where the correlation is not significant."""
    if not alike(misfit):
        return 1.0
    known = correlations(misfit)
    ends = np.flatnonzero(known <= 0.0)
    return float(1.0 + 2.0 * known[1 : ends[0] if len(ends) else None].sum())


def independent_part(misfits: Mapping[str, Floats]) -> float:
    """Give 1 / τ of the column with the largest τ, which decides for all columns."""
    return 1.0 / max(map(samples_per_value, misfits.values()))
