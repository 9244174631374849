"""Error estimates on random scenes that were once wrong, uncompiled, against the reference that shares no code."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros.core.model import PLAIN
from studies.honesty.judging import Judged, judge
from studies.honesty.ours import knee
from studies.honesty.scenes import draw
from studies.honesty.truth import reference


def judged(seed: int, level: str, tolerance: float) -> Judged:
    scene = draw(seed)
    model = replace(knee(scene, level, tolerance), kernel=PLAIN)
    return judge(model.run(scene.time, scene.angle, scene.load), reference(scene), tolerance)


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


def test_a_first_order_contact_that_nothing_presses_costs_nothing() -> None:
    """Its dashpot lets it creep towards no depth for ever."""
    scene, unloaded = draw(1000244), slice(0, 12)
    assert (scene.load[3:12] <= 0.0).all()
    model = replace(knee(scene, "first_order", 1e-6), kernel=PLAIN)
    series = model.run(scene.time[unloaded], scene.angle[unloaded], scene.load[unloaded])
    assert series.evaluations[4:].max() < 100
