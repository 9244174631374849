"""Error estimates on random scenes that were once wrong, uncompiled, against the reference that shares no code."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros.core.model import PLAIN
from studies.honesty.judging import Judged, judge
from studies.honesty.ours import knee
from studies.honesty.scenes import ARTHRITIC, FEMUR, KNEE, Scene, draw, shipped
from studies.honesty.truth import reference


def judged(seed: int, level: str, tolerance: float) -> Judged:
    return answered(draw(seed), level, tolerance)


def answered(scene: Scene, level: str, tolerance: float, budget: int = 0, force_tolerance: float = 0.0) -> Judged:
    model = replace(knee(scene, level, tolerance, budget, force_tolerance), kernel=PLAIN)
    series = model.run(scene.time, scene.angle, scene.load)
    return judge(series, reference(scene), tolerance, force_tolerance)


@pytest.mark.parametrize(("seed", "level", "tolerance"), [
    (1000197, "quasi_static", 1e-6),  # no load at all: the surface throws the femur up
    (1000197, "first_order", 1e-6),
    (1000178, "quasi_static", 1e-6),  # the first load after none, on an undamped layer
    (1000150, "quasi_static", 1e-5),
    (1000294, "quasi_static", 1e-6),  # a load that ends within a tick, faster than the contact swings
])  # fmt: skip
def test_lift_offs_and_landings_are_covered(seed: int, level: str, tolerance: float) -> None:
    found = judged(seed, level, tolerance)
    assert found.depth.known.sum() > 100
    assert not found.depth.wrong.any()
    assert not found.claimed.any()
    # the estimate is one: what the studies ask of thousands of scenes need not be so in each
    assert found.depth.covered[found.depth.known].mean() > 0.98


@pytest.mark.parametrize(("seed", "level", "tolerance"), [
    (1000334, "quasi_static", 1e-6),  # a turn of the surface throws a hard contact off
    (1000334, "auto", 1e-6),
    (1001020, "auto", 1e-4),  # a contact on its way to a depth many times its own
    (1001396, "dynamic", 1e-6),  # a force that ends right before its surface does
    (1000392, "auto", 1e-5),  # a load about to end
    (1000170, "auto", 1e-5),  # a layer's boundary, met by the quasi-static level
    (1001994, "auto", 1e-8),  # a late landing at another speed
    (1000636, "auto", 1e-6),  # a creeping contact that is let go
    (1001734, "auto", 1e-8),  # one step whose estimate goes through 0
    (1000237, "first_order", 1e-6),  # a swing of hundreds of radians in a tick
    (1000088, "first_order", 1e-8),  # a layer's boundary, and a velocity that rises and falls at it
    (2000084, "dynamic", 1e-8),  # a kick that a stiff dashpot has ended long before a step looks
    (1000010, "quasi_static", 1e-4),  # a load that ends, and the speed at which the surfaces part
])  # fmt: skip
def test_what_was_said_right_and_wrong_is_not_any_more(seed: int, level: str, tolerance: float) -> None:
    found = judged(seed, level, tolerance)
    assert found.depth.known.sum() > 30
    assert not found.depth.wrong.any()
    assert not found.claimed.any()


def test_surfaces_that_part_and_meet_again_within_a_tick_begin_another_contact() -> None:
    """They overlap at both ends of a part of the flight, and damping goes by the later impact."""
    time, load = np.arange(7) * 1e-3, np.array([299.0, 299.0, -350.0, 1213.0, -350.0, 1213.0, 1213.0])
    arguments = {"stiffness": 1e9, "exponent": 1.5, "restitution": 0.2, "least_impact_speed": 5e-3}
    scene = Scene(
        0, "", "hunt_crossley", arguments, 2.0, (0.034, 0.034), 0.0, False, "", time, np.full(7, 0.5), load
    )  # fmt: skip
    found = answered(scene, "dynamic", 1e-6)
    assert found.depth.known.all()
    assert found.depth.covered.all()
    assert not found.depth.wrong.any()


def test_a_released_contact_that_presses_again_between_two_looks_is_found() -> None:
    """Its force rises above 0 for a tenth of a tick, where neither its depth nor the rate of that turns round."""
    time = np.array([0.0, 0.01, 0.02, 0.03, 0.04, 0.045, 0.05])
    angle = np.array([0.9, 0.975, 1.05, 1.108, 1.166, 1.195, 1.224])
    load = np.array([100.0, 100.0, 50.0, -200.0, -200.0, -200.0, -200.0])
    scene = Scene(0, "", "kelvin_voigt", KNEE, FEMUR, (0.034, 0.0265), 0.0, False, "", time, angle, load)
    found = answered(scene, "dynamic", 1e-8)
    assert found.depth.known.all()
    assert found.depth.covered.all()
    assert not found.depth.wrong.any()


@pytest.mark.parametrize(("law", "budget"), [("two_layer_elastic", 150), ("kelvin_voigt", 100)])
def test_a_budget_does_not_forget_that_a_turning_surface_kicks(law: str, budget: int) -> None:
    """The femur flies by millimetres for ticks that are all given up at their very beginning."""
    hard = {"stiffness": 3.07e9, "exponent": 1.056, "layer_depth": 4.9e-4, "stiffness_2": 1.65e11}
    arguments = hard if law == "two_layer_elastic" else {"stiffness": 3.27e12, "exponent": 1.967, "damping": 1.468e6}
    tick = np.arange(40)
    angle = np.where(tick < 8, 0.5 - 0.05 * np.cos(tick), 0.4623 - 0.06 * np.clip(tick - 7, 0, 6))
    load = np.where(tick < 20, 30.0, -1e-8)
    scene = Scene(0, "", law, arguments, 10.8, (0.048, 0.032), 0.0, False, "", tick * 8e-3, angle, load)
    found = answered(scene, "dynamic", 1e-4, budget)
    flown = found.depth.known & (found.depth.error > 1e-3)
    assert flown.sum() > 5
    assert not found.depth.wrong.any()
    assert found.depth.covered[flown & (tick < 20)].all()


def test_a_first_order_force_is_in_doubt_where_its_inertia_goes_through_zero() -> None:
    """That of a tick's mean is 0 then, and that of its end is not."""
    time = np.arange(17) * 8e-3
    load = 300.0 * (1.0 + np.cos(8.0 * math.pi * time))
    scene = Scene(0, "", "kelvin_voigt", KNEE, FEMUR, (0.034, 0.034), 0.0, False, "", time, np.full(17, 0.5), load)
    found = answered(scene, "first_order", 1e-6, force_tolerance=0.1)
    assert found.force.known.sum() > 12
    assert found.force.covered.all()
    assert not found.force.wrong.any()


def test_a_running_arthritic_knee_is_not_lost() -> None:
    """Between the strides nothing presses it: it leaves its undamped layer, and comes back in the next stance."""
    time = np.arange(320) * 5e-3
    phase = np.mod(time + 0.4, 0.7)
    load = np.maximum(0.0, np.where(phase < 0.26, 1200.0 * np.sin(math.pi * np.minimum(phase / 0.26, 1.0)), 0.0))
    law, arguments = shipped(ARTHRITIC)
    angle = 0.5 + 0.4 * np.sin(math.tau * time / 0.7)
    scene = Scene(0, ARTHRITIC, law, arguments, FEMUR, (0.034, 0.030), 0.0, False, "", time, angle, load)
    found = answered(scene, "auto", 1e-6)
    assert found.apart.mean() > 0.5
    assert found.depth.covered[found.depth.known].mean() > 0.98
    assert found.said_right.mean() >= 0.95


def test_a_first_order_contact_that_nothing_presses_costs_nothing() -> None:
    """Its dashpot lets it creep towards no depth for ever."""
    scene, unloaded = draw(1000244), slice(0, 12)
    assert (scene.load[3:12] <= 0.0).all()
    model = replace(knee(scene, "first_order", 1e-6), kernel=PLAIN)
    series = model.run(scene.time[unloaded], scene.angle[unloaded], scene.load[unloaded])
    assert series.evaluations[4:].max() < 100
