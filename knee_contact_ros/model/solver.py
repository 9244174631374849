"""One tick of forward dynamics, from top to bottom: M ÿ = -L(t) + n_y F(δ, δ̇) (Eq. 13), with error control and events.

Between two samples load and flexion angle are linear in time, and the height y of the femur is the only free
coordinate. `advance` integrates it over that interval. The contact is in one mode at a time: apart; pressing in one
layer of the law; or released, where the surfaces overlap but the layer's formula would pull (cartilage cannot). A
pressing contact takes explicit Runge-Kutta steps if it is not stiff for the step, and implicit ones otherwise. In the
other modes the femur flies, which is solved exactly. A step that crosses a boundary of its mode is shortened to end on
it, and the next mode continues from there, so no step crosses a kink or a jump of the force. The estimated error is
propagated too (`error_estimate.py`).

The constants are checked in random scenes against an independent reference (`studies.honesty`).
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from knee_contact_ros.model.closest import Surfaces, next_kink, touch
from knee_contact_ros.model.compiler import in_kernel, inlined
from knee_contact_ros.model.error_estimate import (
    HORIZON,
    SPREAD,
    TINY,
    UNKNOWN,
    UNKNOWN_IMPLICIT,
    Error,
    bounded,
    curved,
    eigenvalues,
    force_reach,
    holding,
    mapped,
    over_step,
    pushed_by,
    reach,
    saltation,
    velocity_reach,
    with_bound,
    with_step,
    with_uncorrelated_bound,
)
from knee_contact_ros.model.laws import APART, BEGIN, DAMPING, force_at, layer_at
from knee_contact_ros.model.types import Floats

NOWHERE, ABOVE, FORCE, BELOW = -1, 0, 1, 2
"""Boundaries of a mode: none, the beginning of the layer, the change between pressing and released, the layer's end"""
DEPTH_ROUNDING, FORCE_ROUNDING = 1e-13, 1e-10
"""How far a boundary must be crossed to exceed rounding: depth [m]; force relative to the load (or to 1 N)"""
ON_BOUNDARY = 0.01
"""Distance from a boundary at which a step ends on it, as a fraction of that rounding"""
KINK_WIDTH = 2e-12
"""Margin of the flexion angle [rad] on both sides of a kink: more than the rounding of its place"""
LOCAL_SHARE = 0.1
"""Share of the tolerance that the errors of all steps together may use while the contact remembers them."""
FORGETTING, RADIANS = 30.0, 2e4
"""Time [s] for which an error counts where nothing damps it, and largest phase of an oscillation [rad] for which it
does, so that a ringing knee is known for a minute or more"""
ROUNDING = 4.0 * sys.float_info.epsilon
"""Relative error of a height or velocity below which it is rounding, which no smaller step can cure."""
NEWTON_SHARE, DEPTH_SHARE, LEAST_CORRECTION = 0.01, 1e-4, 1e-16
"""Newton's method has converged at this share of the tolerance, of the depth, and at this correction [m] at least"""
MAX_NEWTON = 30
RELEASE = 8.0
"""A falling force or layer counts as about to end if it will within this number of steps"""
REBOUND = 2.0
"""Contact force, as a multiple of the load, above which the femur is expected to rebound into the air"""
THROWN = 64.0
"""Factor by which the tolerance is stricter for steps whose errors go into a flight, where they grow"""
FOLLOWED = 0.02
"""Largest error of an undamped oscillation, relative to it"""
EXPLICIT = 1.0
"""Largest step times spectral radius of the contact that is taken explicitly"""
MOST_EXPLICIT = 6.0
"""Number of explicit steps that cost less than an implicit step with its halves"""
SINGULAR = 10.0
"""Factor on the explicit estimate where a layer begins: the force is the 1.5th power of the way from there, and both
orders fail alike. For t^1.5 they are 8.2e-4 and 9.0e-4 off, so that their difference is a tenth of the error"""
NEAR_KNOT = 0.2
"""The same factor applies if a step turns the femur by more than this fraction of the turn between two knots"""
STIFF = 100.0
"""h² k/m + h c/m above which only the stage order is left of the implicit method's order"""
LARGEST_RADIUS = 0.2
"""Largest radius of curvature [m] of femur and tibia together over which a contact glides; else it has leapt."""
FAST_SWING = 5.0
"""Angle [rad] of the contact's oscillation in a step above which the implicit method damps it away."""
KICKED = 0.3
"""Error of a step that does not resolve a transient, as a part of the way of the transient"""
LOST_SWING = 1.75
"""Largest speed of an oscillation that a step has damped away, over its estimate, which takes springs as linear"""
RELEASED = 0.05
"""Unknown part of the velocity's error where a contact ends, as the end of an oscillation depends on its size"""
LAUNCH_ROUNDING = 2e-12
"""Error of a flight, as a part of its way, by the rounding of the event before it."""
AIRBORNE = 1.25
"""Safety factor on the published error of a flight, which comes from one velocity and not from many steps"""
LOOKS, MAX_LOOKS = 16, 4096
"""Smallest number of looks in a flight through overlapping surfaces, and largest number in all flights of a tick"""
GRAZE = 1e-5
"""Part of the tolerance by which a point may graze the other surface unseen between two looks at a flight"""
FINEST = 1e-6
"""Fraction of a flight through overlapping surfaces below which the time between two looks is not divided"""
MAX_LOCATE = 60
"""Largest number of attempts to end a step on a boundary"""
MAX_EVENTS = 1000
"""Number of crossed boundaries after which a tick is given up"""
STEP_COST = 18
"""Evaluations that must be left for another step"""

# Explicit method: Fehlberg 1969, NASA TR R-315, formula 2, orders 4 and 5; the 4th order is continued.
C2, C3, C4, C6 = 1 / 4, 3 / 8, 12 / 13, 1 / 2
A21, A31, A32 = 1 / 4, 3 / 32, 9 / 32
A41, A42, A43 = 1932 / 2197, -7200 / 2197, 7296 / 2197
A51, A52, A53, A54 = 439 / 216, -8.0, 3680 / 513, -845 / 4104
A61, A62, A63, A64, A65 = -8 / 27, 2.0, -3544 / 2565, 1859 / 4104, -11 / 40
B1, B3, B4, B5 = 25 / 216, 1408 / 2565, 2197 / 4104, -1 / 5
E1, E3, E4, E5, E6 = B1 - 16 / 135, B3 - 6656 / 12825, B4 - 28561 / 56430, B5 + 9 / 50, -2 / 55
EXPLICIT_ORDER = (C2, C3, C6, C4, 1.0)
# Implicit method: order 4, L-stable, stiffly accurate, stage order 2; Kennedy & Carpenter 2003,
# doi:10.1016/S0168-9274(02)00138-1, implicit half of ARK4(3)6L[2]SA.
G, D2, D3, D4, D5 = 1 / 4, 1 / 2, 83 / 250, 31 / 50, 17 / 20
G21, G31, G32 = 1 / 4, 8611 / 62500, -1743 / 31250
G41, G42, G43 = 5012029 / 34652500, -654441 / 2922500, 174375 / 388108
G51, G52 = 15267082809 / 155376265600, -71443401 / 120774400
G53, G54 = 730878875 / 902184768, 2285395 / 8070912
G61, G63, G64, G65 = 82889 / 524892, 15625 / 83664, 69875 / 102672, -2260 / 8211
IMPLICIT_ORDER = (D3, D2, D4, D5, 1.0)


class KneeConstants(NamedTuple):
    """A knee and the accuracy of its solution: the constants of a run in the kernel's form."""

    surfaces: Surfaces
    law: Floats
    """Rows of the contact law's layers; see `laws.Layer`"""
    mass: float
    """Mass of the femur [kg]"""
    per_mass: float
    """1 / mass [1/kg]"""
    tolerance: float
    """Tolerated error of the depth [m]"""
    force_tolerance: float
    """Tolerated error of the contact force [N]; 0: no limit"""
    budget: int
    """Largest number of contact law evaluations in a tick"""
    level: int
    """The equations that a tick solves; see `ticks.py`"""
    allow_tension: bool
    """Whether the law may pull; else its force is clamped at 0"""
    remembers: bool
    """Whether the law depends on the impact speed"""
    plausible_depth: float
    """Depth [m] beyond which an answer is `IMPLAUSIBLE`"""


class Interval(NamedTuple):
    """Load and flexion angle from one tick to the next, linear in the time s [s] since the first of the two."""

    duration: float
    """Length of the interval [s]"""
    angle: float
    """Flexion angle at s = 0 [rad]"""
    angle_rate: float
    """[rad/s]"""
    load: float
    """Compressive load at s = 0 [N]"""
    load_rate: float
    """[N/s]"""
    rounding: float
    """Contact force [N] that is taken as zero"""


class FemurState(NamedTuple):
    """State of a run: what one tick hands to the next."""

    height: float
    """Height of the femoral reference point [m]"""
    velocity: float
    """Its velocity [m/s]"""
    error: Error
    """Estimated error of both"""
    try_step: float
    """Duration [s] that the next step should try"""
    impact_speed: float
    """Penetration rate [m/s] at which the present contact began, 0 at rest; NaN while the surfaces are apart"""
    impact_error: float
    """Estimated error of the impact speed [m/s]"""


class Stage(NamedTuple):
    """The contact at one time."""

    depth: float
    """Signed depth [m]: < 0 apart"""
    rate: float
    """Rate of the depth [m/s]"""
    force: float
    """Force [N] of the layer's formula, not clamped; 0 apart"""
    stiffness: float
    """Slope of the force along the height over the height [N/m]"""
    damping: float
    """Slope of the force along the height over the velocity [N s/m]"""
    surface_rate: float
    """Rate of the depth [m/s] if the height were held"""
    cosine: float
    """n_y of the contact normal"""
    acceleration: float
    """Acceleration of the femur [m/s²] if the force is exerted"""


class Step(NamedTuple):
    """The end of a step in a pressing mode, its estimated local error and the first boundary that it has crossed."""

    height: float
    velocity: float
    height_error: float
    velocity_error: float
    end: Stage
    stiffness: float
    """As in `Stage`, in the middle of the step: it carries errors over the step at second order"""
    damping: float
    leapt: float
    """Change of the depth's rate [m/s] by a leap of the contact from one bump to another in the step; 0 if none"""
    boundary: int
    """The boundary that is crossed first, or `NOWHERE`"""
    fraction: float
    """Place of that crossing as a part of the step"""
    evaluations: int
    solved: bool
    """False if a stage's equation was not solved; the step must then be repeated with a smaller duration."""
    implicit: bool


class Result(NamedTuple):
    """The contact at the end of a tick."""

    femur: FemurState
    stage: Stage
    force: float
    """Exerted normal force [N]"""
    estimate: float
    """Estimated error of the depth [m]"""
    force_estimate: float
    """Estimated error of the force [N]"""
    evaluations: int
    converged: bool
    """False if the tick was given up: it needs more evaluations or events than it may take"""


@inlined
def stage_at(
    knee: KneeConstants, tick: Interval, layer: int, impact: float, s: float, y: float, v: float
) -> Stage:
    """Return the contact in a layer at s [s] for a height [m] and a velocity [m/s]; `impact` [m/s] is that of touch."""
    depth, surface_rate, cosine = touch(
        knee.surfaces, tick.angle + tick.angle_rate * s, tick.angle_rate, y
    )
    return stage_in(
        knee, tick, layer, impact, s, depth, surface_rate - cosine * v, surface_rate, cosine
    )


@inlined
def stage_in(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    s: float,
    depth: float,
    rate: float,
    surface_rate: float,
    cosine: float,
) -> Stage:
    """Return the contact in a layer at s [s] where the surfaces are known to lie: see the fields of `Stage`."""
    force, stiffness, damping = force_at(knee.law, layer, depth, rate, impact)
    acceleration = (cosine * force - tick.load - tick.load_rate * s) * knee.per_mass
    square = cosine * cosine
    return Stage(
        depth,
        rate,
        force,
        square * stiffness,
        square * damping,
        surface_rate,
        cosine,
        acceleration,
    )


@in_kernel
def inside_by(
    knee: KneeConstants, layer: int, pressing: bool, boundary: int, stage: Stage
) -> float:
    """Return the distance of a contact from a boundary of its mode, >= 0 inside: [m], or [N] for `FORCE`."""
    if boundary == ABOVE:
        return stage.depth - float(knee.law[layer, BEGIN])
    if boundary == BELOW:
        return float(knee.law[layer + 1, BEGIN]) - stage.depth
    return stage.force if pressing else -stage.force


@in_kernel
def crossed(
    knee: KneeConstants, tick: Interval, layer: int, pressing: bool, stage: Stage, known: int
) -> int:
    """Return the first boundary of a mode that a contact has crossed, except the `known` one; `NOWHERE` if inside."""
    if known != ABOVE and stage.depth < knee.law[layer, BEGIN] - DEPTH_ROUNDING:
        return ABOVE
    pull = -stage.force if pressing else stage.force
    if known != FORCE and pull > tick.rounding and not knee.allow_tension:
        return FORCE
    if known != BELOW and stage.depth > knee.law[layer + 1, BEGIN] + DEPTH_ROUNDING:
        return BELOW
    return NOWHERE


@in_kernel
def scan(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    known: int,
    h: float,
    begin: Stage,
    fractions: tuple[float, ...],
    stages: tuple[Stage, ...],
) -> tuple[int, float, float]:
    """Return the first boundary that the stages of a step of `h` [s] cross, where, and their largest leap [m/s].

    The stages are in the order of their `fractions` of the step. The `known` boundary is not reported at the end,
    because the step is meant to end there. A gliding contact changes its rate by the radius of curvature times the
    turn; beyond `LARGEST_RADIUS` it has leapt from bump to bump.
    """
    boundary, fraction, leapt, before, since = NOWHERE, 1.0, 0.0, begin.surface_rate, 0.0
    glides = LARGEST_RADIUS * tick.angle_rate * tick.angle_rate * h
    for i in range(5):
        stage, at = stages[i], fractions[i]
        if boundary == NOWHERE:
            boundary = crossed(knee, tick, layer, True, stage, known if at == 1.0 else NOWHERE)
            fraction = at
        if knee.surfaces.non_convex > 0.0:
            change = abs(stage.surface_rate - before)
            if change > glides * (at - since):
                leapt = max(leapt, change)
            before, since = stage.surface_rate, at
    return boundary, fraction, leapt


@inlined
def explicit_step(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    known: int,
    s: float,
    y: float,
    v: float,
    h: float,
    one: Stage,
) -> Step:
    """Take one step of Fehlberg's method of `h` [s] from s [s] on, from the contact `one`."""
    a1 = one.acceleration
    v2 = v + h * (A21 * a1)
    two = stage_at(knee, tick, layer, impact, s + C2 * h, y + h * (A21 * v), v2)
    a2 = two.acceleration
    v3 = v + h * (A31 * a1 + A32 * a2)
    three = stage_at(knee, tick, layer, impact, s + C3 * h, y + h * (A31 * v + A32 * v2), v3)
    a3 = three.acceleration
    v4 = v + h * (A41 * a1 + A42 * a2 + A43 * a3)
    four = stage_at(
        knee, tick, layer, impact, s + C4 * h, y + h * (A41 * v + A42 * v2 + A43 * v3), v4
    )
    a4 = four.acceleration
    v5 = v + h * (A51 * a1 + A52 * a2 + A53 * a3 + A54 * a4)
    high = y + h * (A51 * v + A52 * v2 + A53 * v3 + A54 * v4)
    a5 = stage_at(knee, tick, layer, impact, s + h, high, v5).acceleration
    v6 = v + h * (A61 * a1 + A62 * a2 + A63 * a3 + A64 * a4 + A65 * a5)
    high = y + h * (A61 * v + A62 * v2 + A63 * v3 + A64 * v4 + A65 * v5)
    six = stage_at(knee, tick, layer, impact, s + C6 * h, high, v6)
    height = y + h * (B1 * v + B3 * v3 + B4 * v4 + B5 * v5)
    velocity = v + h * (B1 * a1 + B3 * a3 + B4 * a4 + B5 * a5)
    end = stage_at(knee, tick, layer, impact, s + h, height, velocity)
    begins = abs(end.depth - one.depth) >= min(one.depth, end.depth) - float(
        knee.law[layer, BEGIN]
    )
    knots = abs(tick.angle_rate) * h > NEAR_KNOT * knee.surfaces.knot_spacing
    scale = h * SINGULAR if begins or knots else h
    least = min(two.depth, three.depth, four.depth, six.depth, end.depth)
    most = max(two.depth, three.depth, four.depth, six.depth, end.depth)
    weakest = min(two.force, three.force, four.force, six.force, end.force)
    boundary, fraction, leapt = NOWHERE, 1.0, 0.0
    room = min(
        least - float(knee.law[layer, BEGIN]), weakest, float(knee.law[layer + 1, BEGIN]) - most
    )
    if room < knee.surfaces.non_convex:  # which is 0 or 1: then there may be leaps
        stages = (two, three, six, four, end)
        boundary, fraction, leapt = scan(knee, tick, layer, known, h, one, EXPLICIT_ORDER, stages)
    return Step(
        height=height,
        velocity=velocity,
        height_error=scale * (E1 * v + E3 * v3 + E4 * v4 + E5 * v5 + E6 * v6),
        velocity_error=scale * (E1 * a1 + E3 * a3 + E4 * a4 + E5 * a5 + E6 * six.acceleration),
        end=end,
        stiffness=six.stiffness,
        damping=six.damping,
        leapt=leapt,
        boundary=boundary,
        fraction=fraction,
        evaluations=6,
        solved=True,
        implicit=False,
    )


@in_kernel
def solve_stage(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    s: float,
    height: float,
    velocity: float,
    diagonal: float,
    guess: float,
    most: int,
) -> tuple[float, Stage, int, bool, float]:
    """Solve an implicit stage at s [s] by Newton's method from the acceleration `guess` [m/s²].

    The height of the stage is `height` [m] plus `diagonal` [s] times its velocity, and the velocity is `velocity` [m/s]
    plus `diagonal` times its acceleration: one scalar equation in the velocity, whose left side grows with a slope of
    at least 1. A law is convex in the depth, so Newton's method finds the one solution from anywhere; on a curved tibia
    the normal turns with the height, which its slope leaves out. At most `most` evaluations are taken, but one at
    least. Returns velocity, contact, evaluations, whether it has converged, and the error [m] that it has left.
    """
    load, unknown, mass = tick.load + tick.load_rate * s, velocity + diagonal * guess, knee.mass
    most = max(1, min(most, MAX_NEWTON))
    evaluations, arrived = 0, False
    while True:
        stage = stage_at(knee, tick, layer, impact, s, height + diagonal * unknown, unknown)
        evaluations += 1
        # Where a formula pulls its slope may be negative; Newton's method is to go on downhill there, too.
        slope = diagonal * max(stage.stiffness, 0.0) + stage.damping
        residual = mass * (unknown - velocity) - diagonal * (stage.cosine * stage.force - load)
        correction = residual / (mass + diagonal * slope)
        unknown -= correction
        enough = max(
            min(NEWTON_SHARE * knee.tolerance, DEPTH_SHARE * stage.depth), LEAST_CORRECTION
        )
        arrived = abs(correction) * diagonal <= enough
        if arrived or evaluations >= most:
            break
    gain = stage.cosine * correction
    left = gain * diagonal * (gain * diagonal) / max(stage.depth, LEAST_CORRECTION)
    force, depth, rate = stage.force, stage.depth, stage.rate
    if arrived:  # all else follows the last correction along the tangent, at no further evaluation
        force += slope / stage.cosine * correction
        depth += diagonal * gain
        rate += gain
    acceleration = (stage.cosine * force - load) * knee.per_mass
    solved = Stage(
        depth,
        rate,
        force,
        stage.stiffness,
        stage.damping,
        stage.surface_rate,
        stage.cosine,
        acceleration,
    )
    return unknown, solved, evaluations, arrived, left


@in_kernel
def implicit_step(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    known: int,
    s: float,
    y: float,
    v: float,
    h: float,
    one: Stage,
    room: int,
) -> Step:
    """Take one ESDIRK step of `h` [s] from s [s] on, from the contact `one`, with `room` evaluations at most.

    The embedded solution is not used: in gait its estimate was a fifth of the true error. `doubled_step` estimates it.
    """
    d, a1 = h * G, one.acceleration
    high, fast = y + h * (G21 * v), v + h * (G21 * a1)
    v2, two, n2, ok2, e2 = solve_stage(
        knee, tick, layer, impact, s + D2 * h, high, fast, d, a1, room
    )
    a2 = two.acceleration
    high, fast = y + h * (G31 * v + G32 * v2), v + h * (G31 * a1 + G32 * a2)
    v3, three, n3, ok3, e3 = solve_stage(
        knee, tick, layer, impact, s + D3 * h, high, fast, d, a2, room - n2
    )
    a3, used = three.acceleration, n2 + n3
    high, fast = y + h * (G41 * v + G42 * v2 + G43 * v3), v + h * (G41 * a1 + G42 * a2 + G43 * a3)
    v4, four, n4, ok4, e4 = solve_stage(
        knee, tick, layer, impact, s + D4 * h, high, fast, d, a3, room - used
    )
    a4, used = four.acceleration, used + n4
    high = y + h * (G51 * v + G52 * v2 + G53 * v3 + G54 * v4)
    fast = v + h * (G51 * a1 + G52 * a2 + G53 * a3 + G54 * a4)
    v5, five, n5, ok5, e5 = solve_stage(
        knee, tick, layer, impact, s + D5 * h, high, fast, d, a4, room - used
    )
    a5, used = five.acceleration, used + n5
    high = y + h * (G61 * v + G63 * v3 + G64 * v4 + G65 * v5)
    fast = v + h * (G61 * a1 + G63 * a3 + G64 * a4 + G65 * a5)
    v6, end, n6, ok6, e6 = solve_stage(
        knee, tick, layer, impact, s + h, high, fast, d, a5, room - used
    )
    stages = (three, two, four, five, end)
    boundary, fraction, leapt = scan(knee, tick, layer, known, h, one, IMPLICIT_ORDER, stages)
    return Step(
        height=high + d * v6,
        velocity=v6,
        height_error=e2 + e3 + e4 + e5 + e6,
        velocity_error=0.0,
        end=end,
        stiffness=end.stiffness,
        damping=end.damping,
        leapt=leapt,
        boundary=boundary,
        fraction=fraction,
        evaluations=used + n6,
        solved=ok2 and ok3 and ok4 and ok5 and ok6,
        implicit=True,
    )


@in_kernel
def doubled_step(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    known: int,
    s: float,
    y: float,
    v: float,
    h: float,
    one: Stage,
    room: int,
) -> Step:
    """Take two ESDIRK steps of h/2 [s], with an error estimate from their difference to one whole step.

    Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 (Richardson's estimate),
    of the solution that is continued. In a contact that is stiff against the step only the stage order is left
    (Prothero & Robinson; Hairer & Wanner II, section IV.15). The third derivative of a spline jumps at its points, and
    the first one over a dent: steps across lose their order.
    """
    whole = implicit_step(knee, tick, layer, impact, known, s, y, v, h, one, room)
    used = whole.evaluations
    first = implicit_step(knee, tick, layer, impact, NOWHERE, s, y, v, 0.5 * h, one, room - used)
    middle = stage_at(knee, tick, layer, impact, s + 0.5 * h, first.height, first.velocity)
    used += first.evaluations + 1
    second = implicit_step(
        knee,
        tick,
        layer,
        impact,
        known,
        s + 0.5 * h,
        first.height,
        first.velocity,
        0.5 * h,
        middle,
        room - used,
    )
    stiff = h * (h * first.stiffness + first.damping) > STIFF * knee.mass
    gain = 3.0 if stiff or knee.surfaces.non_convex > 0.0 else 15.0
    if abs(tick.angle_rate) * h > knee.surfaces.knot_spacing:
        gain = 1.0
    boundary, fraction = second.boundary, 0.5 + 0.5 * second.fraction
    if first.boundary != NOWHERE:
        boundary, fraction = first.boundary, 0.5 * first.fraction
    compared = (second.height - whole.height) / gain
    return Step(
        height=second.height,
        velocity=second.velocity,
        height_error=compared + math.copysign(first.height_error + second.height_error, compared),
        velocity_error=(second.velocity - whole.velocity) / gain,
        end=second.end,
        stiffness=first.stiffness,
        damping=first.damping,
        leapt=max(first.leapt, second.leapt),
        boundary=boundary,
        fraction=fraction,
        evaluations=used + second.evaluations,
        solved=whole.solved and first.solved and second.solved,
        implicit=True,
    )


@inlined
def flown(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    s: float,
    y: float,
    v: float,
    h: float,
) -> Step:
    """Return a flight of `h` [s] from s [s] on, which is exact."""
    load = tick.load + tick.load_rate * s
    height = y + h * (v - h * (0.5 * load + tick.load_rate * h / 6.0) / knee.mass)
    velocity = v - h * (load + 0.5 * tick.load_rate * h) / knee.mass
    end = stage_at(knee, tick, layer, impact, s + h, height, velocity)
    rounding = LAUNCH_ROUNDING * abs(height - y)
    return Step(height, velocity, rounding, 0.0, end, 0.0, 0.0, 0.0, NOWHERE, 1.0, 1, True, False)


@in_kernel
def attempt(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    pressing: bool,
    impact: float,
    known: int,
    s: float,
    y: float,
    v: float,
    h: float,
    one: Stage,
    radius: float,
    room: int,
) -> Step:
    """Compute one step of `h` [s] from the contact `one`, by the method that fits, without error control.

    `known` is the boundary that it is to end on, or `NOWHERE`; `radius` [1/s] is the contact's spectral radius; `room`
    limits the evaluations of an implicit step.
    """
    if not pressing:
        return flown(knee, tick, layer, impact, s, y, v, h)
    if radius * h <= EXPLICIT:
        return explicit_step(knee, tick, layer, impact, known, s, y, v, h, one)
    return doubled_step(knee, tick, layer, impact, known, s, y, v, h, one, room - STEP_COST)


@inlined
def error_ratio(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    s: float,
    begin: Stage,
    step: Step,
    h: float,
    landed: bool,
) -> float:
    """Return the estimated error of a step over its share of the tolerance, which all steps that still count share.

    `landed`: whether the contact began with the end of a flight.
    """
    if not step.solved:
        return math.inf
    mass, k, c, load = knee.mass, step.stiffness, step.damping, tick.load + tick.load_rate * s
    force, begin_force = step.end.force, begin.force
    speed = abs(step.velocity) + h * abs(force) / mass
    height_error = max(abs(step.height_error) - ROUNDING * abs(step.height), 0.0)
    velocity_error = max(abs(step.velocity_error) - ROUNDING * speed, 0.0)
    # A leap happens once: its error is not one of many that add up while the contact remembers them.
    (decay, _), held = eigenvalues(k, c, mass), holding(k, c, mass)
    forgotten = (
        1.0 if step.leapt > 0.0 else min(1.0, h * max(decay, held / RADIANS, 1.0 / FORGETTING))
    )
    swing = velocity_error / held
    whole = math.sqrt(height_error * height_error + swing * swing) / forgotten + h * step.leapt
    left = step.end.depth - float(knee.law[layer, BEGIN])
    ends = (
        left < RELEASE * (begin.depth - step.end.depth)
        and knee.law[layer, DAMPING] > knee.law[layer - 1, DAMPING]
    )
    if ends or force < RELEASE * (begin_force - force) or force > REBOUND * load:
        # The error of the velocity is carried into a flight, or into a layer that damps it less.
        flown = velocity_error / (1.0 / HORIZON)
        whole = max(whole, THROWN * math.sqrt(height_error * height_error + flown * flown))
    wanted = knee.tolerance
    if knee.force_tolerance > 0.0:
        # A creeping contact turns a depth into a rate by k/c, one that swings by the root of k/m.
        slope = k + c * k / (mass * held)
        wanted = min(wanted, knee.force_tolerance / max(slope, TINY))
    allowed, lasts = wanted, decay * HORIZON < 1.0
    if lasts and k > 0.0:
        # An undamped oscillation can be followed only as long as its error is small against its amplitude.
        swing = max(abs(begin_force), abs(force)) / k
        rate = step.end.rate / begin.cosine
        allowed = min(allowed, FOLLOWED * math.sqrt(swing * swing + rate * rate * mass / k))
    if landed and (lasts or len(knee.law) > 3) and not knee.allow_tension:
        allowed /= (
            THROWN  # it goes into the next flight; another layer may damp less than this one
        )
    ratio = whole / (LOCAL_SHARE * allowed)
    if step.implicit:
        crept, swung = unresolved(tick, begin, step, load, mass, h)
        swung /= held
        ratio += math.sqrt(crept * crept + swung * swung) / (LOCAL_SHARE * wanted)
    return ratio if ratio < math.inf else math.inf


@in_kernel
def unresolved(
    tick: Interval, begin: Stage, step: Step, load: float, mass: float, h: float
) -> tuple[float, float]:
    """Return the way [m] and the speed [m/s] of motion in an implicit step that its halves do not see either.

    The way is that of a transient that is over in a small part of the step, when the femur creeps: a kick or a landing
    at its beginning has decayed before its stages. The speed is that of an oscillation by several radians within the
    step about the quasi-static contact: an L-stable method damps it at once, although the contact does not; the
    contact's own damping accounts for a part of the loss. `load` [N] is that at the beginning.
    """
    k, c, cosine, end = step.stiffness, step.damping, begin.cosine, step.end
    crept, swung = 0.0, 0.0
    if c * h >= FAST_SWING * mass and c * c >= 4.0 * k * mass:
        crept = KICKED * abs(cosine * begin.force - load) * mass / (c * c)
    half_rate, square = 0.5 * c / mass, k / mass
    if square * h * h >= FAST_SWING * FAST_SWING and half_rate * half_rate < square:
        begin_k, end_k = (
            begin.stiffness / (cosine * cosine),
            end.stiffness / (end.cosine * end.cosine),
        )
        if min(begin_k, end_k) < 0.25 * k:  # as at first touch: all of the work may swing
            swung = math.sqrt(
                2.0 * abs((end.force - begin.force) * (end.depth - begin.depth)) / mass
            )
        else:
            # The end lies on the quasi-static contact: what the beginning lies beside it is lost, too.
            pull, pull_rate = load / cosine, tick.load_rate / cosine
            excess, rate = (
                (begin.force - pull) / math.sqrt(begin_k * mass),
                begin.rate - pull_rate / begin_k,
            )
            before, fade = math.sqrt(rate * rate + excess * excess), math.exp(-half_rate * h)
            end_excess = (end.force - pull - pull_rate * h) / math.sqrt(end_k * mass)
            end_rate = end.rate - pull_rate / end_k
            after = math.sqrt(end_rate * end_rate + end_excess * end_excess)
            excess, rate = excess - end_excess, rate - end_rate
            swung = max(before * fade - after, math.sqrt(rate * rate + excess * excess) * fade)
    return crept, swung


@in_kernel
def end_on_boundary(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    pressing: bool,
    impact: float,
    s: float,
    y: float,
    v: float,
    low: float,
    high: float,
    one: Stage,
    before: Stage,
    boundary: int,
    room: int,
) -> tuple[Step, float, int, int]:
    """Find the step between durations `low` and `high` [s] that ends on a boundary which it crosses (Illinois).

    `before` is the contact after `low`. Returns the step, its duration, the boundary and the evaluations; or a shorter
    step and `NOWHERE` where its end does not confirm the crossing that a stage has shown; or a duration of 0 where it
    goes straight across.
    """
    enough, radius = tick.rounding if boundary == FORCE else DEPTH_ROUNDING, 0.0
    if pressing:
        _, radius = eigenvalues(one.stiffness, one.damping, knee.mass)
    inside, last, beyond, used = inside_by(knee, layer, pressing, boundary, before), 0.0, 0.0, 0
    h, shrinking, step = (
        high,
        0,
        attempt(knee, tick, layer, pressing, impact, boundary, s, y, v, high, one, radius, room),
    )
    for tried in range(MAX_LOCATE):
        used += step.evaluations
        if used + STEP_COST >= room:
            break
        value = inside_by(knee, layer, pressing, boundary, step.end)
        if tried == 0:
            if value >= 0.0:
                return step, h, NOWHERE, used
            beyond = value
            if pressing and inside <= enough:
                shrinking = 3
            inside = max(inside, 0.0)
        elif shrinking > 0:
            # The step begins on this boundary: unless a far smaller one leads inside first, it goes straight across.
            if value > enough:
                return step, h, NOWHERE, used
            shrinking -= 1
            if shrinking == 0:
                return step, 0.0, boundary, used
        else:
            if abs(value) <= ON_BOUNDARY * enough:
                break
            again = value * last > 0.0  # the other end has been kept twice: count it half
            if value < 0.0:
                high, beyond = h, value
                if again:
                    inside *= 0.5
            else:
                low, inside = h, value
                if again:
                    beyond *= 0.5
            last = value
        following = 0.1 * h
        if shrinking == 0:
            following = low + (high - low) * inside / (inside - beyond)
            if not low < following < high:  # it lies on the boundary at one end
                following = 0.5 * (low + high)
            if not low < following < high:
                break
        h = following
        step = attempt(
            knee, tick, layer, pressing, impact, boundary, s, y, v, h, one, radius, room - used
        )
    return step, h, boundary, used


@in_kernel
def fly(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    s: float,
    y: float,
    v: float,
    h: float,
    begin: Stage,
    most: int,
) -> tuple[float, float, Stage, int, int]:
    """Look along a flight of `h` [s] from s [s] on for the first boundary that it meets, at most `most` times.

    Apart, no touch is missed: the signed depth is that of the deepest femoral point, and between two looks, dt apart,
    the depth of no point rises above the chord between those of the deepest ones by more than bend x(1 - x) dt²/2,
    where bend [m/s²] bounds how fast its penetration rate can fall: by the turning femur, the translation, a load that
    pulls, and a concave tibia. Where chord and bulge stay below 0 there is no touch; else dt is halved. In overlapping
    surfaces that are released dt is halved where depth or force has an extreme between two looks, or the contact leaps.

    Returns two times [s] between which the boundary is met, the contact at the first one, the boundary (`NOWHERE`: the
    flight goes on to `h`) and the looks.
    """
    turn, surfaces = abs(tick.angle_rate), knee.surfaces
    first, last = tick.load + tick.load_rate * s, tick.load + tick.load_rate * (s + h)
    speed = abs(v) + max(abs(first), abs(last)) * h / knee.mass
    speed += turn * (surfaces.largest_radius + surfaces.largest_slope)
    bend = (
        turn * turn * (surfaces.largest_radius + surfaces.largest_bend)
        + max(-first, -last, 0.0) / knee.mass
    )
    bend += 2.0 * surfaces.concave * speed * speed
    longest, shortest, graze = h, 0.0, max(GRAZE * knee.tolerance, DEPTH_ROUNDING)
    if layer > APART:
        longest, shortest = h / LOOKS, h * FINEST
        if surfaces.non_convex > 0.0:
            longest = min(longest, NEAR_KNOT * surfaces.knot_spacing / max(turn, TINY))
    t, dt, looks, low = 0.0, longest, 0, begin
    while t < h and looks < most:
        there = min(t + dt, h)
        dt = there - t
        look = flown(knee, tick, layer, impact, s, y, v, there).end
        looks += 1
        boundary = crossed(knee, tick, layer, False, look, NOWHERE)
        finest = dt <= shortest or not t + 0.5 * dt > t
        if layer > APART:
            # The rate of the force follows from that of the depth and from its acceleration, which the load changes.
            pull, bent = (look.rate - low.rate) / dt, 0.5 * dt * tick.load_rate * knee.per_mass
            rising = low.stiffness * low.rate + low.damping * (pull - bent)
            change = rising * (look.stiffness * look.rate + look.damping * (pull + bent))
            safe = finest or min(low.rate * look.rate, change) >= 0.0
            if boundary == ABOVE and 2.0 * low.force * low.rate < rising * (
                low.depth - float(knee.law[layer, BEGIN])
            ):
                safe = finest  # it presses before the layer ends, where its force is 0 again
            if (
                surfaces.non_convex > 0.0
            ):  # right after a leap the next bump presses, maybe only for a moment
                leapt = (
                    abs(look.surface_rate - low.surface_rate) > LARGEST_RADIUS * turn * turn * dt
                )
                safe = finest or (safe and not leapt)
            if boundary != NOWHERE:  # the flight may begin on the boundary, and leave it first
                safe = finest or (safe and inside_by(knee, layer, False, boundary, low) > 0.0)
        else:
            bulge, gap, next_gap = 0.5 * bend * dt * dt, -low.depth, -look.depth
            least, small = min(gap, next_gap), bulge <= graze
            if bulge > abs(next_gap - gap):  # the parabola's lowest place lies between the two
                lowest = bulge + gap - next_gap
                least = gap - lowest * lowest / (4.0 * bulge)
            safe = finest or small or least >= -graze
            if boundary != NOWHERE:  # the flight may begin on the surface, and leave it first
                safe = finest or (
                    (small or low.rate >= bend * dt) and (gap > 0.0 or low.rate >= 0.0)
                )
        if safe and boundary != NOWHERE:
            return t, there, low, boundary, looks
        if safe:
            t, low, dt = there, look, min(2.0 * dt, longest)
        else:
            dt *= 0.5
    return t, h, low, NOWHERE, looks


@in_kernel
def lateness(tick: Interval, error: Error, s: float, rate: float, mass: float) -> float:
    """Return the time [s] by which the exact femur may touch later than this one, which touches at a `rate` [m/s]."""
    gap = reach(error, math.inf)
    load = min(tick.load + tick.load_rate * s, tick.load + tick.load_rate * tick.duration)
    late = gap / max(abs(rate), TINY)
    if load > 0.0:
        late = min(late, math.sqrt(2.0 * gap * mass / load))
    if load >= 0.0 and tick.load_rate > 0.0:
        late = min(late, (6.0 * gap * mass / tick.load_rate) ** (1.0 / 3.0))
    return late


@in_kernel
def impact_doubt(
    knee: KneeConstants, layer: int, stage: Stage, impact: float, impact_error: float
) -> float:
    """Return the change of a force [N] if its contact began faster or slower by an error [m/s]."""
    faster, _, _ = force_at(knee.law, layer, stage.depth, stage.rate, impact + impact_error)
    slower, _, _ = force_at(
        knee.law, layer, stage.depth, stage.rate, max(0.0, impact - impact_error)
    )
    return max(abs(faster - stage.force), abs(slower - stage.force))


@in_kernel
def stretch_from(knee: KneeConstants, tick: Interval, begin: float) -> tuple[float, float]:
    """Return the end [s] of the smooth stretch that begins at `begin` [s], and the beginning [s] of the next one.

    Between the two, the rate of the femoral surface jumps. At a kink of the femoral profile one stretch ends shortly
    before it and the next begins shortly behind, so that rounding cannot put either on the wrong side. The last stretch
    ends with the interval, and so does its next.
    """
    end_angle = tick.angle + tick.angle_rate * tick.duration
    kink = next_kink(knee.surfaces, tick.angle + tick.angle_rate * begin, end_angle)
    while not math.isnan(kink):
        margin = KINK_WIDTH / abs(tick.angle_rate)
        s = (kink - tick.angle) / tick.angle_rate
        if begin < s - margin and s + margin < tick.duration:
            return s - margin, s + margin
        kink = next_kink(knee.surfaces, kink, end_angle)
    return tick.duration, tick.duration


@inlined
def pressed_step(
    knee: KneeConstants,
    tick: Interval,
    layer: int,
    impact: float,
    s: float,
    y: float,
    v: float,
    begin: Stage,
    until: float,
    try_step: float,
    landed: bool,
    room: int,
) -> tuple[Step, float, int, float, int, bool, float]:
    """Find a step towards `until` [s] whose error fits, and end it on the boundary that it crosses, if any.

    Of many explicit tries across a knot of a spline the first one fits whose estimate is small by chance: after a
    failure estimates count `SINGULAR` times. Returns the step, its duration [s], the boundary, the duration that the
    next step should try, the evaluations, whether the tick must be given up, and the factor on the step's estimate.
    """
    remaining, (_, radius) = until - s, eigenvalues(begin.stiffness, begin.damping, knee.mass)
    h, used, boundary, rough = min(try_step, remaining), 0, NOWHERE, 1.0
    if radius * h > EXPLICIT and radius * remaining <= MOST_EXPLICIT * EXPLICIT:
        h = remaining / math.ceil(radius * remaining / EXPLICIT)
    while True:
        if radius * h <= EXPLICIT:
            step = explicit_step(knee, tick, layer, impact, NOWHERE, s, y, v, h, begin)
        else:
            step = doubled_step(
                knee, tick, layer, impact, NOWHERE, s, y, v, h, begin, room - used - STEP_COST
            )
        used += step.evaluations
        ratio = rough * error_ratio(knee, tick, layer, s, begin, step, h, landed)
        factor = 0.9 / math.sqrt(math.sqrt(max(ratio, 1e-4)))
        if ratio <= 1.0:
            break
        h *= max(0.1, factor)
        if not step.implicit and (
            knee.surfaces.non_convex > 0.0 or knee.surfaces.knot_spacing < math.inf
        ):
            rough = SINGULAR
        if used + STEP_COST >= room or not until + h > until:
            return step, h, NOWHERE, try_step, used, True, rough
    try_step = h * factor if h < remaining else max(try_step, h * factor)
    given_up = False
    # Ended on one boundary, a step may have crossed another before: a dashpot pulls before the surfaces part.
    while NOWHERE < step.boundary != boundary and h > 0.0 and not given_up:
        given_up = used + STEP_COST >= room
        if not given_up:
            step, h, boundary, extra = end_on_boundary(
                knee,
                tick,
                layer,
                True,
                impact,
                s,
                y,
                v,
                0.0,
                step.fraction * h,
                begin,
                begin,
                step.boundary,
                room - used,
            )
            used += extra
            given_up = used + STEP_COST >= room
    return step, h, boundary, try_step, used, given_up, rough


@inlined
def advance(knee: KneeConstants, tick: Interval, start: FemurState, most: int) -> Result:
    """Carry the femur over the interval with at most `most` evaluations of the contact law."""
    mass, duration = knee.mass, tick.duration
    y, v, error, try_step = start.height, start.velocity, start.error, start.try_step
    impact, impact_error = start.impact_speed, start.impact_error
    latest, landing_rate = (
        0.0,
        0.0,
    )  # the last touch: when the exact femur has touched too, and its rate [m/s]
    s, until, following, used, looked, events, given_up = 0.0, 0.0, 0.0, 0, 0, 0, False
    layer, pressing, rough = APART, False, 1.0
    stage = stage_at(knee, tick, APART, 0.0, 0.0, y, v)
    while s < duration and not given_up:
        if s >= until:
            # Begin a smooth stretch: the rate of the surface has jumped, by a sample or at a kink.
            if following > s:
                gap, pull = following - s, -(tick.load + tick.load_rate * s) * knee.per_mass
                if pressing:
                    pull = stage.acceleration
                y, v, s = y + gap * (v + 0.5 * gap * pull), v + gap * pull, following
                stage = stage_at(knee, tick, APART, 0.0, s, y, v)
            until, following = duration, duration
            if len(knee.surfaces.kinks) > 0:
                until, following = stretch_from(knee, tick, s)
            # Rounding in the direction of the rate decides the side of a layer's end.
            ahead = stage.depth + math.copysign(DEPTH_ROUNDING, stage.rate)
            if math.isnan(impact) and ahead >= 0.0:
                impact, impact_error = stage.rate, velocity_reach(error)
            layer, pressing = layer_at(knee.law, ahead), False
            if layer > APART:
                stage = stage_in(
                    knee,
                    tick,
                    layer,
                    impact,
                    s,
                    stage.depth,
                    stage.rate,
                    stage.surface_rate,
                    stage.cosine,
                )
                used += 1
                pressing = knee.allow_tension or stage.force >= -tick.rounding
        touched = impact if impact > -math.inf else 0.0
        h, boundary, begin = until - s, NOWHERE, stage
        if used + STEP_COST >= most:
            break
        if pressing:
            step, h, boundary, try_step, extra, given_up, rough = pressed_step(
                knee,
                tick,
                layer,
                touched,
                s,
                y,
                v,
                begin,
                until,
                try_step,
                impact > 0.0,
                most - used,
            )
            used += extra
            if given_up:
                break
        else:
            limit = (
                MAX_LOOKS - looked if layer == APART else min(MAX_LOOKS, most - used - STEP_COST)
            )
            low, high, before, boundary, looks = fly(
                knee, tick, layer, touched, s, y, v, h, begin, limit
            )
            if layer > APART:
                used += looks
            else:
                looked += looks
            if looks >= limit:
                break
            if boundary == NOWHERE:
                step = flown(knee, tick, layer, touched, s, y, v, h)
            else:
                step, h, boundary, extra = end_on_boundary(
                    knee,
                    tick,
                    layer,
                    False,
                    touched,
                    s,
                    y,
                    v,
                    low,
                    high,
                    begin,
                    before,
                    boundary,
                    most - used,
                )
                used += extra if layer > APART else 0
        if h > 0.0:
            y, v, stage = step.height, step.velocity, step.end
            if pressing:
                k, c = step.stiffness, step.damping
                held, unknown = holding(k, c, mass), UNKNOWN_IMPLICIT if step.implicit else UNKNOWN
                error = over_step(error, begin.stiffness, k, stage.stiffness, c, mass, h)
                error = with_step(
                    error, rough * step.height_error, rough * step.velocity_error, unknown, held
                )
                in_layer = max(begin.depth, stage.depth) - float(knee.law[layer, BEGIN])
                error = curved(error, in_layer, k, c, mass, h)
                if step.implicit:
                    crept, swung = unresolved(
                        tick, begin, step, tick.load + tick.load_rate * s, mass, h
                    )
                    if (
                        crept + swung > 0.0
                    ):  # at an unknown phase, a swing is a height as well as a velocity
                        swung *= LOST_SWING * math.sqrt(0.5)
                        error = with_bound(error, crept + swung / held, swung)
            else:
                error = with_uncorrelated_bound(
                    mapped(error, 1.0, h, 0.0, 1.0), step.height_error, 0.0
                )
            if step.implicit:
                stage = stage_at(knee, tick, layer, touched, s + h, y, v)
                used += 1
            if knee.remembers and pressing:
                if begin.rate < 0.0 < stage.rate:
                    # The exact surfaces may have parted and met again: the tangents at both ends meet lower than that.
                    back = (begin.depth - stage.depth + h * stage.rate) / (stage.rate - begin.rate)
                    if min(begin.depth + max(back, 0.0) * begin.rate, stage.depth) <= reach(
                        error, math.inf
                    ):
                        again = abs(impact) + max(-begin.rate, stage.rate) + velocity_reach(error)
                        impact_error = max(impact_error, again)
                if impact_error > 0.0:
                    doubt = max(
                        impact_doubt(knee, layer, begin, touched, impact_error),
                        impact_doubt(knee, layer, stage, touched, impact_error),
                    )
                    used += 4
                    error = with_bound(error, 0.0, doubt / (mass * max(held, 1.0 / h)))
        s = until if h == until - s else s + h
        if boundary == NOWHERE:
            continue
        # Go on beyond the boundary, in the next mode.
        exerted, off = (
            stage.force if pressing else 0.0,
            inside_by(knee, layer, pressing, boundary, stage),
        )
        if layer == APART:
            late = lateness(tick, error, s, stage.rate, mass)
            # A femur that comes later has been sped up or slowed down by the load meanwhile.
            impact, impact_error = (
                stage.rate,
                velocity_reach(error) + abs(tick.load + tick.load_rate * s) / mass * late,
            )
            latest, landing_rate, touched = s + late, stage.rate, stage.rate
        if boundary == FORCE:
            pressing, off = not pressing, 0.0
        else:
            layer += 1 if boundary == BELOW else -1
            pressing = False
        stage = stage_in(
            knee,
            tick,
            layer,
            touched,
            s,
            stage.depth,
            stage.rate,
            stage.surface_rate,
            stage.cosine,
        )
        if layer == APART:
            impact = math.nan
        elif boundary != FORCE:
            pressing = knee.allow_tension or stage.force >= -tick.rounding
            used += 1
        jump = (stage.force if pressing else 0.0) - exerted
        error = saltation(error, stage.rate, jump, off, mass, duration)
        if layer == APART:
            doubt = RELEASED * velocity_reach(error) / SPREAD
            error = Error(
                error.height, error.velocity, error.hh, error.hv, error.vv + doubt * doubt
            )
        error = bounded(error)
        events += 1
        given_up = events >= MAX_EVENTS
    # The contact at the end of the interval, or where the tick was given up.
    error = bounded(error)
    if latest > duration:
        # The exact femur may not have touched yet, and still has the velocity of its flight.
        way = (latest - duration) * landing_rate
        error = bounded(
            with_bound(error, way + max(stage.depth, 0.0), abs(landing_rate - stage.rate))
        )
    force, force_estimate, estimate = 0.0, 0.0, AIRBORNE * reach(error, math.inf)
    if pressing:
        doubt = 0.0
        if knee.remembers and impact_error > 0.0:
            doubt = impact_doubt(knee, layer, stage, touched, impact_error)
            used += 2
            height, velocity = pushed_by(doubt, stage.stiffness, stage.damping, mass, duration)
            error = with_bound(error, height, velocity)
        held = holding(stage.stiffness, stage.damping, mass)
        estimate = reach(error, held)
        beside = layer  # the layer that the exact contact may be in
        if float(knee.law[layer + 1, BEGIN]) - stage.depth <= estimate:
            beside = layer + 1
        elif layer - 1 > APART and stage.depth - float(knee.law[layer, BEGIN]) <= estimate:
            beside = layer - 1
        left_out = (
            float(knee.law[beside, DAMPING]) - float(knee.law[layer, DAMPING])
        ) * stage.rate
        force_estimate = (
            force_reach(error, stage.stiffness, stage.damping, abs(left_out), held) / stage.cosine
            + doubt
        )
        force = stage.force if knee.allow_tension else max(stage.force, 0.0)
    femur = FemurState(y, v, error, try_step, impact, impact_error)
    return Result(
        femur, stage, force, estimate, force_estimate, used, s >= duration and abs(y) < math.inf
    )
