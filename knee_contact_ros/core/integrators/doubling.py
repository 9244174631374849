"""Step doubling: two half steps, and their error from the comparison with one whole step.

Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 (Richardson's estimate). The
estimate is of the solution that goes on (no local extrapolation), so it is sharp and not an order too pessimistic.
"""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.integrators.base import FemurState, StateError, Step

SingleStep = Callable[[float, FemurState, float], Step]
"""(begin s [s], state, duration [s]) to a step without error estimate."""


def doubled_step(single: SingleStep, order: int, s: float, state: FemurState, h: float) -> Step:
    """Two steps of h/2 [s] by a method of `order`, with their estimated error."""
    whole = single(s, state, h)
    first = single(s, state, 0.5 * h)
    second = single(s + 0.5 * h, first.state, 0.5 * h)
    gain = 2**order - 1
    stages = [stage._replace(fraction=0.5 * stage.fraction) for stage in first.stages]
    stages += [stage._replace(fraction=0.5 + 0.5 * stage.fraction) for stage in second.stages]
    return second._replace(
        error=StateError(
            (second.state.height - whole.state.height) / gain,
            (second.state.velocity - whole.state.velocity) / gain,
        ),
        stages=tuple(sorted(stages, key=lambda stage: stage.fraction)),
        evaluations=whole.evaluations + first.evaluations + second.evaluations,
        solved=whole.solved and first.solved and second.solved,
    )
