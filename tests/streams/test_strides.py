"""Strides, and the way that the femur slides in them."""

import math

import numpy as np
import pytest

from knee_contact_ros.model.ringing import Ringing
from knee_contact_ros.model.types import ContactState, Status
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF, GaitEvent
from knee_contact_ros.streams.strides import (
    Stride,
    Strides,
    loading_rate,
    sliding_distance,
    spans,
    strides_of,
)
from tests.helpers.scenes import RADIUS, law, model
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, walking

SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("strikes", "toe_offs", "found"),
    [
        ((1.0, 2.2, 3.4), (1.7, 2.9), [(1.0, 2.2), (2.2, 3.4)]),
        ((1.0, 2.2, 3.4), (1.7,), [(1.0, 2.2)]),  # no toe-off in the second one
        ((1.0, 2.4), (1.7, 2.2), []),  # a heel strike was missed
        ((1.0, 4.0), (1.7,), []),  # stood still
        ((1.0, 1.3), (1.2,), []),
        ((1.0,), (1.7,), []),
    ],
)
def test_a_stride_has_one_toe_off_and_a_plausible_duration(strikes, toe_offs, found):
    stamps = [[round(SECOND * time) for time in times] for times in (strikes, toe_offs)]
    assert [(span.start / SECOND, span.end / SECOND) for span in spans(*stamps)] == found


def test_the_distance_is_the_integral_of_the_speed():
    time = np.arange(0.0, 2.0, 1e-3)
    velocity, touching = 0.1 * np.cos(math.pi * time), np.ones(len(time))
    # Straight lines between ticks: h^2/12 (b - a) max|v''| = 1e-6 / 12 x 2 x 0.1 pi^2 = 2e-7
    assert sliding_distance(time, velocity, touching) == pytest.approx(
        4.0 * 0.1 / math.pi - 1e-4, abs=1e-6
    )
    apart = np.where((time > 0.5) & (time <= 1.5), 0.0, 2.0)
    assert sliding_distance(time, velocity, apart) == pytest.approx(
        2.0 * 0.1 / math.pi - 1e-4, abs=1e-6
    )
    # A speed that turns round between two ticks: two triangles
    assert sliding_distance(np.arange(2.0), np.array([1.0, -1.0]), np.full(2, 2.0)) == 0.5
    assert math.isnan(sliding_distance(time, np.where(time > 1.0, np.nan, velocity), touching))
    assert sliding_distance(time[:1], velocity[:1], touching[:1]) == 0.0


@pytest.mark.parametrize("stance", [0.03, 0.041, 0.6])
def test_the_loading_rate_is_the_steepest_rise_over_20_ms(stance):
    rng = np.random.default_rng(1)
    for _ in range(20):
        time = np.linspace(0.0, stance, 100)
        time[1:-1] += rng.uniform(-0.3, 0.3, 98) * time[1]
        force = rng.normal(0.0, 1000.0, len(time))
        begins = np.linspace(0.0, max(stance / 2.0 - 0.02, 0.0), 20_001)
        rises = np.interp(begins + 0.02, time, force) - np.interp(begins, time, force)
        steepest = max(rises.max(), 0.0) / 0.02 if stance > 0.04 else 0.0
        found = loading_rate(time, force)
        # A grid of at most 14 us misses the maximum by at most a step times the slopes at both ends of the 20 ms
        slope = 2.0 * np.abs(np.diff(force) / np.diff(time)).max()
        assert steepest - 1e-6 <= found <= steepest + slope * (begins[1] - begins[0]) / 0.02


def test_the_sliding_of_a_walking_knee():
    """A circle on a fixed axis slides by its radius times all turns, to and fro; where it is apart, not at all."""
    stamps, angle, load = walking(200.0, 8.0)
    series = model(law("kelvin_voigt"), level="quasi_static").run(
        (stamps - stamps[0]) / SECOND, angle, load
    )
    found = strides_of(series, BODY_WEIGHT)
    assert len(found) == 6
    flagged = series.copy()
    flagged["status"] = np.where(np.arange(len(series)) == len(series) // 2, Status.STALE_INPUT, 0)
    usable = [each.usable for each in strides_of(flagged, BODY_WEIGHT)]
    assert (usable.count(True), usable.count(False)) == (5, 1)
    for each in found:
        assert each.span.duration == pytest.approx(
            STRIDE, abs=0.002
        )  # straight lines of 10 ms between samples
        inside = (series["stamp"] >= each.span.start) & (series["stamp"] <= each.span.end)
        # The rate of a tick is that of the interval before it, half a tick of 5 ms late; and the stride's ends
        assert each.sliding_distance == pytest.approx(
            RADIUS * np.abs(np.diff(angle[inside])).sum(), rel=0.01
        )
    assert strides_of(series[:100], BODY_WEIGHT) == []
    series.contact_state = ContactState.SEPARATED
    assert [each.sliding_distance for each in strides_of(series, BODY_WEIGHT)] == [0.0] * 6


def test_a_stride_is_usable_only_if_the_answers_on_either_side_of_its_ends_are():
    stamps, angle, load = walking(200.0, 6.0)
    series = model(law("kelvin_voigt"), level="quasi_static").run(
        (stamps - stamps[0]) / SECOND, angle, load
    )
    first, *_, last = strides_of(series, BODY_WEIGHT)
    behind = int(np.searchsorted(series["stamp"], last.span.end))
    before = int(np.searchsorted(series["stamp"], first.span.start)) - 1
    for at, stride, step in ((behind, -1, 1), (before, 0, -1)):
        for tick, usable in ((at, False), (at + step, True)):
            flagged = series.copy()
            flagged["status"] = np.where(np.arange(len(series)) == tick, Status.IMPLAUSIBLE, 0)
            assert strides_of(flagged, BODY_WEIGHT)[stride].usable is usable


def test_a_run_that_ends_at_a_heel_strike_has_usable_strides():
    stamps, angle, load = walking(200.0, 3.8)
    series = model(law("kelvin_voigt"), level="quasi_static").run(
        (stamps - stamps[0]) / SECOND, angle, load
    )
    series["status"] = 0
    (*_, last) = strides_of(series, BODY_WEIGHT)
    assert last.usable
    assert last.span.end <= series["stamp"][-1]


@pytest.mark.parametrize("size", [1, 37, 10_000])
def test_known_events_make_the_strides_up_to_50_ms_beyond_the_run(size):
    """The first lies 49 ms before the run. At the ends values are held; a second run has the events of its times."""
    time = np.arange(0.0, 2.0, 0.005)
    series = model(law("kelvin_voigt"), level="quasi_static").run(
        time, np.full(len(time), 0.2), np.full(len(time), 700.0)
    )
    events = [(0.4, TOE_OFF), (0.001, HEEL_STRIKE), (1.0, HEEL_STRIKE), (1.6, TOE_OFF)]
    events += [(time[-1] + 0.049, HEEL_STRIKE), (time[-1] + 0.06, HEEL_STRIKE)]
    shift = round(0.05 * SECOND)
    series["stamp"] += shift
    known = [GaitEvent(round(at * SECOND), kind, kind) for at, kind in events]
    known[4:] = [each._replace(stamp=each.stamp + shift) for each in known[4:]]
    stream, found = Strides(BODY_WEIGHT, known), list[Stride]()
    for _ in range(2):
        for begin in range(0, len(series), size):
            found += stream.add_answers(series[begin : begin + size])
        found += stream.finish_strides()
    spans_found = [(each.span.start / SECOND, each.span.end / SECOND) for each in found]
    assert spans_found == 2 * [(0.001, 1.0), (1.0, pytest.approx(time[-1] + 0.099))]
    assert [each.impulse for each in found[:2]] == pytest.approx(
        [700.0 * (end - start) for start, end in spans_found[:2]], rel=1e-3
    )


@pytest.mark.parametrize("size", [1, 37, 10_000])
def test_strides_do_not_depend_on_batches_and_are_those_of_the_whole(size):
    stamps, angle, load = walking(200.0, 8.0)
    knee = model(law("hertz"))
    series = knee.run((stamps - stamps[0]) / SECOND, angle, load)
    twice = np.concatenate([series, series])  # time goes back: a run of its own
    stream, found, late = Strides(BODY_WEIGHT), list[Stride](), list[float]()
    rings = Ringing(knee)
    for begin in range(0, len(twice), size):
        batch = twice[begin : begin + size]
        new = stream.add_answers(batch, rings.add_answers(batch))
        found += new
        late += [(batch["stamp"][-1] - each.span.end) / SECOND for each in new if size == 1]
    found += stream.finish_strides()
    whole = Strides(BODY_WEIGHT)
    rings = knee.ringing(series)
    assert found == 2 * (whole.add_answers(series, rings) + whole.finish_strides())
    assert all(each.ringing > 1.0 for each in found)  # hertz has no dashpot
    assert all(each.peak_depth > 0.0 for each in found)
    assert [each.peak_force for each in found[:6]] == pytest.approx(
        6 * [max(series.contact_force)], rel=0.1
    )
    if (
        size == 1
    ):  # what a controller waits for: all but the last one, which the end of the run makes certain
        assert max(late[:5]) < 0.5
