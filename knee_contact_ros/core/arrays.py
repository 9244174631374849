"""Types of arrays, and a binary search that can be compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.kernel_source import in_kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@in_kernel
def count_up_to(values: Floats, limit: float) -> int:
    """Return how many of the increasing `values` are <= `limit`."""
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) // 2
        if limit < values[middle]:
            high = middle
        else:
            low = middle + 1
    return low
