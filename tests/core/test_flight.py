"""Free flight: no look at the surfaces on a way on which they cannot meet."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_modes import ContactModes
from knee_contact_ros.core.contact_pairs import Closest, ContactPair, CurveContact, OnPlane
from knee_contact_ros.core.contact_pairs.on_plane import PlaneTouch
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.error_estimate import PropagatedError
from knee_contact_ros.core.geometries import Circle, FemoralGeometry
from knee_contact_ros.core.integrators.base import FemurState
from knee_contact_ros.core.integrators.free_flight import flight
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.levels.dynamic import stepwise
from knee_contact_ros.core.levels.flight import flies_freely, flying_tick
from knee_contact_ros.core.mechanisms import Hinge, Mechanism, ParallelMechanism, Table
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.prescribed import Interval, touch_at
from knee_contact_ros.core.scene import Scene
from studies.ellipse import Ellipse
from tests.core.surfaces import PLATEAU, noisy_femur
from tests.helpers.scenes import RADIUS, moving

REGIONS = ContactModes(CONTACT_LAWS["kelvin_voigt"](stiffness=7.9e7, exponent=1.5, damping=5000.0), allow_tension=False)
ELLIPSE = Ellipse(0.034, 0.028)
NOISY = noisy_femur(2e-4)
PAIRS: list[ContactPair] = [
    OnPlane(Circle(RADIUS)), OnPlane(ELLIPSE, 0.2), OnPlane(NOISY), CurveContact(NOISY, PLATEAU),
    CurveContact(Circle(RADIUS), TibialCircle(0.095)),
]  # fmt: skip
MECHANISMS: list[Mechanism] = [Hinge(), ParallelMechanism().table, Table([0.0, 0.5, 1.0], [0.0, 0.01, -0.01])]


@pytest.mark.parametrize("femur", [Circle(RADIUS), ELLIPSE, NOISY])
def test_no_point_is_farther_than_the_farthest(femur: FemoralGeometry) -> None:
    reach = np.hypot(*femur.outline().T).max()
    assert reach <= femur.largest_radius() * (1.0 + 1e-15) < 1.02 * reach  # 1e-15: rounding; 1.02: the bound is of use


@pytest.mark.parametrize("mechanism", MECHANISMS)
def test_no_slope_is_larger_than_the_largest(mechanism: Mechanism) -> None:
    slopes = [abs(mechanism.translation(angle)[1]) for angle in np.linspace(-1.0, 3.0, 4001).tolist()]
    assert max(slopes) <= mechanism.largest_slope() * (1.0 + 1e-15) <= 1.5 * max(slopes)


@given(
    st.sampled_from(PAIRS), st.sampled_from(MECHANISMS), st.floats(0.0, 1.5), st.floats(-40.0, 40.0),
    st.floats(1e-4, 2e-2), st.floats(-0.5, 0.5), st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0),
    st.floats(0.0, 2.0), st.booleans(),
)  # fmt: skip
def test_what_flies_freely_never_touches(
    pair: ContactPair, mechanism: Mechanism, angle: float, angle_rate: float, duration: float, velocity: float,
    begin: float, end: float, part: float, hovers: bool,
) -> None:  # fmt: skip
    """Gaps are drawn around the largest ways: `part` of the fall and the turn, or of the turn alone if it hovers."""
    velocity, begin, end = (0.0, 0.0, 0.0) if hovers else (velocity, begin, end)
    interval = Interval(pair, mechanism, duration, angle, angle_rate, begin, (end - begin) / duration, math.nan)
    way = duration * (abs(velocity) + max(abs(begin), abs(end)) * duration) + abs(angle_rate) * duration * 0.01
    at_rest = pair.closest(angle, mechanism.translation(angle)[0], 0.2)
    height = 0.2 + (at_rest.depth + part * way) / at_rest.normal_y
    depth = touch_at(interval, 0.0).touch(height)[0]
    start = moving(FemurState(height, velocity))._replace(depth=depth)
    if not flies_freely(interval, start, 1.0):
        return
    for s in np.linspace(0.0, duration, 40).tolist():
        there = flight(interval, 1.0, 0.0, start.state, s)
        assert touch_at(interval, s).touch(there.height)[0] < 0.0


def test_the_short_cut_gives_what_the_steps_give() -> None:
    """To rounding: steps of any length end on the same parabola."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        pair, mechanism, mass = PAIRS[2], MECHANISMS[1], 1.7
        interval = Interval(pair, mechanism, 2e-3, rng.uniform(0.0, 1.0), rng.uniform(-5.0, 5.0), -50.0, 9e3, math.nan)
        start = moving(FemurState(0.08, rng.uniform(-0.2, 0.2)))._replace(
            depth=-0.03, error=PropagatedError(1e-9, -1e-7, 1e-20, 0.0, 1e-14)
        )
        assert flies_freely(interval, start, mass)
        scene = Scene(pair, mechanism, REGIONS, mass, 1e-6, 0.0, 0, LEVELS["dynamic"])
        steps, short = stepwise(scene, interval, start, 0), flying_tick(interval, start, mass, 0)
        assert short.depth == pytest.approx(steps.depth, abs=1e-16)
        assert short.rate == pytest.approx(steps.rate, abs=1e-14)
        assert short.error_estimate == pytest.approx(steps.error_estimate, rel=1e-6)  # rounding of the way
        assert short.evaluations == steps.evaluations == 0


class Counted(NamedTuple):
    """A circle on a plane that counts how often it is looked at."""

    contact: OnPlane
    looks: list[float]

    def closest(self, angle: float, x: float, height: float) -> Closest:
        self.looks.append(height)
        return self.contact.closest(angle, x, height)

    def at(self, angle: float, angle_rate: float, x: float, x_rate: float) -> PlaneTouch:
        self.looks.append(math.nan)
        return self.contact.at(angle, angle_rate, x, x_rate)

    def __getattr__(self, name: str) -> object:
        return getattr(self.contact, name)


def test_a_high_flight_looks_at_the_surfaces_for_its_answer_only() -> None:
    """Once for the gap and its rate, once for the closest point, in every tick well above the plateau."""
    pair = Counted(OnPlane(Circle(RADIUS)), [])
    model = KneeModel(
        pair=pair, mechanism=Hinge(), modes=REGIONS, mass=1.0, tolerance=1e-6, budget=0, height_prescribed=False,
        level=LEVELS["auto"],
    )  # fmt: skip
    stream, looks = model.stream(), []
    for tick in range(30):
        pair.looks.clear()
        contact = stream.tick(0.002 * tick, 0.1 * tick, 100.0 if tick < 5 else -100.0)
        looks.append(len(pair.looks))
    assert contact.gap > 0.05
    assert looks[-15:] == [2] * 15
