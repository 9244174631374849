"""The exact answers do not depend on how a piecewise linear motion is cut into ticks: no touch is missed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from knee_contact_ros.model.surfaces import ContactPair, Plane
from knee_contact_ros.model.types import Status
from tests.helpers.scenes import law, model
from tests.model.scenes import FORWARDS, HINGE, PAIRS, ellipse, fast, signed, thrown

TICKS = 40


class Motion(NamedTuple):
    """How a femur is turned and loaded."""

    tick: float
    """[s]"""
    turn: float
    """Largest turn in a tick [rad]"""
    load: float
    """Order of the load [N]"""
    pulls: float
    """Part of the ticks at which the load pulls, or nearly does"""


MOTIONS = {
    "hardly any load, 50 ms": Motion(0.05, 0.3, 0.5, 0.3),
    "hardly any load, 100 ms": Motion(0.1, 0.3, 2.0, 0.3),
    "no load at all": Motion(0.05, 0.2, 0.0, 0.0),
    "fast turns": Motion(0.01, 0.5, 50.0, 0.3),
    "fast and light": Motion(0.02, 0.8, 3.0, 0.5),
    "walking": Motion(0.01, 0.05, 900.0, 0.2),
}
SURFACES = PAIRS | {
    "ellipse": lambda: ContactPair(ellipse(160), Plane(), HINGE),
    "dents on a slope": lambda: ContactPair(ellipse(80, noise=3e-4, seed=5), Plane(-0.1), FORWARDS),
}


def cut(columns: list[np.ndarray], parts: int) -> list[np.ndarray]:
    """Samples with so many ticks in the place of each; those given are every `parts`-th of them."""
    places = np.arange(TICKS * parts - parts + 1) / parts
    return [np.interp(places, np.arange(TICKS), column) for column in columns]


def answers(knee: Any, columns: list[np.ndarray], parts: int) -> Any:
    """The answers at the given samples, of a run that is cut into parts."""
    return fast(knee).run(*cut(columns, parts))[::parts]


@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic"])
@pytest.mark.parametrize("surfaces", SURFACES)
@pytest.mark.parametrize("kind", MOTIONS)
def test_a_motion_that_is_cut_otherwise_has_the_same_answers(kind: str, surfaces: str, name: str) -> None:
    motion, pair, compared = MOTIONS[kind], SURFACES[surfaces](), 0
    for seed in range(3):
        rng = np.random.default_rng((7, seed))
        # Whole nanoseconds, in which stamps are; 16 parts of a tick have some, too.
        time = motion.tick * np.arange(TICKS)
        angle = np.clip(0.5 + np.cumsum(motion.turn * rng.uniform(-1.0, 1.0, TICKS)), -0.2, 1.6)
        load = motion.load * np.abs(rng.normal(1.0, 0.5, TICKS))
        load[rng.random(TICKS) < motion.pulls] *= -0.02
        load[0] = max(load[0], 0.5 * motion.load)
        knee = model(law(name), 1e-6, pair=pair, budget=20_000)
        runs = [answers(knee, [time, angle, load], parts) for parts in (1, 4, 16)]
        runs.append(answers(replace(knee, tolerance=1e-9), [time, angle, load], 4))
        for one in runs[:3]:
            for other in runs:
                both = (one.status == Status.OK) & (other.status == Status.OK)
                apart = np.abs(signed(one) - signed(other))
                # An estimate is one: 2e-9 m is a five hundredth of the tolerance
                bound = one.error_estimate + other.error_estimate + 2e-9
                assert (apart <= bound)[both].mean() >= 0.97 if both.any() else True, seed
                assert apart[both].max(initial=0.0) <= 2e-6, seed
                compared += int(both.sum())
    assert compared > 100


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("brush", [0.07, 0.31, 0.62, 0.93])
@pytest.mark.parametrize("deep", [1e-4, 3e-4])
def test_a_flight_sees_a_turning_profile_brush_the_plateau(deep: float, brush: float, parts: int) -> None:
    """Half axes of 34 and 28 mm: the longer one points down at a right angle, at a part of the tick."""
    begin, end = 0.5 * np.pi - 0.6 * brush, 0.5 * np.pi + 0.6 * (1.0 - brush)
    knee, geometry = model(law("hertz"), 1e-8, ellipse(320), mass=2.0), ellipse(320)
    above = geometry.support(0.5 * np.pi)[0] - deep - geometry.support(begin)[0]
    if above <= 0.0 or geometry.support(end)[0] - geometry.support(begin)[0] >= above:
        above = 0.5 * (geometry.support(0.5 * np.pi)[0] - geometry.support(begin)[0])
    found, exact = (thrown(knee, -above, 0.0, 0.01, turn=(begin, end), parts=n) for n in (parts, 60))
    assert found.femoral_height > geometry.support(begin)[0] + above + 1e-8  # thrown off
    assert abs(signed(found) - signed(exact)) <= found.error_estimate + exact.error_estimate


@pytest.mark.parametrize(("depth", "rate", "load", "end_load"), [
    (0.0, -0.0028, 8.0, -56.0),  # leaves, turns back, touches and is let go
    (-1e-7, -0.0028, 8.0, -56.0),
    (-2e-6, 0.0, 3.0, -30.0),
    (0.0, -0.07, 50.0, 50.0),
    (-1e-12, -0.07, 50.0, 50.0),
    (1e-4, -0.01578, 50.0, -200.0),  # released, presses again for a moment while the surfaces overlap
    (1e-4, -0.02, 50.0, 50.0),
    (1e-4, -0.5, 5e3, 0.0),
])  # fmt: skip
@pytest.mark.parametrize("duration", [0.01, 0.016, 0.03, 0.1])
def test_a_flight_sees_a_load_press_the_surfaces_together_for_a_moment(
    depth: float, rate: float, load: float, end_load: float, duration: float
) -> None:
    """A circle on a plane, of which the exact flight is a parabola: one tick has the answer of 60."""
    knee = model(law("kelvin_voigt"), 1e-8)
    found, exact = (thrown(knee, depth, rate, duration, load, end_load, parts=parts) for parts in (1, 60))
    assert abs(signed(found) - signed(exact)) <= found.error_estimate + exact.error_estimate + 1e-14
    # What has touched is not known better than that; nothing here is out of the tolerance by more than a late landing
    assert found.error_estimate < 1e-6
