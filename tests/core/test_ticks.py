"""What an answer tells beyond what its level found: sliding velocity and status."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.mechanisms.table import Table
from knee_contact_ros.core.ticks import is_exact_enough
from knee_contact_ros.core.types import FLAT, MESSAGE, ROW, WRENCH, Status
from tests.core.surfaces import ellipse
from tests.helpers.scenes import RADIUS, law
from tests.helpers.scenes import model as knee

ANGLES = np.linspace(0.0, 1.0, 11)
TABLE = Table(ANGLES, -0.012 * np.sin(ANGLES))


def test_a_row_holds_the_bytes_of_its_messages() -> None:
    """C aligns as CDR does, from any multiple of 8 B on; `test_answer_layout.py` holds names and places to the .msg."""
    assert ROW.itemsize == FLAT.itemsize == ROW.itemsize // 8 * 8
    assert WRENCH.start % 8 == 0
    assert WRENCH.stop - WRENCH.start == 48
    assert MESSAGE.start == 0


@pytest.mark.parametrize("pair", [
    OnPlane(Circle(RADIUS), 0.1), OnPlane(ellipse(160), -0.2), CurveContact(ellipse(160), TibialCircle(0.095)),
])  # fmt: skip
@pytest.mark.parametrize("mechanism", [Hinge(), TABLE])
@pytest.mark.parametrize("apart", [-5e-4, 2e-3])
def test_sliding_is_that_of_the_femurs_material_point(pair: ContactPair, mechanism: Mechanism, apart: float) -> None:
    """The point that is deepest at the tick, followed through the moments around it as a point of the femur."""
    model = replace(knee(law("kelvin_voigt")), pair=pair, mechanism=mechanism, height_prescribed=True)
    angle, rate, climb, tick = 0.42, 3.0, -0.05, 1e-3
    touching = model.pair.at(angle, 0.0, mechanism.translation(angle)[0], 0.0).touch(0.0)[0]
    end = touching + apart
    series = model.run([0.0, tick], [angle - rate * tick, angle], [0.0, 0.0], [end - climb * tick, end])

    found = model.closest(angle, end)
    normal = np.array([found.normal_x, found.normal_y])
    tangent = np.array([normal[1], -normal[0]])
    arm = -found.extent * normal - found.turning * tangent

    def point(s: float) -> np.ndarray:
        turn = rate * s
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ arm
        return np.array([mechanism.translation(angle + turn)[0], end + climb * s]) + turned

    step = 1e-5  # its square times third derivatives of some 1 m/s^3: below 1e-9 m/s
    expected = float((point(step) - point(-step)) @ tangent) / (2.0 * step)
    assert series.sliding_velocity[1] == pytest.approx(expected, abs=1e-7)  # the table's spline has kinks in x''
    assert (series.gap[1] > 0.0) == (apart > 0.0)


def test_a_turning_circle_slides_anteriorly_and_a_rolling_one_not_at_all() -> None:
    model = knee(law("kelvin_voigt"))
    time = np.arange(50) * 1e-3
    angle, load = 0.2 + 2.0 * time, np.full(50, 500.0)
    turning = model.run(time, angle, load)
    assert turning.sliding_velocity[0] == 0.0  # at rest
    assert turning.sliding_velocity[1:] == pytest.approx(2.0 * RADIUS, rel=1e-12)
    rolling = replace(model, mechanism=Table(ANGLES, -RADIUS * ANGLES)).run(time, angle, load)
    assert rolling.sliding_velocity == pytest.approx(0.0, abs=1e-15)
    assert (turning.contact_point.z == 0.0).all()


def test_a_femur_that_moves_on_a_slope_slides_along_it() -> None:
    """No turn: the velocity along the height is all there is, and its part along the slope is the sliding."""
    slope = 0.3
    model = replace(knee(law("kelvin_voigt")), pair=OnPlane(Circle(RADIUS), slope))
    time = np.arange(200) * 1e-4
    series = model.run(time, np.zeros(200), 500.0 + 300.0 * np.sin(200.0 * time))
    expected = np.gradient(series.femoral_height, time) * math.sin(slope)
    # central differences: a sixth of the step squared times the third derivative, some 1e4 m/s^3 at 200 rad/s
    assert series.sliding_velocity[2:-1] == pytest.approx(expected[2:-1], abs=1e-4)
    assert np.abs(expected).max() > 5e-3


@pytest.mark.parametrize(("error", "force_error", "force_tolerance", "exact"), [
    (1e-7, 3.0, 0.0, True), (1e-7, math.nan, 0.0, True), (1e-7, 3.0, 5.0, True), (1e-7, 7.0, 5.0, False),
    (1e-7, math.nan, 5.0, False), (1e-5, 0.0, 5.0, False), (math.nan, 0.0, 0.0, False), (math.inf, 0.0, 0.0, False),
])  # fmt: skip
def test_an_answer_whose_error_is_unknown_keeps_no_tolerance(
    error: float, force_error: float, force_tolerance: float, exact: bool
) -> None:
    scene = replace(knee(law("kelvin_voigt")), tolerance=1e-6, force_tolerance=force_tolerance).scene
    assert is_exact_enough(scene, error, force_error) == exact


@pytest.mark.parametrize("height", [None, 0.0335])
def test_exact_answers_have_no_error(height: float | None) -> None:
    """The static start, and every tick at a prescribed height, keep any force tolerance."""
    model = replace(knee(law("kelvin_voigt")), force_tolerance=1e-9, height_prescribed=height is not None)
    stream = model.stream()
    for time in (0.0, 1e-3) if height else (0.0,):
        answer = stream.tick(time, 0.2, 500.0, height)
        assert (answer.force_error_estimate, answer.status) == (0.0, Status.OK)
