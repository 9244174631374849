"""Promises at the extremes, whatever the scene: the checks of `studies.stability` on scenes that hypothesis draws."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from studies.stability import energy_gains, judge, promises
from studies.stability_scenes import (
    DEGENERATE,
    random_scene,
    run,
)

pytestmark = pytest.mark.filterwarnings("ignore:the knee turns at up to")
"""These motions are faster than any knee's"""

BUDGET = 2000
"""Keeps the tests short: what cannot be solved within it must be said."""


def answers(scene, tolerance=None, budget=BUDGET):
    return run(scene, tolerance, budget, quick=True)


def uniform(data):
    return lambda low, high: data.draw(st.floats(low, high))


@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_answers_are_finite_never_pull_and_misses_are_said(data):
    scene = random_scene(uniform(data))
    assert not promises(answers(scene), scene.tolerance)


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_no_energy_is_made(data):
    scene = random_scene(uniform(data), ("circle",))
    scene = scene._replace(load=(scene.load[0],) * len(scene.time))
    assert energy_gains(scene, answers(scene)).max(initial=-np.inf) <= 1.0


@pytest.mark.parametrize("name", ["mri", "ellipse", *DEGENERATE])
@settings(deadline=None, max_examples=4)
@given(data=st.data())
def test_flexion_jumps_keep_the_promises_on_any_profile(name, data):
    scene = random_scene(uniform(data), (name,))
    jumps = tuple(data.draw(st.lists(st.floats(-0.2, 1.6), min_size=8, max_size=8)))
    assert not promises(answers(scene._replace(angle=jumps)), scene.tolerance)


# Once missed: the error exceeded the tolerance, and the tick was not flagged.


@pytest.mark.parametrize("number", [23, 81, 135])
def test_both_levels_meet_the_tolerance_or_say_so(number):
    # A bumpy femur that turns within a tick; one that leaps; and an impact that the law still remembers at lift-off.
    scene = random_scene(np.random.default_rng((0, number)).uniform)
    assert not judge(scene, quick=True).failures
    assert not judge(scene, "quasi_static", quick=True).failures
