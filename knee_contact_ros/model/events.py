"""Where a mode ends: the next kink of the femur, the next touch of a flight, and the step that ends on a boundary.

An event is located by repeating the step with other durations, not by dense output of the method: an interpolant would
have errors of its own, and the step is cheap beside the accuracy that the next mode needs at its beginning.
"""

import math

from .closest import next_kink, touch
from .compiler import in_kernel
from .contact import (
    DEPTH_ROUNDING,
    FORCE_ZERO,
    LAYER_BEGIN,
    NO_BOUNDARY,
    Interval,
    KneeConstants,
    Mode,
    Motion,
    Stage,
    crossed,
    distance_inside,
    load_at,
)
from .error_estimate import TINY, Error, eigenvalues, height_bound
from .laws import APART, BASE, BEGIN, DAMPING
from .steps import MAX_GLIDE_RADIUS, STEP_RESERVE, Step, flight_step, step_by

KINK_MARGIN = 2e-12
"""Margin of the flexion angle [rad] on both sides of a kink: more than the rounding of its place. With a hundredth of
it, evaluations on measured knees rise by a fifth (`studies.honesty measured`)."""
MAX_EVENT_ITERATIONS = 60
"""Largest number of attempts to end a step on a boundary"""
MIN_PROBES = 16.0
"""Smallest number of probes of a flight through overlapping surfaces. Tuned; `studies.honesty cut` would notice."""
GRAZE_TOLERANCE = 1e-5
"""Part of the tolerance by which a point may graze the other surface unseen between two probes of a flight. Tuned;
`studies.honesty scenes` would notice: with a thousand times as much, 20 of 0.14 million forces are not covered."""
MIN_PROBE_SPACING = 1e-6
"""Part of a flight through overlapping surfaces below which the time between two probes is not divided. Tuned;
`studies.honesty cut` would notice."""


@in_kernel
def end_on_boundary(
    mode: Mode,
    begin: Motion,
    low: float,
    high: float,
    before: Stage,
    boundary: int,
    room: int,
) -> tuple[Step, float, int, int]:
    """Find the step between durations `low` and `high` [s] that ends on a boundary which it crosses.

    The search is the Illinois variant of the false position: it keeps a bracket, and needs no derivative of the
    distance, which jumps where a force does. `before` is the contact after `low`. Returns the step, its duration, the
    boundary and the evaluations; or a shorter step and `NO_BOUNDARY` where its end does not confirm the crossing that a
    stage has shown; or a duration of 0 where it goes straight across.
    """
    enough, radius = mode.tick.rounding if boundary == FORCE_ZERO else DEPTH_ROUNDING, 0.0
    if mode.pressing:
        _, radius = eigenvalues(begin.stage.stiffness, begin.stage.damping, mode.knee.mass)
    inside, beyond, last = distance_inside(mode, boundary, before), 0.0, 0.0
    h, used, shrinkings_left = high, 0, 0
    step = step_by(mode, boundary, begin, h, radius, room)
    for iteration in range(MAX_EVENT_ITERATIONS):
        used += step.evaluations
        if used + STEP_RESERVE >= room:
            break
        distance = distance_inside(mode, boundary, step.end)
        if iteration == 0:
            if distance >= 0.0:
                return step, h, NO_BOUNDARY, used
            beyond = distance
            if mode.pressing and inside <= enough:
                shrinkings_left = 3
            inside = max(inside, 0.0)
        elif shrinkings_left > 0:
            # The step begins on this boundary. Unless a far smaller one leads inside first, it goes straight across.
            if distance > enough:
                return step, h, NO_BOUNDARY, used
            shrinkings_left -= 1
            if shrinkings_left == 0:
                return step, 0.0, boundary, used
        else:
            if abs(distance) <= enough:
                break
            # Where the other end of the bracket has been kept twice, its distance counts half (Illinois).
            kept_twice = distance * last > 0.0
            if distance < 0.0:
                high, beyond = h, distance
                if kept_twice:
                    inside *= 0.5
            else:
                low, inside = h, distance
                if kept_twice:
                    beyond *= 0.5
            last = distance
        following = 0.1 * h
        if shrinkings_left == 0:
            following = low + (high - low) * inside / (inside - beyond)
            if not low < following < high:  # it lies on the boundary at one end
                following = 0.5 * (low + high)
            if not low < following < high:
                break
        h = following
        step = step_by(mode, boundary, begin, h, radius, room - used)
    return step, h, boundary, used


@in_kernel
def probe_flight(
    mode: Mode, begin: Motion, h: float, most: int
) -> tuple[float, float, Stage, int, int]:
    """Probe a flight of `h` [s] for the first boundary that it meets, at most `most` times.

    Apart, no touch is missed: the signed depth is that of the deepest femoral point, and between two probes, dt apart,
    the depth of no point rises above the chord between those of the deepest ones by more than bend x(1 - x) dt²/2,
    where bend [m/s²] bounds how fast its penetration rate can fall: by the turning femur, the translation, a load that
    pulls, and a concave tibia. Where chord and bulge stay below 0 there is no touch; else dt is halved. In overlapping
    surfaces that are released dt is halved where depth or force has an extreme between two probes, or the contact
    leaps.

    Returns two times [s] between which the boundary is met, the contact at the first one, the boundary (`NO_BOUNDARY`:
    the flight goes on to `h`) and the number of probes.
    """
    knee, tick, s = mode.knee, mode.tick, begin.time
    turn, surfaces = abs(tick.angle_rate), knee.surfaces
    apart = mode.layer == APART
    first, last = load_at(tick, s), load_at(tick, s + h)
    speed = abs(begin.velocity) + max(abs(first), abs(last)) * h / knee.mass
    speed += turn * (surfaces.largest_radius + surfaces.largest_slope)
    bend = turn * turn * (surfaces.largest_radius + surfaces.largest_bend)
    bend += max(-first, -last, 0.0) / knee.mass
    bend += 2.0 * surfaces.concave * speed * speed
    longest, shortest = h, 0.0
    graze = max(GRAZE_TOLERANCE * knee.tolerance, DEPTH_ROUNDING)
    if not apart:
        longest, shortest = h / MIN_PROBES, h * MIN_PROBE_SPACING
        if surfaces.non_convex > 0.0:
            longest = min(longest, surfaces.knot_spacing / (MIN_PROBES * max(turn, TINY)))
    t, dt, probes, low = 0.0, longest, 0, begin.stage
    while t < h and probes < most:
        there = min(t + dt, h)
        dt = there - t
        probe = flight_step(mode, begin, there).end
        probes += 1
        boundary = crossed(mode, probe, NO_BOUNDARY)
        # `safe`: the boundary that the probe has crossed, or none, is the only one between the two probes.
        finest = dt <= shortest or not t + 0.5 * dt > t
        if apart:
            bulge, gap, next_gap = 0.5 * bend * dt * dt, -low.depth, -probe.depth
            least, small = min(gap, next_gap), bulge <= graze
            if bulge > abs(next_gap - gap):  # the parabola's lowest place lies between the two
                lowest = bulge + gap - next_gap
                least = gap - lowest * lowest / (4.0 * bulge)
            safe = finest or small or least >= -graze
            if boundary != NO_BOUNDARY:  # the flight may begin on the surface, and leave it first
                approaches = low.rate >= bend * dt
                begins_outside = gap > 0.0 or low.rate >= 0.0
                safe = finest or ((small or approaches) and begins_outside)
        else:
            # The rate of the force follows from that of the depth and from its acceleration, which the load changes.
            pull = (probe.rate - low.rate) / dt
            bent = 0.5 * dt * tick.load_rate * knee.per_mass
            rising = low.stiffness * low.rate + low.damping * (pull - bent)
            end_rising = probe.stiffness * probe.rate + probe.damping * (pull + bent)
            safe = finest or min(low.rate * probe.rate, rising * end_rising) >= 0.0
            in_layer = low.depth - float(knee.law[mode.layer, BEGIN])
            # It may press before the layer ends: where the force is 0 again there, or where the layers above press.
            slowest = max(low.rate, probe.rate)
            edge = float(knee.law[mode.layer, BASE] + knee.law[mode.layer, DAMPING] * slowest)
            presses = edge > 0.0 or 2.0 * low.force * low.rate < rising * in_layer
            if boundary == LAYER_BEGIN and presses:
                safe = finest
            if surfaces.non_convex > 0.0:
                # Right after a leap the next bump presses, maybe only for a moment.
                change = abs(probe.surface_rate - low.surface_rate)
                leaps = change > MAX_GLIDE_RADIUS * turn * turn * dt
                safe = finest or (safe and not leaps)
            if boundary != NO_BOUNDARY:  # the flight may begin on the boundary, and leave it first
                safe = finest or (safe and distance_inside(mode, boundary, low) > 0.0)
        if safe and boundary != NO_BOUNDARY:
            return t, there, low, boundary, probes
        if safe:
            t, low, dt = there, probe, min(2.0 * dt, longest)
        else:
            dt *= 0.5
    return t, h, low, NO_BOUNDARY, probes


@in_kernel
def led_contact(
    knee: KneeConstants, tick: Interval, height: float, velocity: float, s: float
) -> tuple[float, float]:
    """Return depth [m] and rate [m/s] at s [s] of a femur that is led at a velocity [m/s], at a height [m] then."""
    angle = tick.angle + tick.angle_rate * s
    depth, surface_rate, cosine = touch(knee.surfaces, angle, tick.angle_rate, height)
    return depth, surface_rate - cosine * velocity


@in_kernel
def last_touch(
    knee: KneeConstants,
    tick: Interval,
    height: float,
    velocity: float,
    end_depth: float,
    end_rate: float,
) -> tuple[float, bool, int]:
    """Return the penetration rate [m/s] of the last touch of a femur that is led through an interval to a contact.

    It is NaN if the surfaces are in contact all the while. The search goes back from the end. Between two probes, dt
    apart, the depth is no less than the tangents of its deepest points there, but for bend dt²/2, where bend [m/s²]
    bounds how fast the rate of any point can fall. Where that is above 0, the contact does not end; else dt is halved.
    Also returns whether the budget has sufficed, and the number of probes.
    """
    turn, surfaces, duration = abs(tick.angle_rate), knee.surfaces, tick.duration
    speed = abs(velocity) + turn * (surfaces.largest_radius + surfaces.largest_slope)
    bend = turn * turn * (surfaces.largest_radius + surfaces.largest_bend)
    bend += 2.0 * surfaces.convex * speed * speed
    s, dt, depth, rate, probes = duration, duration, end_depth, end_rate, 0
    shortest = MIN_PROBE_SPACING * duration
    while s > 0.0 and probes < knee.budget - 1:
        before = max(s - dt, 0.0)
        dt = s - before
        depth_before, rate_before = led_contact(
            knee, tick, height + velocity * before, velocity, before
        )
        probes += 1
        least = min(depth_before, depth)
        if rate_before < 0.0 < rate:
            back = (depth_before - depth + dt * rate) / (rate - rate_before)
            least = min(least, depth_before + min(max(back, 0.0), dt) * rate_before)
        if least > 0.5 * bend * dt * dt or (dt <= shortest and least > 0.0):
            s, depth, rate, dt = before, depth_before, rate_before, 2.0 * dt
        elif dt > shortest:
            dt *= 0.5
        elif depth_before > 0.0:
            s, depth, rate = before, depth_before, rate_before
        else:
            return touch_rate(knee, tick, height, velocity, before, s, rate), True, probes
    return math.nan, s <= 0.0, probes


@in_kernel
def touch_rate(
    knee: KneeConstants,
    tick: Interval,
    height: float,
    velocity: float,
    low: float,
    high: float,
    impact: float,
) -> float:
    """Return the rate [m/s] of a touch between two times [s] by bisection; `impact` is the rate at the later one."""
    for _ in range(MAX_EVENT_ITERATIONS):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        depth, rate = led_contact(knee, tick, height + velocity * middle, velocity, middle)
        if depth > 0.0:
            high, impact = middle, rate
        else:
            low = middle
    return impact


@in_kernel
def touch_delay(tick: Interval, error: Error, s: float, rate: float, mass: float) -> float:
    """Return the time [s] by which the exact femur may touch later than this one, which touches at a `rate` [m/s].

    The exact femur is at most as far away as the error of the height, and falls at least as fast as the load makes it.
    """
    gap = height_bound(error, math.inf)
    load = min(load_at(tick, s), load_at(tick, tick.duration))
    delay = gap / max(abs(rate), TINY)
    if load > 0.0:
        delay = min(delay, math.sqrt(2.0 * gap * mass / load))
    if load >= 0.0 and tick.load_rate > 0.0:
        delay = min(delay, (6.0 * gap * mass / tick.load_rate) ** (1.0 / 3.0))
    return delay


@in_kernel
def smooth_stretch(knee: KneeConstants, tick: Interval, begin: float) -> tuple[float, float]:
    """Return the end [s] of the smooth stretch that begins at `begin` [s], and the beginning [s] of the next one.

    Between the two, the rate of the femoral surface jumps. At a kink of the femoral profile one stretch ends shortly
    before it and the next begins shortly behind, so that rounding cannot put either on the wrong side. The last stretch
    ends with the interval, and so does its next.
    """
    end_angle = tick.angle + tick.angle_rate * tick.duration
    kink = next_kink(knee.surfaces, tick.angle + tick.angle_rate * begin, end_angle)
    while not math.isnan(kink):
        margin = KINK_MARGIN / abs(tick.angle_rate)
        s = (kink - tick.angle) / tick.angle_rate
        if begin < s - margin and s + margin < tick.duration:
            return s - margin, s + margin
        kink = next_kink(knee.surfaces, kink, end_angle)
    return tick.duration, tick.duration
