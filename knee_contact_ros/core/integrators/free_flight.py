"""Free flight of the femur, without contact force: exact, because the load is linear in time."""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_modes import NOWHERE, has_deeper
from knee_contact_ros.core.integrators.base import (
    INSIDE,
    Crossing,
    FemurState,
    Motion,
    Stage,
    StateError,
    Step,
    earlier,
    force_on,
)
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.prescribed import Interval, load_at, touch_at

PARTS = 4
"""Number of parts of a flight, at whose ends the contact is evaluated"""
MAX_PEAK = 10
"""Largest number of stages for finding an extreme between two stages."""
PEAK_RATE = 1e-9
"""Rate [m/s] below which an extreme counts as found."""

LAUNCH_ROUNDING = 2e-12
"""Error of a flight, as a part of its way, by the rounding of the event before it."""


class Look(NamedTuple):
    """The contact at a time of a flight, with the slopes of the force that the surfaces would exert."""

    stage: Stage
    stiffness: float
    """Slope of the force over the depth [N/m]; 0 when apart"""
    damping: float
    """Slope of the force over the rate [N s/m]; 0 when apart"""


@never_inlined
def free_flight_step(motion: Motion, s: float, state: FemurState, h: float) -> Step:
    """Fly for `h` [s] from s [s] on. While the surfaces overlap, the force that they would exert is monitored.

    The surfaces may meet and part again between two stages (a turning profile brushes the plateau, or the load presses
    for a moment): where the depth has a maximum between them, it becomes a stage too, and so does the place where the
    depth's rate turns round, which may be the only one at which the surfaces approach each other. Surfaces that overlap
    press again where the force has a maximum above 0, which neither the depth nor its rate need have.
    """
    begin = in_flight(motion, s, state, 0.0)
    crossing, before, low, stages = INSIDE, begin, 0.0, 1
    for part in range(1, PARTS + 1):
        high = part / PARTS
        look = in_flight(motion, s, state, high * h)
        turn = turning(motion, h, low, high, before.stage.rate, look.stage.rate)
        if low < turn < high:
            between = in_flight(motion, s, state, turn * h)
            crossing, extra = looked_at(crossing, motion, s, state, h, low, turn, before, between)
            before, low, stages = between, turn, stages + 1 + extra
        crossing, extra = looked_at(crossing, motion, s, state, h, low, high, before, look)
        before, low, stages = look, high, stages + 1 + extra
    end = flight(motion.interval, motion.mass, s, state, h)
    error = StateError(launch_rounding(state, end), 0.0)
    return Step(
        state=end, error=error, begin=begin.stage, end=before.stage, crossing=crossing, stiffness=0.0, damping=0.0,
        cosine=1.0, leapt=0.0, evaluations=stages if motion.mode.layer >= 0 else 0, solved=True,
    )  # fmt: skip


@in_kernel
def turning(motion: Motion, h: float, low: float, high: float, before: float, after: float) -> float:
    """Return where the depth's rate is extreme between two parts of a flight, from its values [m/s] at these.

    Under a load that is linear in time the rate is a parabola; NaN for a constant load.
    """
    duration, load_rate = (high - low) * h, motion.interval.load_rate
    if load_rate == 0.0 or duration <= 0.0:
        return math.nan
    return 0.5 * (low + high) - (after - before) / duration * motion.mass / load_rate / h


@in_kernel
def looked_at(
    crossing: Crossing, motion: Motion, s: float, state: FemurState, h: float,
    low: float, high: float, before: Look, look: Look,
) -> tuple[Crossing, int]:  # fmt: skip
    """Return the first crossing up to the contact `look` at the part `high` of a flight; `before` is that at `low`.

    Surfaces that overlap may part and meet again in between, which begins another contact, or press for a moment. The
    second number is that of additional stages in between.
    """
    extra, overlaps, rate, rising = 0, motion.mode.layer >= 0, look.stage.rate, before.stage.rate
    deepest = rising > 0.0 > rate and has_deeper(motion.modes, motion.mode)
    if (overlaps and rising < 0.0 < rate) or deepest:
        crossing, extra = towards_extreme(crossing, motion, s, state, h, low, high, rising, rate, math.nan)
    if overlaps and low < high and crossing.boundary == NOWHERE:
        at_once = (rate - rising) / ((high - low) * h) - 0.5 * (low + high) * h * bend(motion)
        rising, falling = change(motion, before, low * h, at_once), change(motion, look, high * h, at_once)
        if rising > 0.0 > falling:
            crossing, more = towards_extreme(crossing, motion, s, state, h, low, high, rising, falling, at_once)
            extra += more
    return earlier(crossing, motion, look.stage, s + high * h, high), extra


@in_kernel
def bend(motion: Motion) -> float:
    """Return the rate of the depth's acceleration in a flight [m/s³], without what the surfaces add."""
    return motion.interval.load_rate / motion.mass


@in_kernel
def change(motion: Motion, look: Look, t: float, at_once: float) -> float:
    """Return the rate of the force [N/s] at t [s] of a flight that begins with the acceleration `at_once` [m/s²].

    That is the acceleration of the depth; if it is NaN, the rate of the depth [m/s] is returned instead.
    """
    if math.isnan(at_once):
        return look.stage.rate
    return look.stiffness * look.stage.rate + look.damping * (at_once + bend(motion) * t)


@never_inlined
def in_flight(motion: Motion, s: float, state: FemurState, t: float) -> Look:
    """Return the contact after a flight of `t` [s] from s [s] on."""
    there = flight(motion.interval, motion.mass, s, state, t)
    depth, surface_rate, cosine = touch_at(motion.interval, s + t).touch(there.height)
    rate = surface_rate - cosine * there.velocity
    force, stiffness, damping = 0.0, 0.0, 0.0
    if motion.mode.layer >= 0:
        force, stiffness, damping = force_on(motion, depth, rate)
    stage = Stage(depth=depth, rate=rate, force=force, stiffness=0.0, surface_rate=surface_rate)
    return Look(stage, stiffness, damping)


@in_kernel
def flight(interval: Interval, mass: float, s: float, state: FemurState, t: float) -> FemurState:
    """Return height and velocity after a flight of `t` [s] from s [s] on."""
    load, load_rate = load_at(interval, s), interval.load_rate
    return FemurState(
        state.height + t * (state.velocity - t * (0.5 * load + load_rate * t / 6.0) / mass),
        state.velocity - t * (load + 0.5 * load_rate * t) / mass,
    )


@in_kernel
def launch_rounding(begin: FemurState, end: FemurState) -> float:
    """Return the error [m] at the end of a flight by the rounding of the event before it."""
    return LAUNCH_ROUNDING * abs(end.height - begin.height)


@never_inlined
def towards_extreme(
    crossing: Crossing, motion: Motion, s: float, state: FemurState, h: float,
    low: float, high: float, rising: float, falling: float, at_once: float,
) -> tuple[Crossing, int]:  # fmt: skip
    """Evaluate stages towards the extreme of depth or force between two stages, where its `change` is 0 (Illinois).

    `low` and `high` are the parts of the step, `rising` and `falling` the changes there, for a minimum with the
    other sign. Returns the first crossing so far, and the number of stages.
    """
    last, extra = 0.0, 0
    for _ in range(MAX_PEAK):
        middle = low + (high - low) * rising / (rising - falling)
        if not low < middle < high:
            break
        look = in_flight(motion, s, state, middle * h)
        extra += 1
        crossing = earlier(crossing, motion, look.stage, s + middle * h, middle)
        value = change(motion, look, middle * h, at_once)
        if abs(value) <= PEAK_RATE or (crossing.fraction == middle and not math.isnan(at_once)):
            break
        again = value * last > 0.0  # the other end has been kept twice: count it half
        if value * rising > 0.0:
            low, rising = middle, value
            falling = 0.5 * falling if again else falling
        else:
            high, falling = middle, value
            rising = 0.5 * rising if again else rising
        last = value
    return crossing, extra
