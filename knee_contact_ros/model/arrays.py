"""Arrays that a caller gives, as plain numbers."""

import numpy as np
from numpy.typing import ArrayLike

from .types import Floats


class InputError(ValueError):
    """An argument that cannot be used. The text names it in one line, and says what is allowed."""


def plain_array(name: str, values: ArrayLike, dimensions: int = 1) -> Floats:
    """Return numbers as an array of float64.

    Raises:
        InputError: they are no numbers, or masked, or have another number of dimensions.
    """
    if np.ma.is_masked(values):
        raise InputError(f"{name} must not be masked")
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be numbers in an array") from None
    if array.ndim != dimensions:
        raise InputError(
            f"{name} must have {dimensions} dimension(s), and has shape {array.shape}"
        )
    return array
