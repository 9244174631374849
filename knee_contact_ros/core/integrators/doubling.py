"""Step doubling: two half steps, and their error from the comparison with one whole step.

Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 (Richardson's estimate). The
estimate is of the solution that goes on (no local extrapolation), so it is sharp and not an order too pessimistic.
"""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.integrators.base import FemurState, StateError, Step

SingleStep = Callable[[float, FemurState, float], Step]
"""(begin s [s], state, duration [s]) to a step without error estimate."""


STIFF = 100.0
"""h² k/m + h c/m from which on the method's order is the reduced one"""


def doubled_step(
    single: SingleStep, order: int, reduced: int, mass: float, s: float, state: FemurState, h: float
) -> Step:
    """Two steps of h/2 [s] by a method of `order`, with their estimated error.

    In a contact that is stiff against the step only the order `reduced` is left (Prothero & Robinson; Hairer & Wanner,
    Solving Ordinary Differential Equations II, section IV.15), and Richardson's estimate must be that order's.
    """
    whole = single(s, state, h)
    first = single(s, state, 0.5 * h)
    second = single(s + 0.5 * h, first.state, 0.5 * h)
    stiff = h * (h * first.stiffness + first.damping) > STIFF * mass
    gain = 2 ** (reduced if stiff else order) - 1
    stages = [stage._replace(fraction=0.5 * stage.fraction) for stage in first.stages]
    stages += [stage._replace(fraction=0.5 + 0.5 * stage.fraction) for stage in second.stages]
    # The middle's slopes carry an error over the step at second order; the end's would do so at first.
    return second._replace(
        error=StateError(
            (second.state.height - whole.state.height) / gain,
            (second.state.velocity - whole.state.velocity) / gain,
        ),
        begin=first.begin,
        stiffness=first.stiffness,
        damping=first.damping,
        stages=tuple(sorted(stages, key=lambda stage: stage.fraction)),
        evaluations=whole.evaluations + first.evaluations + second.evaluations,
        solved=whole.solved and first.solved and second.solved,
    )
