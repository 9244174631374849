"""Promises at the extremes, whatever the scene: the checks of `studies.stability` on scenes that hypothesis draws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.model.types import Status
from studies.stability import against_reference, energy_gains, judge, promises, signed_depth
from studies.stability_scenes import (
    DEGENERATE,
    LAWS,
    SPEED,
    Scene,
    Uniform,
    arguments_of,
    femur,
    knee,
    random_scene,
    run,
)

BUDGET = 2000
"""Keeps the tests short: what cannot be solved within it must be said."""


def answers(scene: Scene, tolerance: float | None = None, budget: int = BUDGET) -> np.recarray[Any, Any]:
    return run(scene, tolerance, budget, quick=True)


def uniform(data: st.DataObject) -> Uniform:
    return lambda low, high: data.draw(st.floats(low, high))


@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_answers_are_finite_never_pull_and_misses_are_said(data: st.DataObject) -> None:
    scene = random_scene(uniform(data))
    assert not promises(answers(scene), scene.tolerance)


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_no_energy_is_made(data: st.DataObject) -> None:
    scene = random_scene(uniform(data), ("circle",))
    scene = scene._replace(load=(scene.load[0],) * len(scene.time))
    assert energy_gains(scene, answers(scene)).max(initial=-np.inf) <= 1.0


@pytest.mark.parametrize("law", LAWS)
@settings(deadline=None, max_examples=3)
@given(speed=st.floats(*SPEED), mass=st.floats(0.01, 20.0), load=st.sampled_from([0.0, 500.0]))
def test_impacts_meet_the_tolerance_or_say_so(law: str, speed: float, mass: float, load: float) -> None:
    time, held = tuple(2e-3 * i for i in range(5)), (0.3,) * 5
    scene = Scene(law, arguments_of(law, 7.9e7, 1.5, 5e3), mass, 1e-7, time, held, (load,) * 5, thrown=speed)
    assert not judge(scene, quick=True).failures


@settings(deadline=None, max_examples=8)
@given(
    stiffness=st.floats(3.0, 13.0), damping=st.floats(2.0, 7.0), mass=st.floats(-4.0, 3.0), tick=st.floats(-5.0, -1.0)
)
def test_load_steps_on_a_damped_knee_meet_the_tolerance(
    stiffness: float, damping: float, mass: float, tick: float
) -> None:
    arguments = arguments_of("kelvin_voigt", 10.0**stiffness, 1.5, 10.0**damping)
    time, load = tuple(10.0**tick * i for i in range(6)), (800.0, 800.0, 2e4, 2e4, 100.0, 100.0)
    scene = Scene("kelvin_voigt", arguments, 10.0**mass, 1e-7, time, (0.3,) * 6, load)
    assert not judge(scene, quick=True).failures


@pytest.mark.parametrize("name", ["mri", "ellipse", *DEGENERATE])
@settings(deadline=None, max_examples=4)
@given(data=st.data())
def test_flexion_jumps_keep_the_promises_on_any_profile(name: str, data: st.DataObject) -> None:
    scene = random_scene(uniform(data), (name,))
    jumps = tuple(data.draw(st.lists(st.floats(-0.2, 1.6), min_size=8, max_size=8)))
    assert not promises(answers(scene._replace(angle=jumps)), scene.tolerance)


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_a_led_femur_gives_what_the_law_says(data: st.DataObject) -> None:
    scene = random_scene(uniform(data))
    model = knee(scene, scene.tolerance, BUDGET, height_prescribed=True)
    rise = data.draw(st.lists(st.floats(-5e-3, 5e-3), min_size=8, max_size=8))
    support = np.array([femur(scene.femur).support(angle)[0] for angle in scene.angle])
    series = model.run(scene.time, scene.angle, scene.load, support + rise)
    assert not promises(series, scene.tolerance)
    assert np.allclose(series.penetration_depth - series.gap, -np.array(rise), rtol=0.0, atol=1e-15)
    assert np.all(series.error_estimate == 0.0)


# Once missed: the error exceeded the tolerance, and the tick was not flagged.


def test_an_undamped_oscillation_shorter_than_the_step_is_not_lost() -> None:
    scene = Scene(
        "hertz", {"stiffness": 1e9, "exponent": 1.0}, 1.0, 1e-7,
        time=(0.0, 0.01, 0.02, 0.03), angle=(0.3,) * 4, load=(0.0, 800.0, -300.0, -300.0),
    )  # fmt: skip
    found = against_reference(scene, budget=100_000)
    assert found.error is not None
    assert found.error <= 1.0


def test_a_dashpot_lets_go_before_the_surfaces_part() -> None:
    # 0.1 g creeps: it is let go where the load is 0, and flies off by the load alone, at first from rest, in 1.07 ms.
    arguments = arguments_of("kelvin_voigt", 1e13, 1.0, 1e7)
    load, mass, tick = (0.0, 2500.0, -300.0), 1e-4, 0.01
    scene = Scene("kelvin_voigt", arguments, mass, 1e-7, (0.0, tick, 2.0 * tick), (0.3,) * 3, load)
    last = answers(scene)[-1]
    rate = 2800.0 / tick
    flown = rate * (300.0 / rate) ** 3 / (6.0 * mass)
    assert abs(last.gap - flown) <= scene.tolerance
    assert not last.status & Status.NOT_CONVERGED


@pytest.mark.parametrize("tibia", ["plane", "circle"])
def test_bumps_of_a_raw_profile_are_not_stepped_across(tibia: str) -> None:
    time, angle = tuple(0.01 * i for i in range(8)), tuple(0.02 * i for i in range(8))
    arguments = arguments_of("kelvin_voigt", 7.9e7, 1.5, 5e3)
    scene = Scene("kelvin_voigt", arguments, 9.3, 1e-7, time, angle, (600.0,) * 8, "raw", tibia=tibia)
    assert not judge(scene, quick=True).failures


def test_a_settled_lift_off_stays_in_doubt_while_the_femur_flies() -> None:
    arguments = {"stiffness": 1e13, "exponent": 1.0, "restitution": 0.482, "least_impact_speed": 0.01}
    time, load = tuple(1e-3 * i for i in range(5)), (2500.0, 2500.0, -300.0, -300.0, -300.0)
    scene = Scene("hunt_crossley", arguments, 1e-4, 1e-7, time, (0.3,) * 5, load)
    short, long = answers(scene, budget=500), answers(scene, 1e-9, budget=100_000)
    off = np.abs(signed_depth(short) - signed_depth(long))
    assert np.all((off <= scene.tolerance) | (short.status & Status.NOT_CONVERGED != 0))


@pytest.mark.parametrize("number", [23, 81, 135])
def test_both_levels_meet_the_tolerance_or_say_so(number: int) -> None:
    # A bumpy femur that turns within a tick; one that leaps; and an impact that the law still remembers at lift-off.
    scene = random_scene(np.random.default_rng((0, number)).uniform)
    assert not judge(scene, quick=True).failures
    assert not judge(scene, "quasi_static", quick=True).failures
