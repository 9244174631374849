"""The Runge-Kutta methods as tables of numbers (Butcher's tableaus), and the sums over stages that all steps compute.

The row of a stage has its weights of the stages before it. The stages themselves are written one after another in
`fehlberg.py`, `massless.py` and `esdirk4.py`: see `docs/decisions/0037-one-kernel.md` for what a loop over them costs.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.kernel_source import always_inlined


class Pair(NamedTuple):
    """An explicit method of 6 stages with an estimate of its error."""

    nodes: tuple[float, ...]
    """Times of the stages, as parts of the step"""
    second: tuple[float, ...]
    """Row of the second stage; the following fields are those of the other stages"""
    third: tuple[float, ...]
    fourth: tuple[float, ...]
    fifth: tuple[float, ...]
    sixth: tuple[float, ...]
    weights: tuple[float, ...]
    """Weights of the stages 1, 3, 4 and 5 in the solution that is continued"""
    error: tuple[float, ...]
    """Weights of the stages 1, 3, 4, 5 and 6, less those in the solution of the next order"""


class Implicit(NamedTuple):
    """A method whose stages, except the first, are implicit in themselves."""

    nodes: tuple[float, ...]
    diagonal: float
    """Weight of every implicit stage in its own equation"""
    second: tuple[float, ...]
    third: tuple[float, ...]
    fourth: tuple[float, ...]
    fifth: tuple[float, ...]
    last: tuple[float, ...]
    """Row of the last stage, for the stages 1, 3, 4 and 5; the last stage is the end of the step"""


FEHLBERG = Pair(
    nodes=(0.0, 1 / 4, 3 / 8, 12 / 13, 1.0, 1 / 2),
    second=(1 / 4,),
    third=(3 / 32, 9 / 32),
    fourth=(1932 / 2197, -7200 / 2197, 7296 / 2197),
    fifth=(439 / 216, -8.0, 3680 / 513, -845 / 4104),
    sixth=(-8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40),
    weights=(25 / 216, 1408 / 2565, 2197 / 4104, -1 / 5),
    error=(25 / 216 - 16 / 135, 1408 / 2565 - 6656 / 12825, 2197 / 4104 - 28561 / 56430, -1 / 5 + 9 / 50, -2 / 55),
)
"""Orders 4 and 5; Fehlberg 1969, NASA TR R-315, formula 2"""
ESDIRK4 = Implicit(
    nodes=(0.0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1.0),
    diagonal=1 / 4,
    second=(1 / 4,),
    third=(8611 / 62500, -1743 / 31250),
    fourth=(5012029 / 34652500, -654441 / 2922500, 174375 / 388108),
    fifth=(15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912),
    last=(82889 / 524892, 15625 / 83664, 69875 / 102672, -2260 / 8211),
)
"""Order 4, L-stable; Kennedy & Carpenter 2003, doi:10.1016/S0168-9274(02)00138-1, implicit half of ARK4(3)6L[2]SA"""


@always_inlined
def weighted(weights: tuple[float, ...], slopes: tuple[float, ...]) -> float:
    """Return the sum of slopes times their weights."""
    total = weights[0] * slopes[0]
    for i in range(1, len(weights)):
        total += weights[i] * slopes[i]
    return total


@always_inlined
def ahead(start: float, h: float, weights: tuple[float, ...], slopes: tuple[float, ...]) -> float:
    """Return the value of a stage: `start` plus `h` [s] times the weighted slopes."""
    return start + h * weighted(weights, slopes)


@always_inlined
def onward(start: float, h: float, weights: tuple[float, ...], slopes: tuple[float, ...], newest: float) -> float:
    """Return `ahead` with the `newest` slope added last, so that the other terms can be computed before it is known."""
    return ahead(start, h, weights[:-1], slopes) + h * weights[-1] * newest
