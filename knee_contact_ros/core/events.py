"""End a step on the first boundary that it crosses (Illinois' method)."""

from __future__ import annotations

from knee_contact_ros.core.integrators.base import Step, staying
from knee_contact_ros.core.kernel_source import aside
from knee_contact_ros.core.prescribed import Interval, load_at
from knee_contact_ros.core.regions import NOWHERE, Region, margin, rounding
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.stepping import Going, attempt

MAX_LOCATE = 60
"""Tries to end a step on a boundary."""


@aside
def end_on_boundary(
    scene: Scene, interval: Interval, going: Going, region: Region, step: Step, h: float
) -> tuple[Going, Step, float, int]:
    """Shorten a step of `h` [s] that crosses a boundary until it ends on it.

    Returns the step, its duration and the boundary, or a shorter step and `NOWHERE` where the crossing that a stage has
    shown is not there at that step's end.
    """
    boundary, high, begin = step.crossing.boundary, step.crossing.fraction * h, step.begin
    enough = rounding(boundary, load_at(interval, going.s))
    going, step = attempt(scene, interval, going, region, high, boundary)
    beyond = margin(scene.regions, region, boundary, step.end.depth, step.end.force)
    if beyond >= 0.0:
        return going, step, high, NOWHERE
    low, inside = 0.0, margin(scene.regions, region, boundary, begin.depth, begin.force)
    if inside <= enough:
        # The step begins on this boundary: unless a far smaller one leads inside first, it goes straight across.
        shorter = high
        for _ in range(3):
            shorter *= 0.1
            going, step = attempt(scene, interval, going, region, shorter, boundary)
            if margin(scene.regions, region, boundary, step.end.depth, step.end.force) > enough:
                return going, step, shorter, NOWHERE
        return going, staying(going.state, begin), 0.0, boundary
    h, last = high, 0.0
    for _ in range(MAX_LOCATE):
        h = low + (high - low) * inside / (inside - beyond)
        if not low < h < high or going.given_up:
            break
        going, step = attempt(scene, interval, going, region, h, boundary)
        value = margin(scene.regions, region, boundary, step.end.depth, step.end.force)
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
    return going, step, h, boundary
