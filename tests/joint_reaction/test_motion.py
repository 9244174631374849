"""The motion filter: a parabola by least squares through the angles in a window, and through nothing else."""

from __future__ import annotations

from itertools import accumulate
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.joint_reaction.leg import (
    FEWEST,
    MOST,
    STANDING,
    STILL,
    UNKNOWN,
    Joints,
    Motion,
    MotionFilter,
    Turning,
)
from tests.joint_reaction.examples import EPOCH, MS, walking

WINDOW = 0.05
SPAN = 50 * MS
Samples = list[tuple[int, Joints]]
ROUNDINGS = 1e-11
"""Of an angle of 1 rad: 1e-16 by the condition of a parabola on stamps in one window (524, a Hilbert matrix; of a few
stamps that lie anyhow some more), by some tens of additions. A rate has it by the window, an acceleration twice."""
steps = st.lists(st.integers(2 * MS, 12 * MS), min_size=15, max_size=40)


def along(samples: Samples, window: float = WINDOW) -> list[Motion]:
    """At every sample of a stream."""
    told = MotionFilter(window)
    return [told.see(*sample) for sample in samples]


def last(samples: Samples) -> Motion:
    return along(samples)[-1]


def within(samples: Samples, span: int = SPAN) -> Samples:
    """Those that a window sees from the last one on."""
    return [sample for sample in samples if samples[-1][0] - sample[0] <= span]


def near(expected: Motion, window: float = WINDOW) -> tuple[Any, ...]:
    """What equals it but for rounding."""
    allowed = (ROUNDINGS / window, ROUNDINGS / window**2)
    return tuple(
        tuple(pytest.approx(value, abs=most) for value, most in zip(one, allowed, strict=True)) for one in expected
    )


def fitted(samples: Samples) -> Motion:
    """NumPy's fit, about the middle of the stamps."""
    times = np.array([1e-9 * (stamp - samples[0][0]) for stamp, _ in samples])
    times -= times.mean()
    scale = float(np.abs(times).max())
    turnings = []
    for angles in np.array([joints[:3] for _, joints in samples]).T:
        square, slope, _ = np.polyfit(times / scale, angles, 2).tolist()
        turnings.append(Turning(slope / scale, 2.0 * square / scale**2))
    return Motion(*turnings)


def stamps_of(gaps: list[int]) -> list[int]:
    return list(accumulate(gaps, initial=EPOCH))


@given(gaps=steps, draw=st.integers(0, 2**32).map(Random))
def test_a_parabola_is_told_exactly_whatever_its_stamps(gaps: list[int], draw: Random) -> None:
    """The slope is that at the mean of the stamps in the window."""
    stamps, curves = stamps_of(gaps), [[draw.uniform(-1.0, 1.0) for _ in range(3)] for _ in range(3)]

    def at(time: float) -> Joints:
        return Joints(*[a + b * time + 0.5 * c * time * time for a, b, c in curves])

    samples = [(stamp, at(1e-9 * (stamp - EPOCH))) for stamp in stamps]
    middle = float(np.mean([1e-9 * (stamp - EPOCH) for stamp, _ in within(samples)]))
    expected = Motion(*[Turning(b + c * middle, c) for _, b, c in curves])
    if len(within(samples)) >= 6:  # of fewer that lie anyhow the condition may be far worse
        assert last(samples) == near(expected)


@given(gaps=steps, draw=st.integers(0, 2**32).map(Random))
def test_it_is_the_fit_that_numpy_makes(gaps: list[int], draw: Random) -> None:
    samples = [(stamp, Joints(*[draw.uniform(-1.0, 1.0) for _ in range(3)])) for stamp in stamps_of(gaps)]
    if len(within(samples)) >= 6:
        assert last(samples) == near(fitted(within(samples)))


@pytest.mark.parametrize("window", [0.02, 0.05, 0.2])
@pytest.mark.parametrize("shaken", [0.0, 0.4])
def test_it_is_numpys_fit_all_along_a_stream(window: float, shaken: float) -> None:
    samples = walking(700, MS, shaken)
    found = along(samples, window)
    for number in range(round(1e3 * window) + 1, 700, 23):
        assert found[number] == near(fitted(within(samples[: number + 1], round(1e9 * window))), window)


def test_of_a_cubic_both_are_half_a_window_late() -> None:
    """The slope is a cubic's mean one: with u from the middle, the sum of u^4 by that of u^2 more."""
    stamps = [EPOCH + number * MS for number in range(51)]
    times = [1e-9 * (stamp - EPOCH) for stamp in stamps]
    found = last([(stamp, Joints(100.0 * time**3, 0.0, 0.0)) for stamp, time in zip(stamps, times, strict=True)])
    middle, apart = 0.025, [time - 0.025 for time in times]
    bias = sum(u**4 for u in apart) / sum(u**2 for u in apart)
    assert found.flexion.acceleration == pytest.approx(600.0 * middle, abs=ROUNDINGS / WINDOW**2)
    assert found.flexion.rate == pytest.approx(300.0 * middle**2 + 100.0 * bias, abs=ROUNDINGS / WINDOW)


def test_a_window_of_twice_the_length_has_a_sixth_of_the_noise() -> None:
    """2^2.5 = 5.7 times less of a curvature; 4000 values that overlap tell it to a tenth or so."""
    draw = Random(5)
    samples = [(EPOCH + number * MS, Joints(draw.gauss(0.0, 1e-3), 0.0, 0.0)) for number in range(4000)]
    short, long = (
        np.std([motion.flexion.acceleration for motion in along(samples, window)[200:]]) for window in (0.05, 0.1)
    )
    assert short / long == pytest.approx(2.0**2.5, rel=0.15)


@pytest.mark.parametrize(("step", "shaken"), [(MS, 0.0), (MS, 0.9), (7 * MS, 0.5), (MS // 40, 0.0), (MS // 40, 0.9)])
def test_bits_depend_on_what_is_in_the_window_alone(step: int, shaken: float) -> None:
    """However long the stream has run: no sum goes on from one stamp to the next."""
    samples = walking(8000, step, shaken)
    found = along(samples)
    assert found[-1] != STILL
    for number in range(4000, 8000, 97):
        assert last(within(samples[: number + 1])) == found[number]


def test_bits_do_not_depend_on_how_far_the_angles_went_before() -> None:
    samples, told = walking(200), MotionFilter(WINDOW)
    for number in range(1000):
        told.see(EPOCH - 2000 * MS + number * MS, Joints(1e300, -1e300, 1e17))
    found = [told.see(*sample) for sample in samples]
    assert found[-1] == last(samples)


def test_it_forgets() -> None:
    samples, told = walking(200), MotionFilter(WINDOW)
    for sample in samples:
        told.see(*sample)
    told.forget()
    again, fresh = [(stamp - 3000 * MS, joints) for stamp, joints in samples], MotionFilter(WINDOW)
    assert [told.see(*sample) for sample in again] == [fresh.see(*sample) for sample in again]


def test_it_is_still_until_half_a_window_is_known() -> None:
    assert [motion == STILL for motion in along(walking(100))] == [True] * 25 + [False] * 75


def test_it_is_still_until_a_few_angles_are_known() -> None:
    assert [motion == STILL for motion in along(walking(8, 12 * MS))] == [True] * (FEWEST - 1) + [False] * 5
    assert all(motion == STILL for motion in along(walking(30, 20 * MS)))  # three in a window


def test_after_a_pause_it_begins_anew() -> None:
    samples = walking(100)
    later = [(stamp + 60 * 1000 * MS, joints) for stamp, joints in samples]
    assert along([*samples, *later])[100:] == along(later)


def test_without_a_window_joints_are_still() -> None:
    assert set(along(walking(100), 0.0)) == {STILL}


@pytest.mark.parametrize("missing", [("hip",), ("ankle",), ("hip", "ankle")])
def test_a_joint_that_is_not_measured_stands_and_harms_no_other(missing: tuple[str, ...]) -> None:
    samples = walking(200)
    without = [(stamp, joints._replace(**dict.fromkeys(missing, UNKNOWN))) for stamp, joints in samples]
    standing = dict.fromkeys(missing, STANDING)
    assert along(without) == [motion._replace(**standing) for motion in along(samples)]


def test_one_angle_that_is_missing_is_forgotten_with_its_window() -> None:
    samples = walking(200)
    with_a_hole = [*samples]
    with_a_hole[100] = (samples[100][0], samples[100][1]._replace(hip=UNKNOWN))
    found, expected = along(with_a_hole), along(samples)
    seen = [number for number in range(200) if found[number] != expected[number]]
    assert seen == list(range(100, 151))
    assert all(found[number] == expected[number]._replace(hip=STANDING) for number in seen)


def test_of_a_quick_stream_the_last_angle_of_a_cell_counts() -> None:
    """At 40 kHz 2000 are in a window. A parabola is told exactly, and its slope no cell later than by all of them."""
    step = MS // 40
    curved = [(stamp, Joints(0.5 * time**2, 0.0, 0.0)) for stamp, time in
              ((EPOCH + number * step, 1e-9 * number * step) for number in range(4001))]  # fmt: skip
    found = last(curved).flexion
    assert found.acceleration == pytest.approx(1.0, abs=ROUNDINGS / WINDOW**2)
    assert found.rate == pytest.approx(0.1 - 0.5 * WINDOW, abs=WINDOW / (MOST - 1))
    flat = [(stamp, Joints(0.0, 0.0, 0.0)) for stamp, _ in curved]
    assert last([*flat[:-1], (flat[-1][0], Joints(1e-3, 0.0, 0.0))]).flexion.acceleration > 0.0


@pytest.mark.parametrize("step", [1, 7, 1003, MS // 4])
def test_any_rate_has_room(step: int) -> None:
    """Down to a nanosecond apart; rows go to the front in time."""
    told = MotionFilter(1e-9 * step * (MOST + 250))
    for number in range(5 * MOST):
        told.see(EPOCH + 17 + number * step, Joints(0.3, 0.2, 0.1))
        assert len(told._held) <= MOST
        assert told._end <= len(told._rows)
