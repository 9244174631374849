"""How many independent values a column of residuals is worth that are alike from sample to sample.

n values whose correlation over k samples is ρ(k) know a mean as well as n / τ independent ones, τ = 1 + 2 Σ ρ(k)
(Bayley & Hammersley 1946, doi:10.2307/2983560). The sum ends where ρ is first 0 or less: what follows is mostly the
estimate's own noise. So it is for what changes as slowly as the residuals do; what changes sooner is known better.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
SURE = 4.0
"""By how many of its own standard deviations the correlation with the next sample must differ from none, to count"""


def correlations(misfit: Floats) -> Floats:
    """Of values with those k samples later, shape (n,); 1 at k = 0."""
    spectrum = np.fft.rfft(misfit, 2 * len(misfit))
    products = np.fft.irfft(np.abs(spectrum) ** 2)[: len(misfit)]
    found: Floats = products / max(float(products[0]), np.finfo(float).tiny)
    return found


def alike(misfit: Floats) -> float:
    """Correlation with the next sample where it is surely above 0; else 0."""
    if len(misfit) < 2:
        return 0.0
    next_one = float(correlations(misfit)[1])
    return next_one if next_one * np.sqrt(len(misfit)) > SURE else 0.0


def samples_per_value(misfit: Floats) -> float:
    """τ, 1 or more; 1 where they are not surely alike."""
    if not alike(misfit):
        return 1.0
    known = correlations(misfit)
    ends = np.flatnonzero(known <= 0.0)
    return float(1.0 + 2.0 * known[1 : ends[0] if len(ends) else None].sum())


def independent_part(misfits: Mapping[str, Floats]) -> float:
    """1 / τ of the column whose values are most alike: it decides for all."""
    return 1.0 / max(map(samples_per_value, misfits.values()))
