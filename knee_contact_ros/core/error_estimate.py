"""The error that the steps leave behind: each step's estimated error, carried along by the linearised contact."""

from __future__ import annotations

import math
import sys

from knee_contact_ros.core.integrators.base import Stage, StateError, Step
from knee_contact_ros.core.kernel_source import in_kernel

HORIZON = 0.1
"""How long [s] a velocity error counts where neither spring nor dashpot holds it back."""
SAFETY = 8.0
"""Published estimate over the carried one: room for what the linearisation and Richardson's estimate leave out."""
FAST_SWING = 5.0
"""Radians of the contact's oscillation in a step from which on the method damps it away."""
TINY = sys.float_info.min
"""Keeps what presses nothing from a division by 0"""


@in_kernel
def response(stiffness: float, damping: float, mass: float, h: float) -> tuple[float, float, float]:
    """How m ë + damping ė + stiffness e = 0 goes on for `h` [s], exactly (closed form of the 2 x 2 exponential).

    Returns a [-], b [s] and half the damping rate r [1/s]: e becomes (a + r b) e + b ė, and ė becomes
    (a - r b) ė - k/m b e.
    """
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    root = math.sqrt(abs(discriminant))
    if discriminant > 0.0:
        slow, fast = math.exp((root - half_rate) * h), math.exp(-(root + half_rate) * h)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / root, half_rate
    decay = math.exp(-half_rate * h)
    if discriminant < 0.0:
        return decay * math.cos(root * h), decay * math.sin(root * h) / root, half_rate
    return decay, decay * h, half_rate


@in_kernel
def carry(error: StateError, stiffness: float, damping: float, mass: float, h: float) -> StateError:
    """Carry an error over `h` [s] by m ë = -stiffness e - damping ė."""
    even, odd, half_rate = response(stiffness, damping, mass, h)
    return StateError(
        (even + half_rate * odd) * error.height + odd * error.velocity,
        (even - half_rate * odd) * error.velocity - stiffness / mass * odd * error.height,
    )


@in_kernel
def carry_in_flight(error: StateError, h: float) -> StateError:
    """Carry an error through a flight of `h` [s]; its parts must not cancel: after a bounce signs are weak."""
    reached = error.height + h * error.velocity
    return StateError(math.copysign(abs(error.height) + h * abs(error.velocity), reached), error.velocity)


@in_kernel
def decay_rate(stiffness: float, damping: float, mass: float) -> float:
    """Rate [1/s] at which the linearised contact forgets an error: real part of its slower eigenvalue."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    return half_rate if discriminant <= 0.0 else stiffness / mass / (half_rate + math.sqrt(discriminant))


@in_kernel
def swiftness(stiffness: float, damping: float, mass: float) -> float:
    """Largest rate [1/s] of the linearised contact: the modulus of its faster eigenvalue."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    return math.sqrt(stiffness / mass) if discriminant <= 0.0 else half_rate + math.sqrt(discriminant)


@in_kernel
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
    begin, end = step.begin, step.end
    if min(begin.stiffness, end.stiffness) < 0.25 * step.stiffness:  # as at first touch: all of the work may swing
        return math.sqrt(2.0 * abs((end.force - begin.force) * (end.depth - begin.depth)) / mass)
    before, after = swing(begin, load, load_rate, mass), swing(end, load + load_rate * h, load_rate, mass)
    return max(0.0, before * math.exp(-half_rate * h) - after)


@in_kernel
def swing(stage: Stage, load: float, load_rate: float, mass: float) -> float:
    """Speed [m/s] of a contact's departure from carrying the load [N] quasi-statically."""
    excess = (stage.force - load) / math.sqrt(stage.stiffness * mass)
    rate = stage.rate - load_rate / stage.stiffness
    return math.sqrt(rate * rate + excess * excess)


@in_kernel
def let_go(error: StateError, stiffness: float, mass: float) -> StateError:
    """Error of a femur that the contact lets go: in contact height and velocity turned into each other.

    The flight keeps the velocity's error, so all of the swing counts as one of the velocity.
    """
    swung = error.height * math.sqrt(stiffness / mass)
    return StateError(
        error.height, math.copysign(math.sqrt(error.velocity * error.velocity + swung * swung), error.velocity)
    )


@in_kernel
def behind_jump(error: StateError, rate: float, jump: float, off: float, mass: float, longest: float) -> StateError:
    """Error behind a boundary met at a `rate` [m/s] of the depth, where the force jumps [N].

    A femur that is too high meets it late, and misses the jump for that time (the saltation matrix of the event), but
    not for longer than `longest` [s]. Nor does the step end on the boundary itself, but `off` [m] beside it: by
    rounding, which counts where the contact is hard.
    """
    late = math.copysign(longest, error.height * rate)
    if abs(error.height) < abs(late * rate):
        late = error.height / rate
    beside = min(longest, abs(off / rate)) if rate != 0.0 else 0.0
    velocity = error.velocity - late * jump / mass
    return StateError(error.height, velocity + math.copysign(beside * jump / mass, velocity))


@in_kernel
def depth_error(error: StateError, stiffness: float, damping: float, mass: float) -> float:
    """Error of the depth [m] that an error of the state amounts to: the height's, and what the velocity's becomes."""
    holding = max(math.sqrt(stiffness / mass), damping / mass, 1.0 / HORIZON)
    becomes = error.velocity / holding
    return math.sqrt(error.height * error.height + becomes * becomes)


@in_kernel
def settled_doubt(reach: float, rate: float, load: float, last_load: float, mass: float, left: float) -> StateError:
    """Error of the static answer given `left` [s] before a tick's end, by all that may have gone on until then.

    `reach` [m] is how far the contact was from its rest, `rate` [m/s] its speed; `load` and `last_load` [N] those of
    both times. In contact the energy of the load over that distance bounds the speed; a load that pulls moves the femur
    freely.
    """
    pull = max(0.0, -min(load, last_load)) / mass
    speed = abs(rate) + math.sqrt(2.0 * max(abs(load), abs(last_load)) * reach / mass)
    if pull == 0.0:
        return StateError(reach + speed * min(left, HORIZON), speed)
    return StateError(reach + left * (speed + 0.5 * pull * left), speed + pull * left)
