"""The accumulated error of the steps, propagated through the linearised contact: its expected value and covariance.

Each step adds its estimated error to the expected error, and a part of it to the covariance, because the estimate is
itself uncertain; sizes are in the energy norm of the contact. Spring, dashpot, flight and events then map both in
closed form. Expected errors may cancel; variances never do. The constants are checked in random scenes against an
independent reference (`studies.honesty`).
"""

import math
import sys
from typing import NamedTuple

from .compiler import in_kernel, inlined

VELOCITY_HORIZON = 0.1
"""Time [s] for which a velocity error counts where neither spring nor dashpot limits it. Tuned; `studies.honesty
scenes` would notice: with a third of it 0.6 % more of the ticks are flagged."""
SAFETY_FACTOR = 2.25
"""Factor by which errors may exceed their estimates: of steps, as all are estimated too small, and of a swing whose
phase is lost; twice that for implicit steps, whose order is known less. Tuned; `studies.honesty scenes` would notice:
it is the safety margin."""
SPREAD_FACTOR = 3.0
"""Factor on the standard deviation in a published estimate: 99.7 % of a normal distribution"""
CROSS_CORRELATION = 0.1
"""Part of a step's estimated error that may be one of the height instead of the velocity, or the reverse, alike in all
steps. Tuned; `studies.honesty scenes` would notice: 0.9 % fewer of the ticks are flagged without it."""
LARGEST_ERROR = 1e7
"""Bound of any error of height [m] and velocity [m/s]"""
TINY = sys.float_info.min
"""Smallest divisor, instead of 0 where nothing presses"""
MAGNUS_LIMIT = 4.0
"""Square of the angle [rad] of an oscillation, or of rate times duration of a decay, up to which Magnus' series is
used. The series converges for angles below π."""
SERIES_LIMIT = 1.0
"""The same square up to which a power series is faster than functions, and exact where their difference is not"""
LINEAR_FRACTION = 1e-3
"""Part of the depth up to which the contact is linear for an error: at most as much of the error is left out"""
CURVATURE_FACTOR = 0.5
"""Force error by the nonlinearity of the contact law, over stiffness times error times the error's part of the depth.
Tuned; `studies.honesty scenes` would notice: 4 depths are wrong without it."""


class Error(NamedTuple):
    """Error of height and velocity of the femur: expected value and covariance."""

    height: float
    """Expected error of the height [m]"""
    velocity: float
    """Expected error of the velocity [m/s]"""
    hh: float
    """Variance of the height's error [m²]"""
    hv: float
    """Covariance of both errors [m²/s]"""
    vv: float
    """Variance of the velocity's error [m²/s²]"""


EXACT = Error(height=0.0, velocity=0.0, hh=0.0, hv=0.0, vv=0.0)


@in_kernel
def mapped(error: Error, a: float, b: float, c: float, d: float) -> Error:
    """Return the error under the linear map of e to a e + b ė and of ė to c e + d ė."""
    hh, hv, vv = error.hh, error.hv, error.vv
    return Error(
        height=a * error.height + b * error.velocity,
        velocity=c * error.height + d * error.velocity,
        hh=a * a * hh + 2.0 * a * b * hv + b * b * vv,
        hv=a * c * hh + (a * d + b * c) * hv + b * d * vv,
        vv=c * c * hh + 2.0 * c * d * hv + d * d * vv,
    )


@inlined
def propagated(
    error: Error, begin: float, middle: float, end: float, damping: float, mass: float, h: float
) -> Error:
    """Return the error after `h` [s] in which the stiffness changes, given at begin, middle and end [N/m].

    This is Magnus' series to 4th order (Blanes et al. 2009, doi:10.1016/j.physrep.2008.11.001), with half of the second
    term on each side of the first. It matters because an oscillation's period depends on its size, so an error of the
    size accumulates in the phase. Where the series would not converge, the exponential of the middle stiffness is used.
    """
    per_mass = 1.0 / mass
    spring, drag = (begin + 4.0 * middle + end) * (per_mass / 6.0), damping * per_mass
    grown = 1.0 + h * h * (end - begin) * (per_mass / 24.0)
    if h * h * max(spring, drag * drag) > MAGNUS_LIMIT or not 0.5 < grown < 2.0:
        spring, grown = middle / mass, 1.0
    # ë + drag ė + spring e = 0, solved by the 2 x 2 exponential
    half_rate = 0.5 * drag
    discriminant = half_rate * half_rate - spring
    square, decay = h * h * discriminant, math.exp(-half_rate * h)
    root = math.sqrt(abs(discriminant))
    if abs(square) <= SERIES_LIMIT:
        # Power series of cosh √x and of sinh √x / √x, in Horner's form from the innermost bracket outwards.
        even = 1.0 + square / 56.0 * (1.0 + square / 90.0 * (1.0 + square / 132.0))
        even = 1.0 + square / 2.0 * (1.0 + square / 12.0 * (1.0 + square / 30.0 * even))
        odd = 1.0 + square / 72.0 * (1.0 + square / 110.0 * (1.0 + square / 156.0))
        odd = 1.0 + square / 6.0 * (1.0 + square / 20.0 * (1.0 + square / 42.0 * odd))
        even, odd = decay * even, decay * h * odd
    elif discriminant > 0.0:
        slow, fast = math.exp((root - half_rate) * h), math.exp(-(root + half_rate) * h)
        even, odd = 0.5 * (slow + fast), 0.5 * (slow - fast) / root
    else:
        even, odd = decay * math.cos(root * h), decay * math.sin(root * h) / root
    a, b, c, d = even + half_rate * odd, odd, -spring * odd, even - half_rate * odd
    if grown == 1.0:
        return mapped(error, a, b, c, d)
    shrunk, across = 1.0 / grown, -drag * (grown - 1.0)
    left, right = a * grown + b * across, c * grown + d * across
    b, d = b * shrunk, d * shrunk
    return mapped(
        error, grown * left, grown * b, across * left + shrunk * right, across * b + shrunk * d
    )


@inlined
def beside_delay(error: Error, rate: float, acceleration: float, relaxation: float) -> float:
    """Return a bound of the error [m] that is no delay, for a depth with this rate [m/s] and a femur's acceleration.

    A femur that is late has the errors of height and velocity that its velocity and acceleration give it, however many
    flights and landings follow. Only what lies beside them, in the energy norm, changes the energy and the next flight.
    """
    swing = relaxation * rate
    size = math.sqrt(acceleration * acceleration + swing * swing)
    if size == 0.0:
        return height_bound(error, relaxation)
    a, v = acceleration / size, rate / size
    variance = a * a * error.hh + 2.0 * a * v * error.hv + v * v * error.vv
    expected = abs(a * error.height + v * error.velocity)
    return expected + SPREAD_FACTOR * math.sqrt(max(variance, 0.0))


@inlined
def with_step_error(
    error: Error, h: float, v: float, deviation: float, relaxation: float, beside: float
) -> Error:
    """Return the error after a step that adds its own estimated errors of height [m] and velocity [m/s].

    `deviation` is the standard deviation of their size over the estimate; `relaxation` [1/s] as in `height_bound`, and
    `beside` [m] as returned by `beside_delay`.
    """
    # The method knows how large its error is, but poorly in which direction of height and velocity it lies.
    swing, h_spread, v_spread = relaxation * h, deviation * h, deviation * v
    size = math.sqrt(swing * swing + v * v)
    added = 2.0 * CROSS_CORRELATION / SPREAD_FACTOR * size * relaxation * beside
    return Error(
        height=error.height + SAFETY_FACTOR * h,
        velocity=error.velocity + SAFETY_FACTOR * v,
        hh=error.hh + h_spread * h_spread + added / (relaxation * relaxation),
        hv=error.hv + h_spread * v_spread,
        vv=error.vv + v_spread * v_spread + added,
    )


@in_kernel
def with_bound(error: Error, height: float, velocity: float) -> Error:
    """Return the error with bounds of further errors of height [m] and velocity [m/s], of the same sign each time."""
    # Deviations add up, and not their squares: bounds of one kind may have the same sign in every step.
    h = math.sqrt(max(error.hh, 0.0)) + height / SPREAD_FACTOR
    v = math.sqrt(max(error.vv, 0.0)) + velocity / SPREAD_FACTOR
    return Error(error.height, error.velocity, h * h, error.hv, v * v)


@in_kernel
def with_independent_bound(error: Error, height: float, velocity: float) -> Error:
    """Return the error with bounds of further errors [m], [m/s] that are added to its uncorrelated parts.

    A femur that is late has large errors of height and velocity, which depend on each other. The further error belongs
    to the small part of each that does not depend on the other.
    """
    hh, hv, vv = max(error.hh, 0.0), error.hv, max(error.vv, 0.0)
    if velocity > 0.0:
        dependent = hv * hv / hh if hh > 0.0 else 0.0
        own = math.sqrt(max(vv - dependent, 0.0)) + velocity / SPREAD_FACTOR
        vv = min(dependent, vv) + own * own
    if height > 0.0:
        dependent = hv * hv / vv if vv > 0.0 else 0.0
        own = math.sqrt(max(hh - dependent, 0.0)) + height / SPREAD_FACTOR
        hh = min(dependent, hh) + own * own
    return Error(error.height, error.velocity, hh, hv, vv)


@in_kernel
def limited(error: Error) -> Error:
    """Return the error, limited to `LARGEST_ERROR`; NaN becomes that too."""
    h = abs(error.height) + math.sqrt(max(error.hh, 0.0))
    v = abs(error.velocity) + math.sqrt(max(error.vv, 0.0))
    if h <= LARGEST_ERROR and v <= LARGEST_ERROR:
        return error
    # Nothing is expected of it any more: all of it is spread.
    h, v = capped(h), capped(v)
    return Error(0.0, 0.0, h * h, 0.0, v * v)


@inlined
def capped(error: float) -> float:
    """Return an error, limited to `LARGEST_ERROR`; NaN, which is not below it, becomes that too."""
    return error if error < LARGEST_ERROR else LARGEST_ERROR


@in_kernel
def response(
    push: float, stiffness: float, damping: float, mass: float, h: float
) -> tuple[float, float]:
    """Return how far [m] and how fast [m/s] a force `push` [N] of either sign moves a contact in `h` [s]."""
    relaxation = relaxation_rate(stiffness, damping, mass)
    velocity = push / mass * min(h, 1.0 / relaxation)
    return velocity * min(h, mass * relaxation / max(stiffness, TINY)), velocity


@in_kernel
def relaxation_rate(stiffness: float, damping: float, mass: float) -> float:
    """Return the rate [1/s] at which a contact limits a velocity error, which divided by it becomes a height error."""
    return max(math.sqrt(max(stiffness, 0.0) / mass), damping / mass, 1.0 / VELOCITY_HORIZON)


@in_kernel
def height_bound(error: Error, relaxation: float) -> float:
    """Return the published error estimate [m] of the height.

    In a contact with a `relaxation_rate` [1/s], height and velocity errors turn into each other at a poorly known
    phase. In flight (`relaxation` infinite) a velocity error has not affected the height yet.
    """
    swing = error.velocity / relaxation
    expected = math.sqrt(error.height * error.height + swing * swing)
    variance = max(error.hh + error.vv / (relaxation * relaxation), 0.0)
    return capped(expected + SPREAD_FACTOR * math.sqrt(variance))


@in_kernel
def velocity_bound(error: Error) -> float:
    """Return the error estimate [m/s] of the velocity."""
    return capped(abs(error.velocity) + SPREAD_FACTOR * math.sqrt(max(error.vv, 0.0)))


@in_kernel
def force_bound(
    error: Error, stiffness: float, damping: float, left_out: float, relaxation: float
) -> float:
    """Return the error estimate [N] of a force with these slopes over height [N/m] and velocity [N s/m].

    `left_out` [N] is the part of the force that was neglected; `relaxation` as in `height_bound`.
    """
    expected = left_out + stiffness * error.height + damping * error.velocity
    swing = stiffness * error.velocity / relaxation
    variance = stiffness * stiffness * error.hh + 2.0 * stiffness * damping * error.hv
    variance += (damping * damping + stiffness * stiffness / (relaxation * relaxation)) * error.vv
    size = math.sqrt(expected * expected + swing * swing)
    return size + SPREAD_FACTOR * math.sqrt(max(variance, 0.0))


@in_kernel
def with_curvature(
    error: Error,
    beside: float,
    depth: float,
    stiffness: float,
    damping: float,
    growth: float,
    mass: float,
    h: float,
) -> Error:
    """Return the error with the effect over `h` [s] of a contact whose slopes change with the depth [m].

    `beside` [m] is as returned by `beside_delay`, as a delay stays one. The damping goes with the depth to the power
    `growth`: an error e of the depth x changes it by the part growth e/x, and the error's rate is e k/c where it
    creeps, and e √(k/m) where it swings.
    """
    if error.height * error.height + error.hh <= LINEAR_FRACTION * LINEAR_FRACTION * depth * depth:
        return error
    wrong = height_bound(error, math.inf)
    slope = CURVATURE_FACTOR * stiffness
    if growth > 0.0:
        swing = damping * math.sqrt(max(stiffness, 0.0) / mass)
        slope = max(slope, growth * min(stiffness, swing))
    push = slope * min(wrong, beside) * min(1.0, wrong / max(depth, TINY))
    height, velocity = response(push, stiffness, damping, mass, h)
    return with_independent_bound(error, height, velocity)


@in_kernel
def eigenvalues(stiffness: float, damping: float, mass: float) -> tuple[float, float]:
    """Return the decay rate and the spectral radius [1/s] of the linearised contact.

    They are the real part of its slower eigenvalue, without sign, and the modulus of its faster one.
    """
    half_rate = 0.5 * damping / mass
    discriminant = half_rate * half_rate - stiffness / mass
    if discriminant <= 0.0:
        return half_rate, math.sqrt(stiffness / mass)
    # The slower eigenvalue by the product of both, as their difference would cancel for a strong dashpot.
    radius = half_rate + math.sqrt(discriminant)
    return max(stiffness, 0.0) / mass / radius, radius


@in_kernel
def saltation(
    error: Error, rate: float, jump: float, off: float, mass: float, longest: float
) -> Error:
    """Return the error after a boundary that is met at a `rate` [m/s] of the depth, where the force jumps [N].

    A femur that is too high meets the boundary late, and misses the jump for that time (the saltation matrix of the
    event), but at most for `longest` [s]. Because of rounding the step ends `off` [m] from the boundary, which matters
    in a hard contact.
    """
    if jump == 0.0:
        return error
    # A boundary that is only grazed could be met at any time: the delay is limited to the interval.
    slowest = max(abs(rate), (height_bound(error, math.inf) + abs(off)) / longest, TINY)
    late = math.copysign(jump / (mass * slowest), -jump * rate)
    return with_independent_bound(mapped(error, 1.0, 0.0, late, 1.0), 0.0, abs(off * late))
