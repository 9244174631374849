"""The first-order level: n_y F(δ, δ̇) = max(L, 0), the contact without the femur's inertia.

Where a layer has no dashpot this is the quasi-static equation. The steps are those of the dynamic level, without mass;
they end on the ends of a layer and where the load changes its sign.
"""

from __future__ import annotations

import math

from knee_contact_ros.core.contact_laws.base import layer_at
from knee_contact_ros.core.contact_modes import ABOVE, BELOW, NOWHERE, ContactMode, ContactModes
from knee_contact_ros.core.error_estimate import (
    EXACT,
    TINY,
    bounded,
    force_reach,
    holding,
    reach,
    with_bound,
    with_push,
)
from knee_contact_ros.core.events import end_on_boundary
from knee_contact_ros.core.integrators.base import FemurState, Step, force_on
from knee_contact_ros.core.kernel_source import in_kernel, never_inlined
from knee_contact_ros.core.levels.deviation import UNKNOWN_INERTIA, LeftOut, deviate
from knee_contact_ros.core.levels.dynamic import most_evaluations, unresolved
from knee_contact_ros.core.prescribed import Interval, load_at, stretch_from, touch_at
from knee_contact_ros.core.scene import FIRST_ORDER, RunState, Scene, TickResult, impact_of
from knee_contact_ros.core.statics import height_at, static_contact
from knee_contact_ros.core.stepping import (
    EXPLICIT,
    LOCAL_SHARE,
    MOST_EXPLICIT,
    NEWTON_SHARE,
    NO_LANDING,
    StepperState,
    attempt,
    impact_doubt,
    looks_for_doubt,
    motion_in,
)

FADING, FASTER = 0.5, 10.0
"""Part of its first load below which the last load of a tick counts as fading, and the largest growth of inertia
then"""
UNKNOWN_STEPS = 5.0
"""Largest error of a step, over its estimate"""
SUDDEN = 3.0
"""Duration of a tick, over C/K, above which the level's velocity seems to jump in it"""


@never_inlined
def first_order_tick(scene: Scene, interval: Interval, start: RunState, spent: int) -> TickResult:
    """Carry the contact without mass over the interval; not `converged` if that takes too many evaluations.

    `spent` is the number of evaluations that the tick has taken already.
    """
    massless = without_mass(scene)
    impact_speed, impact_error = impact_of(start)
    stepper = StepperState(
        s=0.0, state=start.state, error=EXACT, try_step=start.try_step, spectral_radius=math.inf,
        impact_speed=impact_speed, impact_error=impact_error, evaluations=spent, events=0, given_up=False,
        most=most_evaluations(scene), landing=NO_LANDING,
    )  # fmt: skip
    begin, first = 0.0, FemurState(math.nan, math.nan)
    while begin < interval.duration and not stepper.given_up:
        until, following = stretch_from(interval, begin)
        turn = sign_change(interval, begin)
        if begin < turn < until:
            until, following = turn, turn
        part = pressed(interval, begin, until)
        stepper, mode = begin_part(massless, part, stepper, begin)
        if math.isnan(first.height):
            first = stepper.state
        if rests(massless, part, stepper):
            stepper = on_surface(part, stepper, until)
        while stepper.s < until and not stepper.given_up:
            stepper, mode = step_first_order(massless, part, stepper, mode, until)
        begin = following
    if stepper.given_up or not abs(stepper.state.height) < math.inf:
        return unresolved(interval, stepper._replace(s=0.0, state=start.state, error=start.error), start)
    return first_order_result(scene, interval, start, stepper, mode, first)


@in_kernel
def without_mass(scene: Scene) -> Scene:
    """Return the scene with a mass of 0, in which the contact always balances the load."""
    return scene._replace(modes=ContactModes(scene.modes.law, True), mass=0.0)


@in_kernel
def sign_change(interval: Interval, begin: float) -> float:
    """Return the time [s] at which the load changes its sign; `begin` [s] if it does not after that."""
    if load_at(interval, begin) * load_at(interval, interval.duration) >= 0.0:
        return begin
    return -interval.start_load / interval.load_rate


@in_kernel
def pressed(interval: Interval, begin: float, until: float) -> Interval:
    """The interval, with a load of 0 if the load pulls from `begin` to `until` [s]; its sign is constant there."""
    if load_at(interval, 0.5 * (begin + until)) >= 0.0:
        return interval
    return interval._replace(start_load=0.0, load_rate=0.0)


@in_kernel
def begin_part(scene: Scene, part: Interval, stepper: StepperState, s: float) -> tuple[StepperState, ContactMode]:
    """Continue at s [s]; surfaces that are apart meet at once, because nothing flies without mass."""
    touch = touch_at(part, s)
    height = stepper.state.height + stepper.state.velocity * (s - stepper.s)
    depth, _, _ = touch.touch(height)
    if depth < 0.0:
        height = height_at(touch, 0.0, height)
    stepper = stepper._replace(s=s, state=FemurState(height, stepper.state.velocity))
    return settle_in_layer(scene, part, stepper, max(0, layer_at(scene.modes.law, max(0.0, depth))))


@in_kernel
def rests(scene: Scene, part: Interval, stepper: StepperState) -> bool:
    """Whether there is no load, and no depth beyond a negligible one."""
    if part.start_load != 0.0 or part.load_rate != 0.0:
        return False
    depth, _, _ = touch_at(part, stepper.s).touch(stepper.state.height)
    return depth <= NEWTON_SHARE * scene.tolerance


@in_kernel
def on_surface(part: Interval, stepper: StepperState, s: float) -> StepperState:
    """Return the tick at s [s] with the femur just touching the tibia."""
    left, _, _ = touch_at(part, stepper.s).touch(stepper.state.height)
    touch = touch_at(part, s)
    height = height_at(touch, 0.0, stepper.state.height)
    _, surface_rate, cosine = touch.touch(height)
    return jumped(stepper, left)._replace(s=s, state=FemurState(height, surface_rate / cosine))


@never_inlined
def settle_in_layer(
    scene: Scene, part: Interval, stepper: StepperState, layer: int
) -> tuple[StepperState, ContactMode]:
    """Continue in a layer with the velocity that its equation gives; one without a dashpot carries the load at once.

    That jump may lead to another layer, but not past the beginning of one with a dashpot.
    """
    touch, load, height = touch_at(part, stepper.s), load_at(part, stepper.s), stepper.state.height
    depth, surface_rate, cosine = touch.touch(height)
    formula = scene.modes.law.layers[layer].formula
    at_rest, stiffness, damping = formula.force_at(depth, 0.0, stepper.impact_speed)
    evaluations = 1
    if damping <= 0.0:
        room = max(stepper.most - stepper.evaluations - 2, 1)
        static = static_contact(scene.modes.law, touch, load, height, max(depth, 0.0), 0.0, room)
        if static.evaluations >= room:
            return stepper._replace(given_up=True), ContactMode(layer, True)
        layer, depth = stopped(scene, layer, static.depth)
        height = height_at(touch, depth, static.height)
        stepper = jumped(stepper, height - stepper.state.height)
        depth, surface_rate, cosine = touch.touch(height)
        formula = scene.modes.law.layers[layer].formula
        at_rest, stiffness, damping = formula.force_at(depth, 0.0, stepper.impact_speed)
        evaluations += static.evaluations + 1
    fastest, sinking = math.inf, 0.0
    if damping > 0.0:
        fastest, sinking = stiffness / damping, (load / cosine - at_rest) / damping
    elif stiffness > 0.0:
        sinking = part.load_rate / cosine / stiffness
    state = FemurState(height, (surface_rate - sinking) / cosine)
    evaluations += stepper.evaluations
    return stepper._replace(state=state, spectral_radius=fastest, evaluations=evaluations), ContactMode(layer, True)


@in_kernel
def stopped(scene: Scene, layer: int, depth: float) -> tuple[int, float]:
    """Return layer and depth [m] that a contact jumps to from a layer, towards a static depth: a dashpot stops it."""
    layers = scene.modes.law.layers
    for deeper in range(layer + 1, len(layers)):
        begin = layers[deeper].begin
        if begin < depth and layers[deeper].formula.force_at(begin, 0.0, 0.0)[2] > 0.0:
            return deeper, begin
    return max(0, layer_at(scene.modes.law, depth)), depth


@in_kernel
def jumped(stepper: StepperState, jump: float) -> StepperState:
    """Return the tick after a jump of the height [m], which a femur with mass does not follow.

    In this level's `error`, the expected error of the height is the sum of all jumps, that of the velocity the sum of
    its changes, and the variance of the height is that of the errors of the steps.
    """
    before = stepper.error
    return stepper._replace(error=before._replace(height=before.height + abs(jump), hv=0.0, vv=0.0))


@in_kernel
def step_first_order(
    scene: Scene, part: Interval, stepper: StepperState, mode: ContactMode, until: float
) -> tuple[StepperState, ContactMode]:
    """Take a step towards `until` [s]; return the mode after it."""
    stepper, step, h = controlled_massless_step(scene, part, stepper, mode, until)
    boundary = NOWHERE
    while h > 0.0 and leaves(mode, step) and not stepper.given_up:
        stepper, step, h, boundary = end_on_boundary(scene, part, stepper, mode, step, h)
    if stepper.given_up:
        return stepper, mode
    remembered = memory(step, h)
    spread = remembered * math.sqrt(stepper.error.hh) + abs(step.error.height)
    changed = stepper.error.velocity + abs(step.state.velocity - stepper.state.velocity)
    error = stepper.error._replace(velocity=changed, hh=spread * spread, hv=0.0, vv=0.0)
    fastest = step.stiffness / step.damping if step.damping > 0.0 else math.inf
    events = stepper.events + (0 if boundary == NOWHERE else 1)
    s = until if h == until - stepper.s else stepper.s + h
    stepper = stepper._replace(s=s, state=step.state, error=error, spectral_radius=fastest, events=events)
    if boundary == NOWHERE:
        return stepper, mode
    return settle_in_layer(scene, part, stepper, mode.layer + (1 if boundary == BELOW else -1))


@in_kernel
def leaves(mode: ContactMode, step: Step) -> bool:
    """Whether a step leaves its layer; the surface itself can only be touched."""
    return step.crossing.boundary == BELOW or (step.crossing.boundary == ABOVE and mode.layer > 0)


@in_kernel
def memory(step: Step, h: float) -> float:
    """Return the part of an error of the height that is left after a step of `h` [s]."""
    return math.exp(-h * step.stiffness / step.damping) if step.damping > 0.0 else 0.0


@never_inlined
def controlled_massless_step(
    scene: Scene, part: Interval, stepper: StepperState, mode: ContactMode, until: float
) -> tuple[StepperState, Step, float]:
    """Compute a step towards `until` [s] whose estimated error fits the tolerance; return it and its duration [s].

    Its own function, beside that of `stepping.py`: with one for both, ticks of this level take 1.07 times as long.
    """
    remaining = until - stepper.s
    h = min(stepper.try_step, remaining)
    if stepper.spectral_radius * h > EXPLICIT and stepper.spectral_radius * remaining <= MOST_EXPLICIT * EXPLICIT:
        h = remaining / math.ceil(stepper.spectral_radius * remaining / EXPLICIT)
    stepper, step = attempt(scene, part, stepper, mode, h, NOWHERE)
    while not stepper.given_up:
        error = abs(step.error.height) / max(1.0 - memory(step, h), 1e-3)
        ratio = error / (LOCAL_SHARE * scene.tolerance) if step.solved else math.inf
        factor = 0.9 / math.sqrt(math.sqrt(max(ratio, 1e-4)))
        if ratio <= 1.0:
            return stepper, step, h
        h *= max(0.1, factor)
        if not until + h > until:
            return stepper._replace(given_up=True), step, h
        stepper, step = attempt(scene, part, stepper, mode, h, NOWHERE)
    return stepper, step, h


@in_kernel
def first_order_result(
    scene: Scene, interval: Interval, start: RunState, stepper: StepperState, mode: ContactMode, first: FemurState
) -> TickResult:
    """Return the contact at the end of the interval, with the errors of the steps and of the inertia that is left out.

    `first` is the state of this level at the beginning of the interval.
    """
    h = interval.duration
    depth, surface_rate, cosine = touch_at(interval, h).touch(stepper.state.height)
    rate = surface_rate - cosine * stepper.state.velocity
    force, stiffness, damping = force_on(motion_in(scene, interval, stepper, mode, NOWHERE), depth, rate)
    rising = cosine * (interval.load_rate - cosine * stiffness * rate)
    stiffness, damping = cosine * cosine * stiffness, cosine * cosine * damping
    change, blow, faded, at_end = stepper.state.velocity - first.velocity, 0.0, 0.0, math.nan
    _, surface_before, cosine_before = touch_at(interval, 0.0).touch(first.height)
    turned = surface_rate / cosine - surface_before / cosine_before
    if damping > 0.0 and h * stiffness <= SUDDEN * damping:
        at_end = scene.mass * (turned / h - rising / damping)
    elif damping > 0.0 and start.stiffness > 0.0:
        # The dashpot answers within the tick: but for the surfaces and the softer or stiffer contact, the level's
        # velocity changes as by a blow at the beginning.
        blow = change - turned + interval.load_rate * (1.0 / stiffness - 1.0 / start.stiffness)
        answers = h * stiffness / damping
        faded = scene.mass * abs(blow) / damping * answers * math.exp(-answers)
    spring = 0.5 * (start.stiffness + stiffness)
    inertia = scene.mass * (change - blow) / h
    rest = inertia / spring if spring > 0.0 else 0.0
    layers = scene.modes.law.layers
    left_out = LeftOut(
        stiffness=spring, damping=0.5 * (start.damping + damping), end_stiffness=stiffness, end_damping=damping,
        begin_rest=rest, end_rest=rest,
        way=stepper.state.height - first.height - (first.velocity + blow) * h, gain=change - blow, inertia=inertia,
        begin_load=load_at(interval, 0.0), end_load=load_at(interval, h),
        depth=max(0.0, depth - layers[mode.layer].begin) / cosine,
    )  # fmt: skip
    jump = start.error._replace(
        height=first.height - start.state.height + start.error.height,
        velocity=first.velocity + blow - start.state.velocity + start.error.velocity,
    )
    error = deviate(jump, left_out, scene.mass, h)
    # What the level leaves out in a tick may not cancel against the error of its steps: the signs of both are weak.
    doubt = impact_doubt(scene, stepper, mode, depth, rate, force)
    unknown = UNKNOWN_INERTIA * abs(inertia) + doubt
    if 0.0 < left_out.end_load < FADING * left_out.begin_load:
        # A level that leaves a contact gets ever faster.
        unknown += abs(inertia) * min(FASTER, abs(left_out.gain) * h / max(left_out.depth, TINY))
    error = with_push(error, unknown, stiffness, damping, scene.mass, h)
    held, jumps = holding(stiffness, damping, scene.mass), stepper.error.height + faded
    blows = jumps * held
    if stepper.events > 0:
        # Next to a layer's boundary, where the next one is soft at first, the velocity may rise and fall again.
        blows += max(stepper.error.velocity - abs(change), 0.0)
    error = bounded(with_bound(error, jumps + UNKNOWN_STEPS * math.sqrt(stepper.error.hh), blows))
    if not math.isnan(at_end):
        doubt += abs(at_end - inertia)
    return TickResult(
        run_state=RunState(
            state=stepper.state, error=error, try_step=stepper.try_step, impact_speed=stepper.impact_speed,
            impact_error=stepper.impact_error, fidelity=FIRST_ORDER, stiffness=stiffness, damping=damping,
            excess=cosine * force - load_at(interval, h), sinking=rate / cosine, depth=depth, adrift=start.adrift,
        ),
        depth=depth, rate=rate, force=max(force, 0.0), error_estimate=reach(error, held),
        force_error_estimate=force_reach(error, stiffness, damping, 0.0, held) / cosine + doubt,
        evaluations=stepper.evaluations + 1 + looks_for_doubt(scene, stepper), reached=h, converged=True,
        height=stepper.state.height, fidelity=FIRST_ORDER,
    )  # fmt: skip
