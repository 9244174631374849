"""The error that the steps leave behind, carried along by the linearised contact: its expected value and its spread.

Each step adds its estimated error to the expected one and a part of it to the spread (the estimate of an error is
itself in error), in the contact's energy norm. Both then go on as the contact does: spring, dashpot, flight and events
turn them in closed form, so that parts that cancel do cancel, and what is not known of them never does.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from knee_contact_ros.core.integrators.base import Stage, StateError, Step
from knee_contact_ros.core.kernel_source import always_inlined, in_kernel

HORIZON = 0.1
"""How long [s] a velocity error counts where neither spring nor dashpot holds it back."""
EXPECTED, SPREAD = 1.25, 3.0
"""Published estimate: so many times the expected error and so many standard deviations"""
STEPWISE = 1.6
"""Expected error of a step over its estimate: steps of one kind err alike, and estimates of them are small alike"""
UNKNOWN, UNKNOWN_IMPLICIT = 2.0, 4.5
"""Part of a step's estimated error that is not known: its size; that of an implicit step is of an order between two"""
TURNED = 0.5
"""The same for its direction: how much of it may be a height's error instead of a velocity's, or the reverse"""
ALIKE = 0.1
"""The part of it that is the same in all steps, so that it adds up as their errors do, and not as their squares"""
LARGEST_HEIGHT_ERROR, LARGEST_VELOCITY_ERROR = 1e7, 1e7
"""[m] and [m/s]: no femur is farther from where its answer has it"""
FAST_SWING = 5.0
"""Radians of the contact's oscillation in a step from which on the method damps it away."""
KICKED = 0.3
"""Part of the way of a transient that a step which does not resolve it errs by"""
TINY = sys.float_info.min
"""Keeps what presses nothing from a division by 0"""
SLOW = 4.0
"""Square of the radians of a swing, or of the decays of a velocity, in a step: Magnus' series converges"""
BENT = 1e-3
"""Errors up to this part of the depth meet a straight contact"""
NEAR_ZERO = 1.0
"""Square of the radians of a swing, or of the rate times the duration of a decay, up to which a series is quicker"""
SERIES = (
    (1 / 132, 1 / 156), (1 / 90, 1 / 110), (1 / 56, 1 / 72), (1 / 30, 1 / 42), (1 / 12, 1 / 20), (1 / 2, 1 / 6),
)  # fmt: skip
"""That of cosh and sinh of a root: each coefficient over the one before, from the last"""
CURVATURE = 0.5
"""Force that the curve of the contact law adds to an error's, over stiffness times error times its part of the depth"""


@in_kernel
def response(spring: float, drag: float, h: float) -> tuple[float, float, float]:
    """How ë + drag ė + spring e = 0 goes on for `h` [s], by the 2 x 2 exponential: k/m [1/s²] and c/m [1/s].

    Returns a [-], b [s] and half the damping rate r [1/s]: e becomes (a + r b) e + b ė, and ė becomes
    (a - r b) ė - k/m b e.
    """
    half_rate = 0.5 * drag
    discriminant = half_rate * half_rate - spring
    square = discriminant * h * h
    if abs(square) <= NEAR_ZERO:
        even, odd = response_by_series(square, half_rate, h)
        return even, odd, half_rate
    root = math.sqrt(abs(discriminant))
    if discriminant > 0.0:
        slow, fast = math.exp((root - half_rate) * h), math.exp(-(root + half_rate) * h)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / root, half_rate
    decay = math.exp(-half_rate * h)
    return decay * math.cos(root * h), decay * math.sin(root * h) / root, half_rate


@always_inlined
def response_by_series(square: float, half_rate: float, h: float) -> tuple[float, float]:
    """The first two of `response` by a series; `square` is that of the root times the duration."""
    decay, even, odd = math.exp(-half_rate * h), 1.0, 1.0
    for over_even, over_odd in SERIES:
        even, odd = 1.0 + square * over_even * even, 1.0 + square * over_odd * odd
    return decay * even, decay * h * odd


class CarriedError(NamedTuple):
    """Error of a femur state."""

    height: float
    """Expected [m]"""
    velocity: float
    """Expected [m/s]"""
    hh: float
    """Variance of the height's error about that [m²]"""
    hv: float
    """Covariance of both [m²/s]"""
    vv: float
    """Variance of the velocity's [m²/s²]"""


EXACT = CarriedError(height=0.0, velocity=0.0, hh=0.0, hv=0.0, vv=0.0)


@in_kernel
def propagated(error: CarriedError, stiffness: float, damping: float, mass: float, h: float) -> CarriedError:
    """Carry an error over `h` [s] by m ë = -stiffness e - damping ė."""
    spring = stiffness / mass
    even, odd, half_rate = response(spring, damping / mass, h)
    return turned(error, even + half_rate * odd, odd, -spring * odd, even - half_rate * odd)


@in_kernel
def carry_on(
    error: CarriedError, begin: float, middle: float, end: float, damping: float, mass: float, h: float
) -> CarriedError:
    """The error behind a step over which the stiffness changes: at its begin, middle and end [N/m].

    The 4th order of Magnus' series (Blanes et al. 2009, doi:10.1016/j.physrep.2008.11.001), its second term halved to
    both sides of the first: a swing's period depends on its size, and an error of the size adds up in the phase.
    """
    per_mass = 1.0 / mass
    spring, drag = (begin + 4.0 * middle + end) * (per_mass / 6.0), damping * per_mass
    grown = 1.0 + h * h * (end - begin) * (per_mass / 24.0)
    if h * h * max(spring, drag * drag) > SLOW or not 0.5 < grown < 2.0:
        return propagated(error, middle, damping, mass, h)
    even, odd, half_rate = response(spring, drag, h)
    return turned_between(error, spring, drag, grown, even, odd, half_rate)


@always_inlined
def carry_on_by_series(
    error: CarriedError, begin: float, middle: float, end: float, damping: float, mass: float, h: float
) -> tuple[CarriedError, bool]:
    """What `carry_on` gives in nearly all steps, without a branch; and whether it does here."""
    per_mass = 1.0 / mass
    spring, drag = (begin + 4.0 * middle + end) * (per_mass / 6.0), damping * per_mass
    grown = 1.0 + h * h * (end - begin) * (per_mass / 24.0)
    half_rate = 0.5 * drag
    square = (half_rate * half_rate - spring) * h * h
    known = h * h * max(spring, drag * drag) <= SLOW and 0.5 < grown < 2.0 and abs(square) <= NEAR_ZERO
    even, odd = response_by_series(square, half_rate, h)
    return turned_between(error, spring, drag, max(grown, 0.5), even, odd, half_rate), known


@always_inlined
def turned_between(
    error: CarriedError, spring: float, drag: float, grown: float, even: float, odd: float, half_rate: float
) -> CarriedError:
    """The error under both terms of Magnus' series: half of the second, the first, and half of the second again."""
    shrunk, across = 1.0 / grown, -drag * (grown - 1.0)
    a, b, c, d = even + half_rate * odd, odd, -spring * odd, even - half_rate * odd
    left, right = a * grown + b * across, c * grown + d * across
    b, d = b * shrunk, d * shrunk
    return turned(error, grown * left, grown * b, across * left + shrunk * right, across * b + shrunk * d)


@in_kernel
def turned(error: CarriedError, a: float, b: float, c: float, d: float) -> CarriedError:
    """The error under a linear map: a e + b ė, c e + d ė."""
    hh, hv, vv = error.hh, error.hv, error.vv
    return CarriedError(
        height=a * error.height + b * error.velocity, velocity=c * error.height + d * error.velocity,
        hh=a * a * hh + 2.0 * a * b * hv + b * b * vv, hv=a * c * hh + (a * d + b * c) * hv + b * d * vv,
        vv=c * c * hh + 2.0 * c * d * hv + d * d * vv,
    )  # fmt: skip


@in_kernel
def with_step(error: CarriedError, local: StateError, unknown: float, held: float) -> CarriedError:
    """The error behind a step with an estimated error of its own, of which a part is `unknown`; `held`: see `reach`."""
    h, v = local.height, local.velocity
    square = held * held * h * h + v * v
    spread = 0.5 * (held * held * max(error.hh, 0.0) + max(error.vv, 0.0))
    aside = TURNED * TURNED * square + 2.0 * ALIKE * math.sqrt(square * spread)
    return CarriedError(
        height=error.height + STEPWISE * h, velocity=error.velocity + STEPWISE * v,
        hh=error.hh + unknown * unknown * h * h + aside / (held * held),
        hv=error.hv + unknown * unknown * h * v, vv=error.vv + unknown * unknown * v * v + aside,
    )  # fmt: skip


@in_kernel
def with_bound(error: CarriedError, height: float, velocity: float) -> CarriedError:
    """The error where height [m] and velocity [m/s] may differ by so much more, in the same direction each time."""
    h = math.sqrt(max(error.hh, 0.0)) + height / SPREAD
    v = math.sqrt(max(error.vv, 0.0)) + velocity / SPREAD
    return error._replace(hh=h * h, vv=v * v)


@in_kernel
def with_bound_aside(error: CarriedError, height: float, velocity: float) -> CarriedError:
    """An error with one more that has to do with it itself: it adds to what does not follow from the other.

    A femur that is late errs in height and velocity by much, and how it goes on from there by little.
    """
    hh, hv, vv = max(error.hh, 0.0), error.hv, max(error.vv, 0.0)
    if velocity > 0.0:
        follows = hv * hv / hh if hh > 0.0 else 0.0
        own = math.sqrt(max(vv - follows, 0.0)) + velocity / SPREAD
        vv = min(follows, vv) + own * own
    if height > 0.0:
        follows = hv * hv / vv if vv > 0.0 else 0.0
        own = math.sqrt(max(hh - follows, 0.0)) + height / SPREAD
        hh = min(follows, hh) + own * own
    return error._replace(hh=hh, vv=vv)


@in_kernel
def with_doubt(error: CarriedError, velocity: float) -> CarriedError:
    """The error where the velocity [m/s] may differ by so much more, in another direction each time."""
    v = velocity / SPREAD
    return error._replace(vv=error.vv + v * v)


@in_kernel
def bounded(error: CarriedError) -> CarriedError:
    """The error, but no larger than the largest, whatever it has grown to."""
    h = abs(error.height) + math.sqrt(max(error.hh, 0.0))
    v = abs(error.velocity) + math.sqrt(max(error.vv, 0.0))
    if h <= LARGEST_HEIGHT_ERROR and v <= LARGEST_VELOCITY_ERROR:
        return error
    h = h if h < LARGEST_HEIGHT_ERROR else LARGEST_HEIGHT_ERROR
    v = v if v < LARGEST_VELOCITY_ERROR else LARGEST_VELOCITY_ERROR
    return CarriedError(height=0.0, velocity=0.0, hh=h * h, hv=0.0, vv=v * v)


@in_kernel
def with_push(
    error: CarriedError, push: float, stiffness: float, damping: float, mass: float, h: float
) -> CarriedError:
    """The error where a force [N] of any sign that nobody has told of has acted for `h` [s]."""
    height, velocity = pushed_by(push, stiffness, damping, mass, h)
    return with_bound(error, height, velocity)


@in_kernel
def pushed_by(push: float, stiffness: float, damping: float, mass: float, h: float) -> tuple[float, float]:
    """How far [m] and how fast [m/s] a force [N] pushes a contact in `h` [s]."""
    held = holding(stiffness, damping, mass)
    velocity = push / mass * min(h, 1.0 / held)
    return velocity * min(h, mass * held / max(stiffness, TINY)), velocity


@in_kernel
def holding(stiffness: float, damping: float, mass: float) -> float:
    """Rate [1/s] by which a contact holds a velocity's error back: that over it becomes one of the height."""
    return max(math.sqrt(max(stiffness, 0.0) / mass), damping / mass, 1.0 / HORIZON)


@in_kernel
def reach(error: CarriedError, held: float) -> float:
    """By how much [m] the height may be wrong: what is published.

    In a contact that holds velocities at a rate `held` [1/s] both errors turn into each other, at a phase that is not
    well known; in flight (infinite) a velocity's does nothing to the height until later.
    """
    swing = error.velocity / held
    expected = math.sqrt(error.height * error.height + swing * swing)
    found = EXPECTED * expected + SPREAD * math.sqrt(max(error.hh + error.vv / (held * held), 0.0))
    return found if found < LARGEST_HEIGHT_ERROR else LARGEST_HEIGHT_ERROR


@in_kernel
def velocity_reach(error: CarriedError) -> float:
    """How far the velocity [m/s] may be off."""
    found = EXPECTED * abs(error.velocity) + SPREAD * math.sqrt(max(error.vv, 0.0))
    return found if found < LARGEST_VELOCITY_ERROR else LARGEST_VELOCITY_ERROR


@in_kernel
def force_reach(error: CarriedError, stiffness: float, damping: float, left_out: float, held: float) -> float:
    """By how much [N] a force may be wrong that has these slopes over height [N/m] and velocity [N s/m]; see `reach`.

    `left_out` [N] is what it has left out besides.
    """
    expected = left_out + stiffness * error.height + damping * error.velocity
    swing = stiffness * error.velocity / held
    variance = stiffness * stiffness * error.hh + 2.0 * stiffness * damping * error.hv
    variance += (damping * damping + stiffness * stiffness / (held * held)) * error.vv
    return EXPECTED * math.sqrt(expected * expected + swing * swing) + SPREAD * math.sqrt(max(variance, 0.0))


@in_kernel
def carry_in_flight(error: CarriedError, h: float) -> CarriedError:
    """Carry an error through a flight of `h` [s]."""
    return turned(error, 1.0, h, 0.0, 1.0)


@in_kernel
def either(error: CarriedError, other: CarriedError) -> CarriedError:
    """An error that may as well be another one."""
    spread_height = math.sqrt(max(other.hh, 0.0)) - math.sqrt(max(error.hh, 0.0))
    spread_velocity = math.sqrt(max(other.vv, 0.0)) - math.sqrt(max(error.vv, 0.0))
    height = abs(other.height - error.height) + SPREAD * max(spread_height, 0.0)
    velocity = abs(other.velocity - error.velocity) + SPREAD * max(spread_velocity, 0.0)
    return with_bound(error, height, velocity)


@in_kernel
def curved(error: CarriedError, depth: float, stiffness: float, damping: float, mass: float, h: float) -> CarriedError:
    """The error after a step of `h` [s] in a contact whose slope changes with the depth [m]."""
    if meets_straight(error, depth):
        return error
    wrong = reach(error, math.inf)
    push = CURVATURE * stiffness * wrong * min(1.0, wrong / max(depth, TINY))
    height, velocity = pushed_by(push, stiffness, damping, mass, h)
    return with_bound_aside(error, height, velocity)


@always_inlined
def meets_straight(error: CarriedError, depth: float) -> bool:
    """Whether an error is so small against the depth [m] that the contact is straight to it."""
    return error.height * error.height + error.hh <= BENT * BENT * depth * depth


@in_kernel
def decay_rate(stiffness: float, damping: float, mass: float) -> float:
    """Rate [1/s] at which the linearised contact forgets an error: real part of its slower eigenvalue."""
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    return half_rate if discriminant <= 0.0 else max(stiffness, 0.0) / mass / (half_rate + math.sqrt(discriminant))


@in_kernel
def spectral_radius(stiffness: float, damping: float, mass: float) -> float:
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
    load, load_rate = load / step.cosine, load_rate / step.cosine
    before, after = swing(begin, load, load_rate, mass), swing(end, load + load_rate * h, load_rate, mass)
    return max(0.0, before * math.exp(-half_rate * h) - after)


@in_kernel
def lost_creep(step: Step, load: float, mass: float, h: float) -> float:
    """Way [m] that a dashpot lets the femur go, in a small part of a step of `h` [s], until it creeps under its load.

    A kick or a landing that begins the step is over before its stages look. `load` [N] is that at the beginning.
    """
    damping = step.damping
    if damping * h < FAST_SWING * mass or damping * damping < 4.0 * step.stiffness * mass:
        return 0.0
    return KICKED * abs(step.cosine * step.begin.force - load) * mass / (damping * damping)


@in_kernel
def swing(stage: Stage, load: float, load_rate: float, mass: float) -> float:
    """Speed [m/s] of a contact's departure from carrying the load [N] quasi-statically."""
    excess = (stage.force - load) / math.sqrt(stage.stiffness * mass)
    rate = stage.rate - load_rate / stage.stiffness
    return math.sqrt(rate * rate + excess * excess)


@in_kernel
def saltation(error: CarriedError, rate: float, jump: float, off: float, mass: float, longest: float) -> CarriedError:
    """Error behind a boundary met at a `rate` [m/s] of the depth, where the force jumps [N].

    A femur that is too high meets it late, and misses the jump for that time (the saltation matrix of the event), but
    not for longer than `longest` [s]. Nor does the step end on the boundary itself, but `off` [m] beside it: by
    rounding, which counts where the contact is hard.
    """
    if jump == 0.0:
        return error
    slowest = max(abs(rate), (reach(error, math.inf) + abs(off)) / longest, TINY)
    late = math.copysign(jump / (mass * slowest), -jump * rate)
    return with_bound(turned(error, 1.0, 0.0, late, 1.0), 0.0, abs(off * late))


@in_kernel
def depth_error(error: StateError, stiffness: float, damping: float, mass: float) -> float:
    """Error of the depth [m] that an error of the state amounts to: the height's, and what the velocity's becomes."""
    becomes = error.velocity / holding(stiffness, damping, mass)
    return math.sqrt(error.height * error.height + becomes * becomes)
