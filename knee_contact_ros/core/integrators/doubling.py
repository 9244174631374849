"""Step doubling: two half steps, with an error estimate from their difference to one whole step.

Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 (Richardson's estimate). The
estimate is that of the solution that is continued (no local extrapolation), so it is sharp and not an order too
pessimistic.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.contact_modes import NOWHERE
from knee_contact_ros.core.integrators.base import Crossing, FemurState, Motion, StateError, Step
from knee_contact_ros.core.integrators.esdirk4 import esdirk4_step
from knee_contact_ros.core.kernel_source import never_inlined

STIFF = 100.0
"""h² k/m + h c/m above which the order of the method is the reduced one"""


@never_inlined
def doubled_step(
    motion: Motion, order: int, reduced: int, s: float, state: FemurState, h: float, resolution: float, most: int
) -> Step:
    """Take two ESDIRK steps of h/2 [s] and estimate their error; the method has the given `order`.

    In a contact that is stiff against the step only the order `reduced` is left (Prothero & Robinson; Hairer & Wanner,
    Solving Ordinary Differential Equations II, section IV.15), and Richardson's estimate must be that order's. `most`
    limits the evaluations; each stage takes one at least.
    """
    whole = esdirk4_step(motion, s, state, h, resolution, most)
    first = esdirk4_step(motion._replace(known=NOWHERE), s, state, 0.5 * h, resolution, most - whole.evaluations)
    left = most - whole.evaluations - first.evaluations
    second = esdirk4_step(motion, s + 0.5 * h, first.state, 0.5 * h, resolution, left)
    # A contact without mass is solved in this way only where it is stiff.
    stiff = h * (h * first.stiffness + first.damping) > STIFF * motion.mass
    gain = 2.0 ** (reduced if stiff else order) - 1.0
    crossing = Crossing(second.crossing.boundary, 0.5 + 0.5 * second.crossing.fraction)
    if first.crossing.boundary != NOWHERE:
        crossing = Crossing(first.crossing.boundary, 0.5 * first.crossing.fraction)
    compared = (second.state.height - whole.state.height) / gain
    # The middle's slopes carry an error over the step at second order; the end's would do so at first.
    return Step(
        state=second.state,
        error=StateError(
            compared + math.copysign(first.error.height + second.error.height, compared),
            (second.state.velocity - whole.state.velocity) / gain,
        ),
        begin=first.begin, end=second.end, crossing=crossing, stiffness=first.stiffness, damping=first.damping,
        cosine=first.cosine, leapt=max(first.leapt, second.leapt),
        evaluations=whole.evaluations + first.evaluations + second.evaluations,
        solved=whole.solved and first.solved and second.solved,
    )  # fmt: skip
