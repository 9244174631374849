"""One step of the solver: explicit, implicit or in flight, with its error estimate and the boundary that it crosses.

A contact that is not stiff for the step takes an explicit step, and any other an implicit one with half the step twice.
In flight only the load acts, so that the step is exact. Nothing here decides how long a step may be: `solver.py` does.
"""

import math
from typing import NamedTuple

from .closest import ON_PLANE, Surfaces
from .compiler import in_kernel, inlined
from .contact import NO_BOUNDARY, Interval, Mode, Motion, Stage, crossed, load_at, stage_at
from .laws import BEGIN
from .profiles import CELL_WIDTH, has_knot
from .tableaux import ESDIRK, FEHLBERG

MAX_EXPLICIT_STEP = 1.0
"""Largest step times spectral radius of the contact that is taken explicitly. Tuned; `studies.honesty scenes` would
notice: with 1.5, a stiff landing was wrong while its status was OK."""
SINGULAR_ERROR_FACTOR = 10.0
"""Factor on the explicit estimate where a layer begins. The force is the 1.5th power of the way from there, and both
orders fail alike: for t^1.5 they are 8.2e-4 and 9.0e-4 off, so that their difference is a tenth of the error. Without
it a fifth fewer evaluations on measured knees, and more forces than the estimate covers (`studies.honesty scenes`)."""
STIFF_ORDER_LIMIT = 100.0
"""h² k/m + h c/m above which an implicit step has only its stage order. Tuned; `studies.honesty scenes` would notice:
without it 6 depths and 6 forces of 0.14 million are not covered."""
MAX_GLIDE_RADIUS = 0.2
"""Largest radius of curvature [m] of femur and tibia together over which a contact glides. Beyond it the contact has
leapt to another bump. Tuned; `studies.honesty cut` would notice."""
NEWTON_TOLERANCE_SHARE = 0.01
"""Newton's method has converged when it corrects by less than this share of the tolerance; usual are 0.1 to 0.01
(Hairer & Wanner II, section IV.8)."""
NEWTON_DEPTH_SHARE = 1e-4
"""... and by less than this share of the depth: a contact that has just begun needs more digits. Tuned;
`studies.honesty scenes` would notice: without it 0.7 % more of the ticks are flagged."""
NEWTON_FLOOR = 1e-16
"""... but a correction [m] below this is rounding. Without it the cost of a tick rises by 80 % in `studies.honesty`."""
MAX_NEWTON_ITERATIONS = 30
FLIGHT_ROUNDING = 2e-12
"""Error of a flight, as a part of its way, by the rounding of the event before it. Tuned; `studies.honesty scenes`
(seed 72, number 97) would notice: 55 depths of one scene are not covered without it."""
STEP_RESERVE = 18
"""Evaluations that must be left for another step: an explicit one takes 6, an implicit one with its halves more"""


class Step(NamedTuple):
    """The end of a step, its estimated local error and the first boundary that it has crossed."""

    height: float
    velocity: float
    height_error: float
    velocity_error: float
    end: Stage
    stiffness: float
    """As in `Stage`, in the middle of the step: it carries errors over the step at second order"""
    damping: float
    leap: float
    """Change of the depth's rate [m/s] where the contact leaps to another bump in the step; 0 if it does not"""
    boundary: int
    """The boundary that is crossed first, or `NO_BOUNDARY`"""
    fraction: float
    """Place of that crossing as a part of the step"""
    evaluations: int
    solved: bool
    """False if a stage's equation was not solved; the step must then be repeated with a smaller duration."""
    implicit: bool


@in_kernel
def scan_stages(
    mode: Mode,
    known: int,
    h: float,
    begin: Stage,
    fractions: tuple[float, ...],
    stages: tuple[Stage, ...],
) -> tuple[int, float, float]:
    """Return the first boundary that the stages of a step of `h` [s] cross, where, and their largest leap [m/s].

    The stages are in the order of their `fractions` of the step. The `known` boundary is not reported at the end,
    because the step is meant to end there. A gliding contact changes its rate by the radius of curvature times the
    turn, at most `MAX_GLIDE_RADIUS`.
    """
    # The end of a step may be inside while a stage is beyond: a contact that lets go and begins again within the step.
    tick = mode.tick
    boundary, fraction, leap = NO_BOUNDARY, 1.0, 0.0
    rate_before, fraction_before = begin.surface_rate, 0.0
    glides = MAX_GLIDE_RADIUS * tick.angle_rate * tick.angle_rate * h
    for i in range(5):
        stage, here = stages[i], fractions[i]
        if boundary == NO_BOUNDARY:
            boundary = crossed(mode, stage, known if here == 1.0 else NO_BOUNDARY)
            fraction = here
        if mode.knee.surfaces.non_convex > 0.0:
            change = abs(stage.surface_rate - rate_before)
            if change > glides * (here - fraction_before):
                leap = max(leap, change)
            rate_before, fraction_before = stage.surface_rate, here
    return boundary, fraction, leap


@in_kernel
def crosses_knot(surfaces: Surfaces, tick: Interval, s: float, h: float) -> bool:
    """Whether a step of `h` [s] may cross a point of the femur's spline, where its third derivative jumps."""
    if surfaces.knot_spacing == math.inf:
        return False
    half = 0.5 * tick.angle_rate * h
    if abs(half) >= CELL_WIDTH or surfaces.kind != ON_PLANE:
        return abs(half) >= CELL_WIDTH
    middle, cells = tick.angle + tick.angle_rate * s + half - surfaces.slope, surfaces.cells
    return (
        has_knot(cells, middle - half) or has_knot(cells, middle) or has_knot(cells, middle + half)
    )


@inlined
def explicit_step(mode: Mode, known: int, begin: Motion, h: float) -> Step:
    """Take one step of Fehlberg's method of `h` [s]; `known` is the boundary that it is to end on, or `NO_BOUNDARY`.

    v1, v2, ... are the rates of the height at the stages, dv1, dv2, ... those of the velocity.
    """
    # Numbers by name and no sums over arrays: plain Python computes faster with floats than with NumPy's scalars, and
    # Numba folds the coefficients into the code.
    (a21,), (a31, a32), (a41, a42, a43), (a51, a52, a53, a54), row6 = FEHLBERG.stages
    a61, a62, a63, a64, a65 = row6
    c2, c3, c4, _, c6 = FEHLBERG.nodes
    b1, _, b3, b4, b5, _ = FEHLBERG.weights
    e1, _, e3, e4, e5, e6 = FEHLBERG.errors
    knee, layer = mode.knee, mode.layer
    s, y, v1, one = begin
    dv1 = one.acceleration
    v2 = v1 + h * (a21 * dv1)
    two = stage_at(mode, s + c2 * h, y + h * (a21 * v1), v2)
    dv2 = two.acceleration
    v3 = v1 + h * (a31 * dv1 + a32 * dv2)
    three = stage_at(mode, s + c3 * h, y + h * (a31 * v1 + a32 * v2), v3)
    dv3 = three.acceleration
    v4 = v1 + h * (a41 * dv1 + a42 * dv2 + a43 * dv3)
    four = stage_at(mode, s + c4 * h, y + h * (a41 * v1 + a42 * v2 + a43 * v3), v4)
    dv4 = four.acceleration
    v5 = v1 + h * (a51 * dv1 + a52 * dv2 + a53 * dv3 + a54 * dv4)
    height = y + h * (a51 * v1 + a52 * v2 + a53 * v3 + a54 * v4)
    dv5 = stage_at(mode, s + h, height, v5).acceleration
    v6 = v1 + h * (a61 * dv1 + a62 * dv2 + a63 * dv3 + a64 * dv4 + a65 * dv5)
    height = y + h * (a61 * v1 + a62 * v2 + a63 * v3 + a64 * v4 + a65 * v5)
    six = stage_at(mode, s + c6 * h, height, v6)
    # The solution of fourth order goes on, so that the estimate belongs to the very solution that is continued.
    height = y + h * (b1 * v1 + b3 * v3 + b4 * v4 + b5 * v5)
    velocity = v1 + h * (b1 * dv1 + b3 * dv3 + b4 * dv4 + b5 * dv5)
    end = stage_at(mode, s + h, height, velocity)
    layer_begin = float(knee.law[layer, BEGIN])
    # Where the force or the curve is not smooth, both orders of the pair fail alike; see `SINGULAR_ERROR_FACTOR`.
    near_begin = abs(end.depth - one.depth) >= min(one.depth, end.depth) - layer_begin
    scale = h
    if near_begin or crosses_knot(knee.surfaces, mode.tick, s, h):
        scale = h * SINGULAR_ERROR_FACTOR
    least = min(two.depth, three.depth, four.depth, six.depth, end.depth)
    most = max(two.depth, three.depth, four.depth, six.depth, end.depth)
    weakest = min(two.force, three.force, four.force, six.force, end.force)
    boundary, fraction, leap = NO_BOUNDARY, 1.0, 0.0
    room = min(least - layer_begin, weakest, float(knee.law[layer + 1, BEGIN]) - most)
    # Most steps cross nothing, and three comparisons show it. `non_convex` is 1 where contacts may leap, else 0.
    if room < knee.surfaces.non_convex:
        # In the order of time. The end of the step takes the place of the fifth stage, which lies there too.
        boundary, fraction, leap = scan_stages(
            mode, known, h, one, (c2, c3, c6, c4, 1.0), (two, three, six, four, end)
        )
    return Step(
        height=height,
        velocity=velocity,
        height_error=scale * (e1 * v1 + e3 * v3 + e4 * v4 + e5 * v5 + e6 * v6),
        velocity_error=scale * (e1 * dv1 + e3 * dv3 + e4 * dv4 + e5 * dv5 + e6 * six.acceleration),
        end=end,
        stiffness=six.stiffness,
        damping=six.damping,
        leap=leap,
        boundary=boundary,
        fraction=fraction,
        evaluations=6,
        solved=True,
        implicit=False,
    )


@in_kernel
def solve_stage(
    mode: Mode,
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
    knee, load, unknown = mode.knee, load_at(mode.tick, s), velocity + diagonal * guess
    most = max(1, min(most, MAX_NEWTON_ITERATIONS))
    evaluations, converged = 0, False
    while True:
        stage = stage_at(mode, s, height + diagonal * unknown, unknown)
        evaluations += 1
        # Where a formula pulls its slope may be negative. Without it Newton's method still goes downhill.
        slope = diagonal * max(stage.stiffness, 0.0) + stage.damping
        residual = knee.mass * (unknown - velocity) - diagonal * (
            stage.cosine * stage.force - load
        )
        correction = residual / (knee.mass + diagonal * slope)
        unknown -= correction
        enough = min(NEWTON_TOLERANCE_SHARE * knee.tolerance, NEWTON_DEPTH_SHARE * stage.depth)
        converged = abs(correction) * diagonal <= max(enough, NEWTON_FLOOR)
        if converged or evaluations >= most:
            break
    gain = stage.cosine * correction
    # Newton's method converges quadratically, so the square of its last correction is left.
    left = gain * diagonal * (gain * diagonal) / max(stage.depth, NEWTON_FLOOR)
    force, depth, rate = stage.force, stage.depth, stage.rate
    if converged:
        # All else follows the last correction along the tangent, which saves an evaluation.
        force += slope / stage.cosine * correction
        depth += diagonal * gain
        rate += gain
    solved = Stage(
        depth,
        rate,
        force,
        stage.stiffness,
        stage.damping,
        stage.surface_rate,
        stage.cosine,
        (stage.cosine * force - load) * knee.per_mass,
    )
    return unknown, solved, evaluations, converged, left


@in_kernel
def implicit_step(mode: Mode, known: int, begin: Motion, h: float, room: int) -> Step:
    """Take one ESDIRK step of `h` [s] with `room` evaluations at most; otherwise as `explicit_step`.

    The embedded solution is not used: in gait its estimate was a fifth of the true error. `doubled_step` estimates it.
    """
    (a21,), (a31, a32), (a41, a42, a43), (a51, a52, a53, a54), row6 = ESDIRK.stages
    a61, _, a63, a64, a65 = row6
    c2, c3, c4, c5, _ = ESDIRK.nodes
    s, y, v1, one = begin
    # Each stage starts Newton's method from the acceleration of the stage before it. All have the same `diagonal`.
    d, dv1 = h * ESDIRK.diagonal, one.acceleration
    height, velocity = y + h * (a21 * v1), v1 + h * (a21 * dv1)
    v2, two, n2, ok2, left2 = solve_stage(mode, s + c2 * h, height, velocity, d, dv1, room)
    dv2, used = two.acceleration, n2
    height, velocity = y + h * (a31 * v1 + a32 * v2), v1 + h * (a31 * dv1 + a32 * dv2)
    v3, three, n3, ok3, left3 = solve_stage(
        mode, s + c3 * h, height, velocity, d, dv2, room - used
    )
    dv3, used = three.acceleration, used + n3
    height = y + h * (a41 * v1 + a42 * v2 + a43 * v3)
    velocity = v1 + h * (a41 * dv1 + a42 * dv2 + a43 * dv3)
    v4, four, n4, ok4, left4 = solve_stage(mode, s + c4 * h, height, velocity, d, dv3, room - used)
    dv4, used = four.acceleration, used + n4
    height = y + h * (a51 * v1 + a52 * v2 + a53 * v3 + a54 * v4)
    velocity = v1 + h * (a51 * dv1 + a52 * dv2 + a53 * dv3 + a54 * dv4)
    v5, five, n5, ok5, left5 = solve_stage(mode, s + c5 * h, height, velocity, d, dv4, room - used)
    dv5, used = five.acceleration, used + n5
    height = y + h * (a61 * v1 + a63 * v3 + a64 * v4 + a65 * v5)
    velocity = v1 + h * (a61 * dv1 + a63 * dv3 + a64 * dv4 + a65 * dv5)
    v6, end, n6, ok6, left6 = solve_stage(mode, s + h, height, velocity, d, dv5, room - used)
    # In the order of time: the third stage lies before the second.
    boundary, fraction, leap = scan_stages(
        mode, known, h, one, (c3, c2, c4, c5, 1.0), (three, two, four, five, end)
    )
    return Step(
        height=height + d * v6,
        velocity=v6,
        height_error=left2 + left3 + left4 + left5 + left6,
        velocity_error=0.0,
        end=end,
        stiffness=end.stiffness,
        damping=end.damping,
        leap=leap,
        boundary=boundary,
        fraction=fraction,
        evaluations=used + n6,
        solved=ok2 and ok3 and ok4 and ok5 and ok6,
        implicit=True,
    )


@in_kernel
def doubled_step(mode: Mode, known: int, begin: Motion, h: float, room: int) -> Step:
    """Take two ESDIRK steps of h/2 [s], with an error estimate from their difference to one whole step.

    Source: Hairer, Nørsett & Wanner, Solving Ordinary Differential Equations I, section II.4 (Richardson's estimate),
    of the solution that is continued: the difference over 2⁴ - 1 = 15. In a contact that is stiff for the step only the
    stage order is left (Prothero & Robinson; Hairer & Wanner II, section IV.15), hence 2² - 1 = 3, and likewise across
    a point of a spline or a dent.
    """
    knee, half = mode.knee, 0.5 * h
    whole = implicit_step(mode, known, begin, h, room)
    used = whole.evaluations
    # Only the end of the second half may lie on the known boundary; in the first half it counts as crossed.
    first = implicit_step(mode, NO_BOUNDARY, begin, half, room - used)
    middle = begin.time + half
    halfway = Motion(
        middle,
        first.height,
        first.velocity,
        stage_at(mode, middle, first.height, first.velocity),
    )
    used += first.evaluations + 1
    second = implicit_step(mode, known, halfway, half, room - used)
    stiff = h * (h * first.stiffness + first.damping) > STIFF_ORDER_LIMIT * knee.mass
    leaps = knee.surfaces.non_convex > 0.0
    crosses = leaps or crosses_knot(knee.surfaces, mode.tick, begin.time, h)
    ratio = 3.0 if stiff or crosses else 15.0
    boundary, fraction = second.boundary, 0.5 + 0.5 * second.fraction
    if first.boundary != NO_BOUNDARY:
        boundary, fraction = first.boundary, 0.5 * first.fraction
    difference = (second.height - whole.height) / ratio
    # What Newton's method has left gets the sign of the difference, so that the two cannot cancel.
    left = math.copysign(first.height_error + second.height_error, difference)
    return Step(
        height=second.height,
        velocity=second.velocity,
        height_error=difference + left,
        velocity_error=(second.velocity - whole.velocity) / ratio,
        end=second.end,
        stiffness=first.stiffness,
        damping=first.damping,
        leap=max(first.leap, second.leap),
        boundary=boundary,
        fraction=fraction,
        evaluations=used + second.evaluations,
        solved=whole.solved and first.solved and second.solved,
        implicit=True,
    )


@inlined
def flight_step(mode: Mode, begin: Motion, h: float) -> Step:
    """Return a flight of `h` [s], which is exact; it reports no boundary."""
    tick, mass = mode.tick, mode.knee.mass
    load = load_at(tick, begin.time)
    fall = h * (0.5 * load + tick.load_rate * h / 6.0) / mass
    height = begin.height + h * (begin.velocity - fall)
    velocity = begin.velocity - h * (load + 0.5 * tick.load_rate * h) / mass
    end = stage_at(mode, begin.time + h, height, velocity)
    # The flight itself is exact, but the time of the event that began it is known to rounding only.
    rounding = FLIGHT_ROUNDING * abs(height - begin.height)
    return Step(
        height, velocity, rounding, 0.0, end, 0.0, 0.0, 0.0, NO_BOUNDARY, 1.0, 1, True, False
    )


@in_kernel
def step_by(mode: Mode, known: int, begin: Motion, h: float, radius: float, room: int) -> Step:
    """Compute one step of `h` [s] by the method that fits, without error control.

    `known` is the boundary that it is to end on, or `NO_BOUNDARY`; `radius` [1/s] is the contact's spectral radius;
    `room` limits the evaluations of an implicit step.
    """
    if not mode.pressing:
        return flight_step(mode, begin, h)
    if radius * h <= MAX_EXPLICIT_STEP:
        return explicit_step(mode, known, begin, h)
    return doubled_step(mode, known, begin, h, room - STEP_RESERVE)
