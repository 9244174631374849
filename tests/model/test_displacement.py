"""The displacement drive: the height is prescribed, and the force follows from the law."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.statics import height_at
from knee_contact_ros.model.types import ContactState, Fidelity, Status
from tests.helpers.scenes import DAMPING, RADIUS, STIFFNESS, law, model
from tests.model.scenes import PAIRS, ellipse, signed

pytestmark = pytest.mark.filterwarnings("ignore:the knee turns at up to")
"""These motions are faster than any knee's"""

TIME = np.arange(0.0, 0.1, 0.001)
NONE = np.zeros_like(TIME)
"""x [m] by the mechanism `FORWARDS`"""


def led(name="kelvin_voigt", **changes):
    """A knee at a prescribed height: fields of the model, and constants of its law."""
    constants = {key: changes.pop(key) for key in ("least_impact_speed",) if key in changes}
    return replace(model(law(name, **constants)), height_prescribed=True, **changes)  # type: ignore[arg-type]


def pressed(depth):
    """Heights of a circular femur at a depth."""
    return RADIUS - depth


def rates(values):
    """Rates of what is linear between the ticks."""
    return np.diff(values) / np.diff(TIME)


def kelvin_voigt(depth, rate):
    """Force [N] of the law that does not pull."""
    force = STIFFNESS * np.maximum(depth, 0.0) ** 1.5 + DAMPING * rate
    return np.where(depth > 0.0, np.maximum(force, 0.0), 0.0)


@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_held_still_the_force_is_the_static_one(name):
    series = led(name).run(TIME, NONE, NONE, pressed(np.full_like(TIME, 6e-4)))
    # Rounding of the height (4e-18 m) times the steepest slope (2e8 N/m), and of the power.
    assert series.contact_force == pytest.approx(law(name).static_force(6e-4), rel=1e-9)
    assert (series.error_estimate == 0.0).all()
    assert (series.fidelity == Fidelity.DYNAMIC).all()
    assert (series.status == Status.OK).all()
    assert (series.evaluations[1:] == 2).all()  # of the law, and a probe of the beginning


def test_depth_and_rate_are_those_prescribed():
    depth = 3e-4 + 4e-4 * np.sin(47.0 * TIME)
    series = led().run(TIME, NONE, 700.0 + NONE, pressed(depth))
    assert signed(series) == pytest.approx(depth, abs=1e-17)  # rounding of heights of 34 mm
    assert series.penetration_rate[1:] == pytest.approx(
        rates(depth), abs=1e-13
    )  # that rounding over a tick
    # The rounding of the rate times the dashpot (5e-10 N), that of the depth times the slope (7e-12 N): with room
    assert series.contact_force[1:] == pytest.approx(
        kelvin_voigt(depth[1:], rates(depth)), abs=1e-8
    )
    assert (series.load == 700.0).all()  # passed on, not used
    assert series.contact_state.min() == ContactState.SEPARATED
    assert (series.evaluations[depth <= 0.0] == 0).all()


@pytest.mark.parametrize("name", ["hunt_crossley", "flores"])
def test_the_speed_at_touch_is_remembered(name):
    speed, knee = 0.035, led(name, least_impact_speed=1e-3)
    depth = np.minimum(
        speed * (TIME - 0.0105), 4e-4
    )  # comes down, touches between two ticks, and stops
    series = knee.run(TIME, NONE, NONE, pressed(depth))
    expected = [
        knee.law.force_at(*row, speed)[0] for row in zip(depth[1:], rates(depth), strict=True)
    ]
    inside = depth[1:] > 0.0
    # Rounding of heights of 34 mm over a tick (1e-14 m/s) against 0.035 m/s, and of the depth against 1e-5 m
    assert series.contact_force[1:][inside] == pytest.approx(np.array(expected)[inside], rel=1e-9)
    # Each touch has its own: (tick, the tick that touched): 0.03 m/s first, then 0.06 m/s, which lasts.
    depth, time = np.array([-1e-4, 2e-4, -1e-4, 5e-4, 6e-4]), 1e-2 * np.arange(5.0)
    series, speeds = (
        knee.run(time, np.zeros(5), np.zeros(5), pressed(depth)),
        np.diff(depth) / np.diff(time),
    )
    for tick, touched in ((1, 1), (3, 3), (4, 3)):
        force = knee.law.force_at(depth[tick], speeds[tick - 1], speeds[touched - 1])[0]
        # Rounding of heights of 34 mm over a tick (7e-16 m/s) against 0.01 m/s, and of the depth against 0.2 mm
        assert series.contact_force[tick] == pytest.approx(force, rel=1e-11)
    assert (series.contact_force[[0, 2]] == 0.0).all()


@pytest.mark.parametrize("name", ["hunt_crossley", "flores"])
def test_the_impact_speed_is_that_of_the_touch_and_not_of_the_ticks_end(name):
    # An ellipse that turns over its plateau by 0.5 rad in one tick: its surface comes down ever more slowly.
    geometry, begin, turn, duration = ellipse(320), 0.6, 0.5, 0.02
    height = geometry.support(0.8)[0]
    touch = brentq(
        lambda angle: geometry.support(angle)[0] - height, begin, begin + turn, xtol=1e-15
    )
    speed, rate = (geometry.support(angle)[1] * turn / duration for angle in (touch, begin + turn))
    assert rate < 0.8 * speed
    contact_law = law(name, least_impact_speed=1e-3)
    knee = model(contact_law, geometry=geometry, height_prescribed=True)
    end = knee.run([0.0, duration], [begin, begin + turn], [0.0, 0.0], [height, height])[-1]
    expected = contact_law.force_at(geometry.support(begin + turn)[0] - height, rate, speed)[0]
    assert end.contact_force == pytest.approx(
        expected, rel=1e-11
    )  # h to 1e-16 m at a depth of 1 mm


def held(knee, angle, depth):
    """Heights at which a knee has depths."""
    rows = zip(angle.tolist(), depth.tolist(), strict=True)
    return np.array([height_at(knee.constants.surfaces, *row, 0.05) for row in rows])


def test_a_contact_that_ends_and_begins_within_a_tick_is_found():
    """The same motion in 256 parts, in whose ticks hardly any contact ends and begins."""
    parts, found = 256, 0
    time = 0.0256 * np.arange(12.0)
    fine = np.linspace(0.0, time[-1], 11 * parts + 1)
    for seed in range(20):
        random, pair = np.random.default_rng((49, seed)), PAIRS[tuple(PAIRS)[seed % 5]]()
        name = ("hunt_crossley", "flores")[seed % 2]
        knee = led(name, least_impact_speed=1e-3, pair=pair, compiled=True)
        angle, depth = random.uniform(0.0, 1.0, 12), 10.0 ** random.uniform(-7.0, -3.5, 12)
        motion = angle, 0.0 * time, held(knee, angle, depth)
        few = knee.run(time, *motion)
        many = knee.run(fine, *(np.interp(fine, time, column) for column in motion))
        part = many[::parts]
        # Each knows the speed where its own motion is cut, whose rounding differs.
        assert few.contact_force == pytest.approx(part.contact_force, rel=1e-6, abs=1e-6)
        assert (few.status == Status.OK).all()
        gaps = many.gap[:-1].reshape(11, parts).max(axis=1)
        found += int(((gaps > 0.0) & (np.diff(few.contact_force > 0.0) == 0)).sum())
    assert found > 40


def test_a_search_that_reaches_the_budget_is_said_until_the_next_touch():
    """A circle that skims over the plane as fast as no knee, 1 pm deep."""
    knee = led("hunt_crossley", budget=100)
    depth = np.array([1e-12, 1e-12, 1e-4, 1e-4, -1e-4, 1e-4])
    angle = np.array([0.0, 2.0, 2.0, 2.0, 2.0, 2.0])
    series = knee.run(0.1 * np.arange(6.0), angle, 0.0 * angle, pressed(depth))
    assert (series.status & Status.NOT_CONVERGED != 0).tolist() == [
        False,
        *3 * [True],
        *2 * [False],
    ]
    assert series.evaluations.max() == knee.budget
    free = replace(knee, law=law("kelvin_voigt"))
    assert (
        free.run(0.1 * np.arange(6.0), angle, 0.0 * angle, pressed(depth)).status & 8 == 0
    ).all()


def test_the_drives_are_not_mixed_up():
    heights, knee = pressed(3e-4 + 4e-4 * np.sin(47.0 * TIME)), led("gonthier")
    rows = zip(TIME.tolist(), NONE.tolist(), NONE.tolist(), heights.tolist(), strict=True)
    stream = knee.stream()
    assert (
        b"".join(stream.tick(*row).tobytes() for row in rows)
        == knee.run(TIME, NONE, NONE, heights).tobytes()
    )
    force = model(law("hertz"))
    for run, words in (
        (lambda: knee.run(TIME, NONE, NONE), "drive displacement needs a femoral_height"),
        (lambda: force.run(TIME, NONE, NONE, heights), "drive force takes no femoral_height"),
        (lambda: knee.stream().tick(0.0, 0.0, 0.0), "drive displacement needs a femoral_height"),
        (lambda: force.stream().tick(0.0, 0.0, 0.0, 0.03), "drive force takes no femoral_height"),
        (lambda: knee.stream().tick(0.0, 0.0, 0.0, math.nan), "finite"),
        (
            lambda: knee.stream().tick(0.0, 0.0, 0.0, 34.0),
            "femoral_height must not exceed 10 rad, 1e\\+06 N and 10 m, got 0.0, 0.0, 34.0",
        ),
        (lambda: knee.run(TIME, NONE, NONE, heights[:-1]), "equal length"),
        (lambda: knee.run(TIME, NONE, NONE, 1e3 * heights), "must not exceed"),
    ):
        with pytest.raises(ValueError, match=words):
            run()
