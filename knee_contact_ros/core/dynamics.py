"""Forward dynamics of the femur over one tick (Eq. 13): M ÿ = -L(t) + F(δ, δ̇), with error control and events.

A step computes with the formula of one region of the contact law. When it has crossed a boundary of the region it is
shortened until it ends on the boundary, and the next region goes on from there: no step crosses a kink or a jump.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

from knee_contact_ros.core.error_estimate import (
    SAFETY,
    behind_jump,
    carry,
    carry_in_flight,
    decay_rate,
    depth_error,
    leap,
    lost_swing,
    settled_doubt,
)
from knee_contact_ros.core.events import end_on_boundary, first_crossing
from knee_contact_ros.core.integrators.base import FemurState, Stage, StateError, Step
from knee_contact_ros.core.integrators.doubling import doubled_step
from knee_contact_ros.core.integrators.esdirk4 import ORDER, STAGE_ORDER, esdirk4_step
from knee_contact_ros.core.integrators.free_flight import free_flight_step
from knee_contact_ros.core.prescribed import Interval
from knee_contact_ros.core.regions import Margin, Region, Regions, depth_ahead
from knee_contact_ros.core.statics import static_contact

LOCAL_SHARE = 0.1
"""Share of the tolerance that the errors of all steps together may use while the contact remembers them."""
MEMORY = 1.0
"""How long [s] an error is taken to count where nothing damps it."""
ROUNDING = 4.0 * sys.float_info.epsilon
"""Part of a height or a velocity below which an estimated error is rounding, which no smaller step can cure."""
NEWTON_SHARE = 0.01
"""Share of the tolerance at which Newton's method has arrived."""
MAX_EVALUATIONS = 100_000
"""Contact law evaluations after which a tick is answered with the static solution, and says so."""
MAX_EVENTS = 1_000
"""The same for the boundaries that a tick crosses."""


class FemurDynamics(NamedTuple):
    """The scene: what does not change from tick to tick."""

    regions: Regions
    mass: float
    """[kg]"""
    tolerance: float
    """Wanted error of the depth [m]"""
    budget: int
    """Contact law evaluations a tick may cost; 0: no limit"""


class Progress(NamedTuple):
    """Where a run stands: all that one tick hands to the next."""

    state: FemurState
    error: StateError
    try_step: float
    """Duration [s] that the next step should try"""
    impact_speed: float | None
    """Rate [m/s] at which the present contact began; None while apart"""
    impact_error: float = 0.0
    """Its error [m/s]"""


class Advance(NamedTuple):
    """The contact at the end of a tick."""

    progress: Progress
    depth: float
    """[m] signed: < 0 apart"""
    rate: float
    """[m/s]"""
    force: float
    """[N]"""
    error_estimate: float
    """[m]"""
    evaluations: int
    dynamic: bool
    """False if the budget ran out and the contact is the static one"""


class OutOfBudgetError(Exception):
    """A tick takes more evaluations or events than it may."""


class Tick:
    """One interval on its way; holds what its steps share."""

    def __init__(self, scene: FemurDynamics, interval: Interval, start: Progress) -> None:
        self.scene = scene
        self.interval = interval
        self.s = self.until = 0.0
        self.state, self.error, self.try_step, self.impact_speed, self.impact_error = start
        self.regions = scene.regions.after_impact(start.impact_speed or 0.0)
        self.evaluations = 0
        self.events = 0
        self.error_at_events = 0.0

    def advance(self) -> Advance:
        """Carry the femur over the interval, or answer with the static solution at its end if that takes too much."""
        try:
            return self.result(self.steps())
        except (OutOfBudgetError, OverflowError):  # overflow: flights of years, after a clock has jumped ahead
            return self.settled()

    def steps(self) -> Region:
        """Step to the end of the interval; return the region there."""
        for begin, until in self.interval.stretches():
            self.until = until
            region = self.begin(begin)
            while self.s < self.until:
                region = self.step(region)
        return region

    def begin(self, s: float) -> Region:
        """Go on at s [s] with the angle's new rate or the surface's new bump; return the region there."""
        self.state = FemurState(self.state.height + self.state.velocity * (s - self.s), self.state.velocity)
        self.s = s
        depth, rate = self.contact()
        if self.impact_speed is None and depth_ahead(depth, rate) >= 0.0:
            self.touched(rate)
        region = self.regions.at(depth, rate, self.interval.load(s))
        self.evaluations += region.layer >= 0
        return region

    def step(self, region: Region) -> Region:
        """Take a step; return the region behind it."""
        step, h, boundary = self.next_step(region)
        self.accept(region, step, h)
        if not boundary:
            return region
        end = step.stages[-1]
        if region.layer < 0:
            self.touched(end.rate)
        following = self.regions.beyond(region, boundary, end, self.interval.load(self.s))
        self.evaluations += boundary != "force" and following.layer >= 0
        if following.layer < 0:
            self.impact_speed = None
        self.events += 1
        self.error_at_events = max(self.error_at_events, abs(self.error.height))
        jump = self.force(following, end.depth, end.rate)[0] - self.force(region, end.depth, end.rate)[0]
        self.error = behind_jump(self.error, end.rate, jump, self.scene.mass, self.interval.duration)
        return following

    def touched(self, speed: float) -> None:
        """Remember how fast the contact that begins now approaches [m/s]."""
        self.impact_speed, self.impact_error = speed, self.error.velocity
        self.regions = self.scene.regions.after_impact(speed)

    def result(self, region: Region) -> Advance:
        """The contact at the end of the interval."""
        depth, rate = self.contact()
        force, stiffness, damping = self.force(region, depth, rate)
        # In flight a velocity error does nothing to the height until later; in contact the two turn into each other.
        error = abs(self.error.height)
        if region.pressing:
            error = depth_error(self.error, stiffness, damping, self.scene.mass)
            error += self.impact_doubt(region, depth, rate, force) / max(stiffness, sys.float_info.min)
        return Advance(
            progress=Progress(self.state, self.error, self.try_step, self.impact_speed, self.impact_error),
            depth=depth,
            rate=rate,
            force=force if self.scene.regions.allow_tension else max(force, 0.0),
            # A bounce turns the height's error round: where that is underway, its signed estimate says little.
            error_estimate=SAFETY * max(error, self.error_at_events),
            evaluations=self.evaluations,
            dynamic=True,
        )

    def impact_doubt(self, region: Region, depth: float, rate: float, force: float) -> float:
        """By how much the force [N] would differ if the contact had begun at the speed that is in error."""
        if self.regions.law.at_impact is None or self.impact_speed is None or not self.impact_error:
            return 0.0
        other = self.scene.regions.after_impact(self.impact_speed + self.impact_error).formula(region)
        self.evaluations += 1
        return abs(other(depth, rate)[0] - force) if other else 0.0

    def doubtful_push(self, region: Region, step: Step, h: float) -> float:
        """Speed [m/s] that this force's doubt gives the femur in a step, or until the contact answers it."""
        if h == 0.0 or not region.pressing:
            return 0.0
        end, mass = step.stages[-1], self.scene.mass
        answered = max(math.sqrt(step.stiffness / mass), step.damping / mass, 1.0 / h)
        return self.impact_doubt(region, end.depth, end.rate, end.force) / (mass * answered)

    def settled(self) -> Advance:
        """The static contact at the end of the interval, in doubt by all the motion that was going on."""
        depth, rate = self.contact()
        left, self.s = self.interval.duration - self.s, self.interval.duration
        touch, load = self.interval.touch(self.s), self.interval.load(self.s)
        static = static_contact(self.scene.regions.law, touch, load)
        surface_rate, cosine = touch(static.height)[1:]
        loads = (load, load - self.interval.load_rate * left)
        doubt = settled_doubt(max(abs(depth), static.depth), rate, loads, self.scene.mass, left)
        state = FemurState(static.height, surface_rate / cosine)
        return Advance(
            # How the contact began is lost with the motion: it may have begun as fast as all of this doubt.
            progress=Progress(state, doubt, math.inf, 0.0, doubt.velocity),
            depth=static.depth,
            rate=0.0,
            force=static.force,
            error_estimate=doubt.height,
            evaluations=self.evaluations + static.evaluations,
            dynamic=False,
        )

    def contact(self) -> tuple[float, float]:
        """Signed depth [m] and rate [m/s] at the present state."""
        depth, rate, cosine = self.interval.touch(self.s)(self.state.height)
        return depth, rate - cosine * self.state.velocity

    def force(self, region: Region, depth: float, rate: float) -> tuple[float, float, float]:
        """Force that the contact exerts [N] and its slopes."""
        formula = self.regions.formula(region)
        if formula is None or not region.pressing:
            return 0.0, 0.0, 0.0
        self.evaluations += 1
        return formula(depth, rate)

    # Steps

    def next_step(self, region: Region) -> tuple[Step, float, str]:
        """The next step: small enough for the tolerance, and ending on the first boundary that it meets.

        Returns the step, its duration [s] and the boundary's name, empty if it meets none.
        """
        load = self.interval.load(self.s)

        def margins(stage: Stage) -> tuple[Margin, ...]:
            return self.regions.margins(region, stage, load)

        step, h = self.controlled_step(region)
        boundary = ""
        while h > 0.0 and (crossing := first_crossing(margins, step, boundary)):
            step, h, boundary = end_on_boundary(
                lambda h: self.attempt(region, h), margins, self.state, step.begin, crossing[0], h * crossing[1]
            )
        return step, h, boundary

    def controlled_step(self, region: Region) -> tuple[Step, float]:
        """A step whose estimated error fits the tolerance, and its duration [s]."""
        remaining = self.until - self.s
        if not region.pressing:
            return self.attempt(region, remaining), remaining
        h = min(self.try_step, remaining)
        while True:
            step = self.attempt(region, h)
            ratio = self.error_ratio(step, h)
            factor = 0.9 * max(ratio, 1e-4) ** (-1.0 / ORDER)
            if ratio <= 1.0:
                self.try_step = h * factor if h < remaining else max(self.try_step, h * factor)
                return step, h
            h *= max(0.1, factor)
            if self.s + h == self.s:
                raise OutOfBudgetError

    def error_ratio(self, step: Step, h: float) -> float:
        """Estimated error of a step over what it may be: all steps that still count share the tolerance."""
        if not step.solved:
            return math.inf
        mass = self.scene.mass
        speed = abs(step.state.velocity) + h * abs(step.stages[-1].force) / mass
        above_rounding = StateError(
            max(abs(step.error.height) - ROUNDING * abs(step.state.height), 0.0),
            max(abs(step.error.velocity) - ROUNDING * speed, 0.0),
        )
        contact = (step.stiffness, step.damping, mass)
        leapt = leap(step, self.interval.angle_rate, h) if self.interval.pair.dented else 0.0
        # A leap is met once: its error is not one of many that add up while the contact remembers them.
        forgotten = 1.0 if leapt else min(1.0, h * max(decay_rate(*contact), 1.0 / MEMORY))
        lost = StateError(0.0, self.lost(step, h))
        error = depth_error(above_rounding, *contact) / forgotten + depth_error(lost, *contact) + h * leapt
        return error / (LOCAL_SHARE * self.scene.tolerance)

    def attempt(self, region: Region, h: float) -> Step:
        """One step of `h` [s] by the region's formula, wherever it leads.

        Raises:
            OutOfBudgetError: the tick has taken too much already.
        """
        if self.evaluations >= (self.scene.budget or MAX_EVALUATIONS) or self.events >= MAX_EVENTS:
            raise OutOfBudgetError
        scene, formula = self.scene, self.regions.formula(region)
        if formula is None or not region.pressing:
            step = free_flight_step(self.interval, formula, scene.mass, self.s, self.state, h)
        else:
            law, resolution = formula, NEWTON_SHARE * scene.tolerance

            def single(s: float, state: FemurState, h: float) -> Step:
                return esdirk4_step(self.interval, law, scene.mass, s, state, h, resolution)

            step = doubled_step(single, *self.orders(h), scene.mass, self.s, self.state, h)
        self.evaluations += step.evaluations
        return step

    def orders(self, h: float) -> tuple[int, int]:
        """Order of a step of `h` [s], and that of one that is stiff.

        A spline's third derivative jumps at its points, and its first over a dent: steps across have lost their order.
        """
        pair = self.interval.pair
        if abs(self.interval.angle_rate) * h > pair.femur.grain:
            return 1, 1
        return (STAGE_ORDER, STAGE_ORDER) if pair.dented else (ORDER, STAGE_ORDER)

    def accept(self, region: Region, step: Step, h: float) -> None:
        """Go to the end of a step."""
        if step.stiffness == step.damping == 0.0:
            carried = carry_in_flight(self.error, h)
        else:
            carried = carry(self.error, step.stiffness, step.damping, self.scene.mass, h)
        velocity = carried.velocity + step.error.velocity
        unsigned = self.lost(step, h) + self.doubtful_push(region, step, h)
        self.error = StateError(carried.height + step.error.height, velocity + math.copysign(unsigned, velocity))
        self.s = self.until if h == self.until - self.s else self.s + h
        self.state = step.state

    def lost(self, step: Step, h: float) -> float:
        """Speed [m/s] of the oscillation that a step has lost."""
        interval = self.interval
        return lost_swing(step, interval.load(self.s), interval.load_rate, self.scene.mass, h)
