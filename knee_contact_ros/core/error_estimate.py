"""The error that the steps leave behind: each step's estimated error, carried along by the linearised contact."""

from __future__ import annotations

import math
from itertools import pairwise

from knee_contact_ros.core.integrators.base import Stage, StateError, Step

HORIZON = 0.1
"""How long [s] a velocity error counts where neither spring nor dashpot holds it back."""
SAFETY = 8.0
"""Published estimate over the carried one: room for what the linearisation and Richardson's estimate leave out."""

LARGEST_RADIUS = 0.2
"""Radius of curvature [m] of a contact that glides, femur and tibia taken together."""
FAST_SWING = 5.0
"""Radians of the contact's oscillation in a step from which on the method damps it away."""


def carry(error: StateError, stiffness: float, damping: float, mass: float, h: float) -> StateError:
    """Carry an error over `h` [s] by m ë = -stiffness e - damping ė, exactly (closed form of the 2 x 2 exponential)."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    root = math.sqrt(abs(discriminant))
    if discriminant > 0.0:
        slow, fast = math.exp((root - half_rate) * h), math.exp(-(root + half_rate) * h)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    elif discriminant < 0.0:
        decay = math.exp(-half_rate * h)
        even, odd = decay * math.cos(root * h), decay * math.sin(root * h) / root
    else:
        decay = math.exp(-half_rate * h)
        even, odd = decay, decay * h
    return StateError(
        (even + half_rate * odd) * error.height + odd * error.velocity,
        (even - half_rate * odd) * error.velocity - stiffness / mass * odd * error.height,
    )


def carry_in_flight(error: StateError, h: float) -> StateError:
    """Carry an error through a flight of `h` [s]; its parts must not cancel: after a bounce signs are weak."""
    reached = error.height + h * error.velocity
    return StateError(math.copysign(abs(error.height) + h * abs(error.velocity), reached), error.velocity)


def decay_rate(stiffness: float, damping: float, mass: float) -> float:
    """Rate [1/s] at which the linearised contact forgets an error: real part of its slower eigenvalue."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    return half_rate if discriminant <= 0.0 else stiffness / mass / (half_rate + math.sqrt(discriminant))


def lost_swing(step: Step, load: float, load_rate: float, mass: float, h: float) -> float:
    """Speed [m/s] of the oscillation that a step of `h` [s] has damped away though the contact does not.

    Where the contact swings several radians within the step, an L-stable method damps the swing at once, in the whole
    step as in its halves, so that doubling sees nothing. What swings is the contact's departure from carrying the load
    quasi-statically; between its beginning and its end the contact's own damping accounts for a part of the loss.
    `load` [N] is that at the beginning.
    """
    half_rate, square = 0.5 * step.damping / mass, step.stiffness / mass
    if square * h * h < FAST_SWING * FAST_SWING or half_rate * half_rate >= square:
        return 0.0
    begin, end = step.begin, step.stages[-1]

    def swing(stage: Stage, load: float) -> float:
        excess = (stage.force - load) / math.sqrt(stage.stiffness * mass)
        return math.hypot(stage.rate - load_rate / stage.stiffness, excess)

    if min(begin.stiffness, end.stiffness) < 0.25 * step.stiffness:  # as at first touch: all of the work may swing
        return math.sqrt(2.0 * abs((end.force - begin.force) * (end.depth - begin.depth)) / mass)
    before, after = swing(begin, load), swing(end, load + load_rate * h)
    return max(0.0, before * math.exp(-half_rate * h) - after)


def leap(step: Step, angle_rate: float, h: float) -> float:
    """Change of the depth's rate [m/s] by a leap of the contact from bump to bump within a step of `h` [s]; 0 if none.

    A contact that glides does so by its radius of curvature times the turn: beyond `LARGEST_RADIUS` it has leapt.
    """
    largest = 0.0
    for before, after in pairwise((step.begin, *step.stages)):
        glide = LARGEST_RADIUS * angle_rate * angle_rate * (after.fraction - before.fraction) * h
        jump = abs(after.surface_rate - before.surface_rate)
        largest = max(largest, jump) if jump > glide else largest
    return largest


def behind_jump(error: StateError, rate: float, jump: float, mass: float, longest: float) -> StateError:
    """Error behind a boundary met at a `rate` [m/s] of the depth, where the force jumps [N].

    A femur that is too high meets it late, and misses the jump for that time (the saltation matrix of the event), but
    not for longer than `longest` [s].
    """
    late = math.copysign(longest, error.height * rate)
    if abs(error.height) < abs(late * rate):
        late = error.height / rate
    return StateError(error.height, error.velocity - late * jump / mass)


def depth_error(error: StateError, stiffness: float, damping: float, mass: float) -> float:
    """Error of the depth [m] that an error of the state amounts to: the height's, and what the velocity's becomes."""
    holding = max(math.sqrt(stiffness / mass), damping / mass, 1.0 / HORIZON)
    return math.hypot(error.height, error.velocity / holding)


def settled_doubt(reach: float, rate: float, loads: tuple[float, float], mass: float, left: float) -> StateError:
    """Error of the static answer given `left` [s] before a tick's end, by all that may have gone on until then.

    `reach` [m] is how far the contact was from its rest, `rate` [m/s] its speed; `loads` [N] those of both times. In
    contact the energy of the load over that distance bounds the speed; a load that pulls moves the femur freely.
    """
    pull = max(0.0, -min(loads)) / mass
    speed = abs(rate) + math.sqrt(2.0 * max(map(abs, loads)) * reach / mass)
    if pull == 0.0:
        return StateError(reach + speed * min(left, HORIZON), speed)
    return StateError(reach + left * (speed + 0.5 * pull * left), speed + pull * left)
