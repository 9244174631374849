"""Arrays that a caller gives, as plain numbers."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .types import Floats, Rows


class InputError(ValueError):
    """An argument that cannot be used. The text names it in one line, and says what is allowed."""


def plain_array(name: str, values: ArrayLike, dimensions: int | None = 1) -> Floats:
    """Return numbers as an array of float64; `dimensions` None: of any number of dimensions.

    Raises:
        InputError: they are no numbers, or masked, or have another number of dimensions.
    """
    if (masked := _masked_arrays()) and masked.is_masked(values):
        raise InputError(f"{name} must be finite, and not masked")
    try:
        array = np.asarray(values)
        if array.dtype.kind in "cmM":
            raise TypeError
        array = array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be numbers in an array") from None
    if dimensions is not None and array.ndim != dimensions:
        raise InputError(f"{name} has shape {array.shape}; allowed is (n,)")
    return array


def check_answers(answers: Any, *fields: str) -> Rows:
    """Return answers that have the fields.

    Raises:
        InputError: they are no record array of them.
    """
    names = getattr(getattr(answers, "dtype", None), "names", None) or ()
    is_masked = (masked := _masked_arrays()) and masked.isMaskedArray(answers)
    if is_masked or not {*fields} <= {*names} or answers.ndim != 1:
        raise InputError(f"answers must be those of run or solve, with {', '.join(fields)}")
    return answers  # type: ignore[no-any-return]


def _masked_arrays() -> ModuleType | None:
    """Return the module of masked arrays, if somebody has imported it: our own import would take 0.02 s."""
    return sys.modules.get("numpy.ma")
