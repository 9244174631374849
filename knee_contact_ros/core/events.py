"""Shortening of a step until it ends on the first boundary that it crosses (the Illinois method)."""

from __future__ import annotations

from knee_contact_ros.core.contact_modes import NOWHERE, ContactMode, event_function, rounding
from knee_contact_ros.core.integrators.base import Step, staying
from knee_contact_ros.core.kernel_source import never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.stepping import StepperState, attempt

MAX_LOCATE = 60
"""Largest number of attempts to end a step on a boundary."""


@never_inlined
def end_on_boundary(
    scene: Scene, interval: Interval, stepper: StepperState, mode: ContactMode, step: Step, h: float
) -> tuple[StepperState, Step, float, int]:
    """Shorten a step of `h` [s] that crosses a boundary until it ends on it.

    Returns the step, its duration [s] and the boundary; or a shorter step and `NOWHERE` where its end does not
    confirm the crossing that a stage has shown.
    """
    boundary, high, begin = step.crossing.boundary, step.crossing.fraction * h, step.begin
    enough = rounding(boundary, load_at(interval, stepper.s))
    stepper, step = attempt(scene, interval, stepper, mode, high, boundary)
    beyond = event_function(scene.modes, mode, boundary, step.end.depth, step.end.force)
    if beyond >= 0.0:
        return stepper, step, high, NOWHERE
    low, inside = 0.0, event_function(scene.modes, mode, boundary, begin.depth, begin.force)
    if inside <= enough:
        # The step begins on this boundary: unless a far smaller one leads inside first, it goes straight across.
        shorter = high
        for _ in range(3):
            shorter *= 0.1
            stepper, step = attempt(scene, interval, stepper, mode, shorter, boundary)
            if event_function(scene.modes, mode, boundary, step.end.depth, step.end.force) > enough:
                return stepper, step, shorter, NOWHERE
        return stepper, staying(stepper.state, begin), 0.0, boundary
    h, last = high, 0.0
    for _ in range(MAX_LOCATE):
        h = low + (high - low) * inside / (inside - beyond)
        if not low < h < high or stepper.given_up:
            break
        stepper, step = attempt(scene, interval, stepper, mode, h, boundary)
        value = event_function(scene.modes, mode, boundary, step.end.depth, step.end.force)
        if abs(value) <= 0.01 * enough:
            break
        again = value * last > 0.0  # the other end has been kept twice: count it half
        if value < 0.0:
            high, beyond = h, value
            inside = 0.5 * inside if again else inside
        else:
            low, inside = h, value
            beyond = 0.5 * beyond if again else beyond
        last = value
    return stepper, step, h, boundary
