"""The coefficients of the two Runge-Kutta methods, one for explicit and one for implicit steps.

`tests/model/test_dynamics.py` checks their order conditions and the stability of the implicit method. Coefficients are
tuples of floats: the compiler folds them, and plain Python computes with them faster than with NumPy's scalars.
"""

from typing import NamedTuple


class Tableau(NamedTuple):
    """A method with six stages, whose first one lies at the beginning of the step."""

    nodes: tuple[float, ...]
    """Times of the second to the sixth stage, as fractions of the step"""
    stages: tuple[tuple[float, ...], ...]
    """For the second to the sixth stage, the weights of the stages before it"""
    diagonal: float = 0.0
    """Weight of a stage in its own equation, the same for all but the first"""
    weights: tuple[float, ...] = ()
    """Weights of the solution that is continued; none where it is the last stage"""
    errors: tuple[float, ...] = ()
    """The same weights minus those of the solution of higher order, which estimates the error"""


# Fehlberg 1969, NASA TR R-315, formula 2. Dormand and Prince's pair is the more usual one, but it continues the 5th
# order, whose error its estimate does not measure. Here the 4th order is continued, and the estimate is of that.
FEHLBERG = Tableau(
    nodes=(1 / 4, 3 / 8, 12 / 13, 1.0, 1 / 2),
    stages=(
        (1 / 4,),
        (3 / 32, 9 / 32),
        (1932 / 2197, -7200 / 2197, 7296 / 2197),
        (439 / 216, -8.0, 3680 / 513, -845 / 4104),
        (-8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40),
    ),
    weights=(25 / 216, 0.0, 1408 / 2565, 2197 / 4104, -1 / 5, 0.0),
    errors=(
        25 / 216 - 16 / 135,
        0.0,
        1408 / 2565 - 6656 / 12825,
        2197 / 4104 - 28561 / 56430,
        -1 / 5 + 9 / 50,
        -2 / 55,
    ),
)
# Kennedy and Carpenter 2003, doi:10.1016/S0168-9274(02)00138-1, the implicit half of ARK4(3)6L[2]SA: order 4, L-stable,
# stiffly accurate, stage order 2. With one coordinate an implicit stage costs one scalar equation, so a method with
# several of them pays. A multistep method would have to start again behind every event.
ESDIRK = Tableau(
    nodes=(1 / 2, 83 / 250, 31 / 50, 17 / 20, 1.0),
    stages=(
        (1 / 4,),
        (8611 / 62500, -1743 / 31250),
        (5012029 / 34652500, -654441 / 2922500, 174375 / 388108),
        (
            15267082809 / 155376265600,
            -71443401 / 120774400,
            730878875 / 902184768,
            2285395 / 8070912,
        ),
        (82889 / 524892, 0.0, 15625 / 83664, 69875 / 102672, -2260 / 8211),
    ),
    diagonal=1 / 4,
)
