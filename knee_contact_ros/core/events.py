"""Find the first boundary that a step crosses, and end the step on it (Illinois' method)."""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.integrators.base import NO_ERROR, FemurState, Stage, Step
from knee_contact_ros.core.regions import Margin

MAX_LOCATE = 60
"""Tries to end a step on a boundary."""

Attempt = Callable[[float], Step]
"""Duration [s] to a step from the present state, wherever it leads."""
Margins = Callable[[Stage], tuple[Margin, ...]]
"""A contact to its distances from the boundaries of the present region."""


def first_crossing(margins: Margins, step: Step, boundary: str) -> tuple[str, float] | None:
    """The boundary that a step crosses first and the part of the step by which it has; None if it stays inside.

    `boundary` is the one on which the step is known to end.
    """
    for stage in step.stages:
        for margin in margins(stage):
            if margin.value < -margin.rounding and not (stage.fraction == 1.0 and margin.boundary == boundary):
                return margin.boundary, stage.fraction
    return None


def end_on_boundary(
    attempt: Attempt, margins: Margins, state: FemurState, present: Stage, boundary: str, high: float
) -> tuple[Step, float, str]:
    """Shorten a step that crosses a boundary before `high` [s] until it ends on it.

    Returns the step, its duration and the boundary, or a shorter step and no boundary where the crossing that a stage
    has shown is not there at that step's end.
    """

    def margin(stage: Stage) -> Margin:
        return next(margin for margin in margins(stage) if margin.boundary == boundary)

    step = attempt(high)
    _, beyond, rounding = margin(step.stages[-1])
    if beyond >= 0.0:
        return step, high, ""
    low, inside = 0.0, margin(present).value
    if inside <= rounding:
        # The step begins on this boundary: unless a far smaller one leads inside first, it goes straight across.
        for shorter in (0.1 * high, 0.01 * high, 0.001 * high):
            within = attempt(shorter)
            if margin(within.stages[-1]).value > rounding:
                return within, shorter, ""
        return Step(state, NO_ERROR, present, (present,), 0.0, 0.0, 0, True), 0.0, boundary
    h, last = high, 0.0
    for _ in range(MAX_LOCATE):
        h = low + (high - low) * inside / (inside - beyond)
        if not low < h < high:
            break
        step = attempt(h)
        value = margin(step.stages[-1]).value
        if abs(value) <= 0.01 * rounding:
            break
        again = value * last > 0.0  # the other end has been kept twice: count it half
        if value < 0.0:
            high, beyond, inside = h, value, 0.5 * inside if again else inside
        else:
            low, inside, beyond = h, value, 0.5 * beyond if again else beyond
        last = value
    return step, h, boundary
