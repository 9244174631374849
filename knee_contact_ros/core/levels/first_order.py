"""The first-order level: n_y F(δ, δ̇) = max(L, 0), the contact without the femur's inertia.

Where a layer has no dashpot this is the quasi-static equation. Its steps are those of the dynamic level, without mass;
they end on a layer's ends and where the load changes its sign.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import layer_at
from knee_contact_ros.core.error_estimate import (
    EXACT,
    TINY,
    CarriedError,
    bounded,
    force_reach,
    holding,
    reach,
    with_bound,
    with_push,
)
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.integrators.base import FemurState, Step, force_on
from knee_contact_ros.core.kernel_source import aside, in_kernel
from knee_contact_ros.core.levels.deviation import LeftOut, deviate
from knee_contact_ros.core.levels.dynamic import most_evaluations, unresolved
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from, touch_at
from knee_contact_ros.core.regions import ABOVE, BELOW, NOWHERE, Region, Regions
from knee_contact_ros.core.scene import Advance, Progress, Scene, impact_of
from knee_contact_ros.core.statics import height_at, static_contact
from knee_contact_ros.core.stepping import (
    EXPLICIT,
    LOCAL_SHARE,
    MOST_EXPLICIT,
    NEWTON_SHARE,
    NO_LANDING,
    Going,
    attempt,
    giving_up,
    impact_doubt,
    looks_for_doubt,
    motion_in,
)
from knee_contact_ros.core.types import Fidelity

FIRST_ORDER = int(Fidelity.FIRST_ORDER)
UNKNOWN_INERTIA = 0.6
"""Part of the inertia that is left out that is not known: it is a tick's mean"""
FADING, FASTER = 0.5, 10.0
"""Part of a tick's load at its end below which it lets go of the contact, and how much the inertia may grow in that"""
UNKNOWN_STEPS = 5.0
"""How much larger than its estimate a step's error may be"""
SUDDEN = 3.0
"""Ticks that are longer than this many times C/K see the level's velocity jump"""


class FirstOrder(NamedTuple):
    """The level as a part of a scene."""

    fidelity: int = FIRST_ORDER
    """Of its answers; read by nobody, but Numba cannot pass a tuple without fields"""

    def advance(self, scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
        """See `Level`."""
        return first_order_tick(scene, interval, start, spent)


@aside
def first_order_tick(scene: Scene, interval: Interval, start: Progress, spent: int) -> Advance:
    """Carry the contact without mass over the interval, or answer with the static solution if that takes too much."""
    massless = without_mass(scene)
    impact_speed, impact_error = impact_of(start)
    going = Going(
        0.0,
        start.state,
        EXACT,
        start.try_step,
        math.inf,
        impact_speed,
        impact_error,
        spent,
        0,
        False,
        most_evaluations(scene),
        NO_LANDING,
    )
    begin, first = 0.0, FemurState(math.nan, math.nan)
    while begin < interval.duration and not going.given_up:
        until, following = stretch_from(interval, begin)
        turn = sign_change(interval, begin)
        if begin < turn < until:
            until, following = turn, turn
        part = pressed(interval, begin, until)
        going, region = begin_part(massless, part, going, begin)
        if math.isnan(first.height):
            first = going.state
        if rests(massless, part, going):
            going = on_surface(part, going, until)
        while going.s < until and not going.given_up:
            going, region = step_on(massless, part, going, region, until)
        begin = following
    if going.given_up or not abs(going.state.height) < math.inf:
        return unresolved(interval, not_begun(going, start), start)
    return result(scene, interval, start, going, region, first)


@in_kernel
def without_mass(scene: Scene) -> Scene:
    """A scene with a mass of 0, where the contact always exerts what the load asks for."""
    regions = Regions(scene.regions.law, True)
    return Scene(
        scene.pair, scene.mechanism, regions, 0.0, scene.tolerance, scene.force_tolerance, scene.budget, scene.level,
        scene.plausible_depth,
    )  # fmt: skip


@in_kernel
def sign_change(interval: Interval, begin: float) -> float:
    """When the load changes its sign [s]; `begin` if it does not after that."""
    if load_at(interval, begin) * load_at(interval, interval.duration) >= 0.0:
        return begin
    return -interval.start_load / interval.load_rate


@in_kernel
def pressed(interval: Interval, begin: float, until: float) -> Interval:
    """The interval with no load where the load would pull; `begin` and `until` [s] are on the same side of that."""
    if load_at(interval, 0.5 * (begin + until)) >= 0.0:
        return interval
    return Interval(
        interval.pair, interval.mechanism, interval.duration, interval.angle, interval.angle_rate, 0.0, 0.0,
        interval.end_height,
    )  # fmt: skip


@in_kernel
def begin_part(scene: Scene, part: Interval, going: Going, s: float) -> tuple[Going, Region]:
    """Go on at s [s]; surfaces that are apart meet at once, for without mass nothing flies."""
    touch = touch_at(part, s)
    height = going.state.height + going.state.velocity * (s - going.s)
    depth, _, _ = touch.touch(height)
    if depth < 0.0:
        height = height_at(touch, 0.0, height)
    going = at_height(going, s, FemurState(height, going.state.velocity), 0)
    return enter_layer(scene, part, going, max(0, layer_at(scene.regions.law, max(0.0, depth))))


@in_kernel
def rests(scene: Scene, part: Interval, going: Going) -> bool:
    """Whether nothing presses a contact that has been let go but for what does not count."""
    if part.start_load != 0.0 or part.load_rate != 0.0:
        return False
    depth, _, _ = touch_at(part, going.s).touch(going.state.height)
    return depth <= NEWTON_SHARE * scene.tolerance


@in_kernel
def on_surface(part: Interval, going: Going, s: float) -> Going:
    """The contact at s [s] where the femur just touches the tibia."""
    left, _, _ = touch_at(part, going.s).touch(going.state.height)
    touch = touch_at(part, s)
    height = height_at(touch, 0.0, going.state.height)
    _, surface_rate, cosine = touch.touch(height)
    return at_height(jumped(going, left), s, FemurState(height, surface_rate / cosine), 0)


@in_kernel
def not_begun(going: Going, start: Progress) -> Going:
    """A tick back at its beginning."""
    return Going(
        0.0, start.state, start.error, going.try_step, going.swiftness, going.impact_speed, going.impact_error,
        going.evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip


@aside
def enter_layer(scene: Scene, part: Interval, going: Going, layer: int) -> tuple[Going, Region]:
    """Go on in a layer with the velocity that its equation asks for; one without a dashpot carries the load at once.

    That may lead to another layer, but not past the beginning of one with a dashpot.
    """
    touch, load, height = touch_at(part, going.s), load_at(part, going.s), going.state.height
    depth, surface_rate, cosine = touch.touch(height)
    formula = scene.regions.law.layers[layer].formula
    at_rest, stiffness, damping = formula.force_at(depth, 0.0, going.impact_speed)
    evaluations = 1
    if damping <= 0.0:
        room = max(going.most - going.evaluations - 2, 1)
        static = static_contact(scene.regions.law, touch, load, height, max(depth, 0.0), 0.0, room)
        if static.evaluations >= room:
            return giving_up(going), Region(layer, True)
        layer, depth = stopped(scene, layer, static.depth)
        height = height_at(touch, depth, static.height)
        going = jumped(going, height - going.state.height)
        depth, surface_rate, cosine = touch.touch(height)
        formula = scene.regions.law.layers[layer].formula
        at_rest, stiffness, damping = formula.force_at(depth, 0.0, going.impact_speed)
        evaluations += static.evaluations + 1
    swift, sinking = math.inf, 0.0
    if damping > 0.0:
        swift, sinking = stiffness / damping, (load / cosine - at_rest) / damping
    elif stiffness > 0.0:
        sinking = part.load_rate / cosine / stiffness
    state = FemurState(height, (surface_rate - sinking) / cosine)
    return at_height(quick_as(going, swift), going.s, state, evaluations), Region(layer, True)


@in_kernel
def stopped(scene: Scene, layer: int, depth: float) -> tuple[int, float]:
    """Layer and depth [m] at which a contact that goes from a layer to a static depth is stopped by a dashpot."""
    layers = scene.regions.law.layers
    for deeper in range(layer + 1, len(layers)):
        begin = layers[deeper].begin
        if begin < depth and layers[deeper].formula.force_at(begin, 0.0, 0.0)[2] > 0.0:
            return deeper, begin
    return max(0, layer_at(scene.regions.law, depth)), depth


@in_kernel
def jumped(going: Going, jump: float) -> Going:
    """A tick behind a jump of the height [m], which the femur with its mass does not follow.

    The sum of all jumps is kept as the expected error, and what the steps leave as the spread.
    """
    error = CarriedError(going.error.height + abs(jump), 0.0, going.error.hh, 0.0, 0.0)
    return Going(
        going.s, going.state, error, going.try_step, going.swiftness, going.impact_speed, going.impact_error,
        going.evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip


@in_kernel
def quick_as(going: Going, swift: float) -> Going:
    """A tick where the contact's rate [1/s] is `swift`; infinite where no dashpot answers."""
    return Going(
        going.s, going.state, going.error, going.try_step, swift, going.impact_speed, going.impact_error,
        going.evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip


@in_kernel
def at_height(going: Going, s: float, state: FemurState, evaluations: int) -> Going:
    """A tick at another time and state, with more evaluations spent."""
    return Going(
        s, state, going.error, going.try_step, going.swiftness, going.impact_speed, going.impact_error,
        going.evaluations + evaluations, going.events, going.given_up, going.most, going.landing,
    )  # fmt: skip


@in_kernel
def step_on(scene: Scene, part: Interval, going: Going, region: Region, until: float) -> tuple[Going, Region]:
    """Take a step towards `until` [s]; return the region behind it."""
    going, step, h = controlled_step(scene, part, going, region, until)
    boundary = NOWHERE
    while h > 0.0 and leaves(region, step) and not going.given_up:
        going, step, h, boundary = end_on_boundary(scene, part, going, region, step, h)
    if going.given_up:
        return going, region
    remembered = memory(step, h)
    spread = remembered * math.sqrt(going.error.hh) + abs(step.error.height)
    error = CarriedError(going.error.height, 0.0, spread * spread, 0.0, 0.0)
    swift = step.stiffness / step.damping if step.damping > 0.0 else math.inf
    events = going.events + (0 if boundary == NOWHERE else 1)
    going = Going(
        until if h == until - going.s else going.s + h, step.state, error, going.try_step, swift, going.impact_speed,
        going.impact_error, going.evaluations, events, going.given_up, going.most, going.landing,
    )  # fmt: skip
    if boundary == NOWHERE:
        return going, region
    return enter_layer(scene, part, going, region.layer + (1 if boundary == BELOW else -1))


@in_kernel
def leaves(region: Region, step: Step) -> bool:
    """Whether a step leaves its layer; the surface itself it can only touch."""
    return step.crossing.boundary == BELOW or (step.crossing.boundary == ABOVE and region.layer > 0)


@in_kernel
def memory(step: Step, h: float) -> float:
    """Part of an error of the height that is left after a step of `h` [s]."""
    return math.exp(-h * step.stiffness / step.damping) if step.damping > 0.0 else 0.0


@aside
def controlled_step(
    scene: Scene, part: Interval, going: Going, region: Region, until: float
) -> tuple[Going, Step, float]:
    """A step whose estimated error fits the tolerance, and its duration [s]; not yet taken."""
    remaining = until - going.s
    h = min(going.try_step, remaining)
    if going.swiftness * h > EXPLICIT and going.swiftness * remaining <= MOST_EXPLICIT * EXPLICIT:
        h = remaining / math.ceil(going.swiftness * remaining / EXPLICIT)
    going, step = attempt(scene, part, going, region, h, NOWHERE)
    while not going.given_up:
        error = abs(step.error.height) / max(1.0 - memory(step, h), 1e-3)
        ratio = error / (LOCAL_SHARE * scene.tolerance) if step.solved else math.inf
        factor = 0.9 / math.sqrt(math.sqrt(max(ratio, 1e-4)))
        if ratio <= 1.0:
            return going, step, h
        h *= max(0.1, factor)
        if not until + h > until:
            return giving_up(going), step, h
        going, step = attempt(scene, part, going, region, h, NOWHERE)
    return going, step, h


@in_kernel
def result(
    scene: Scene, interval: Interval, start: Progress, going: Going, region: Region, first: FemurState
) -> Advance:
    """The contact at the end of the interval, in doubt by its steps and by the inertia that is left out.

    `first` is the level's state at the interval's beginning.
    """
    h = interval.duration
    depth, surface_rate, cosine = touch_at(interval, h).touch(going.state.height)
    rate = surface_rate - cosine * going.state.velocity
    force, stiffness, damping = force_on(motion_in(scene, interval, going, region, NOWHERE), depth, rate)
    stiffness, damping = cosine * cosine * stiffness, cosine * cosine * damping
    change, blow, faded = going.state.velocity - first.velocity, 0.0, 0.0
    if h * stiffness > SUDDEN * damping and damping > 0.0 and start.stiffness > 0.0:
        # The dashpot answers within the tick: but for the surfaces and the softer or stiffer contact, the level's
        # velocity changes as by a blow at the beginning.
        _, surface_before, cosine_before = touch_at(interval, 0.0).touch(first.height)
        turned = surface_rate / cosine - surface_before / cosine_before
        blow = change - turned + interval.load_rate * (1.0 / stiffness - 1.0 / start.stiffness)
        answers = h * stiffness / damping
        faded = scene.mass * abs(blow) / damping * answers * math.exp(-answers)
    spring = 0.5 * (start.stiffness + stiffness)
    inertia = scene.mass * (change - blow) / h
    rest = inertia / spring if spring > 0.0 else 0.0
    layers = scene.regions.law.layers
    left_out = LeftOut(
        spring,
        0.5 * (start.damping + damping),
        rest,
        rest,
        going.state.height - first.height - (first.velocity + blow) * h,
        change - blow,
        load_at(interval, 0.0),
        load_at(interval, h),
        max(0.0, depth - layers[region.layer].begin) / cosine,
    )
    before = start.error
    jump = CarriedError(
        first.height - start.state.height + before.height,
        first.velocity + blow - start.state.velocity + before.velocity,
        before.hh,
        before.hv,
        before.vv,
    )
    error = deviate(jump, left_out, scene.mass, h)
    # What the level leaves out in a tick may not cancel against the error of its steps: the signs of both are weak.
    doubt = impact_doubt(scene, going, region, depth, rate, force)
    unknown = UNKNOWN_INERTIA * abs(inertia) + doubt
    if 0.0 < left_out.end_load < FADING * left_out.begin_load:
        # A level that leaves a contact gets ever faster.
        unknown += abs(inertia) * min(FASTER, abs(left_out.gain) * h / max(left_out.depth, TINY))
    error = with_push(error, unknown, stiffness, damping, scene.mass, h)
    held, jumps = holding(stiffness, damping, scene.mass), going.error.height + faded
    error = bounded(with_bound(error, jumps + UNKNOWN_STEPS * math.sqrt(going.error.hh), jumps * held))
    return Advance(
        Progress(
            going.state, error, going.try_step, going.impact_speed, going.impact_error, FIRST_ORDER,
            stiffness, damping, cosine * force - load_at(interval, h), rate / cosine, depth, start.adrift,
        ),
        depth,
        rate,
        max(force, 0.0),
        reach(error, held),
        force_reach(error, stiffness, damping, 0.0, held) / cosine + doubt,
        going.evaluations + 1 + looks_for_doubt(scene, going),
        h,
        True,
        going.state.height,
        FIRST_ORDER,
    )  # fmt: skip
