"""Cycles, totals and what is gathered of a run, against known signals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from knee_contact_ros.model.types import FLAT, Rows, blank
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, LOAD_PEAK, TOE_OFF
from knee_contact_ros.streams.strides import Span
from knee_contact_ros.tools.report.cycles import COLUMNS, CURVES, PERCENT, Mean, curves, measured
from knee_contact_ros.tools.report.gather import Gathered
from knee_contact_ros.tools.report.peaks import stance_peaks
from knee_contact_ros.tools.report.totals import BUCKETS, Course, Errors
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, Samples, walking

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def answers(samples: Samples, **columns: np.ndarray) -> Rows:
    """Answers to angle and load: a contact force that is the load, and other fields as given, else 0."""
    stamps, angle, load = samples
    known = {"stamp": stamps, "flexion_angle": angle, "load": load, "contact_force": load,
             "penetration_depth": 1e-6 * load, "contact_state": np.ones(len(stamps)), **columns}  # fmt: skip
    rows = blank(len(stamps))
    for name, column in known.items():
        rows.view(FLAT)[name] = column
    return rows


MODEL = build_model(Parameters())


def gathered(whole: Rows, size: int) -> Gathered:
    """The same in blocks of a size."""
    found = Gathered(BODY_WEIGHT, model=MODEL)
    for begin in range(0, len(whole), size):
        found.add(whole[begin : begin + size])
    return found.finish()


def samples_of(time: np.ndarray, force: np.ndarray, state: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Stamps and values of a signal over time [s]; flexion in rad is time itself."""
    values = np.zeros((len(time), len(COLUMNS)))
    values[:, COLUMNS.index("flexion_angle")] = time
    values[:, COLUMNS.index("contact_force")] = force
    values[:, COLUMNS.index("penetration_depth")] = 1e-6 * force
    values[:, COLUMNS.index("sliding_velocity")] = -0.03
    values[:, COLUMNS.index("contact_state")] = 1.0 if state is None else state
    return START + np.round(SECOND * time).astype(np.int64), values


def span(start: float, toe_off: float, end: float) -> Span:
    """Times [s]."""
    return Span(*(START + round(SECOND * time) for time in (start, toe_off, end)))


def test_a_cycle_is_brought_to_percent() -> None:
    time = np.arange(0.0, 3.0, 0.0037)
    stamps, values = samples_of(time, 100.0 * time)
    found = curves(stamps, values, span(0.5, 1.25, 1.75))
    expected = 0.5 + 1.25 * PERCENT / 100.0
    # Stamps are rounded to 1 ns, at 0.5 ns a point; the signal is straight, so that interpolation adds nothing else
    assert found[:, CURVES.index("flexion_angle")] == pytest.approx(expected, abs=2e-9)
    assert found[:, CURVES.index("contact_force")] == pytest.approx(100.0 * expected, abs=2e-7)


def test_the_impulse_is_the_integral() -> None:
    time = np.arange(0.0, 2.0, 0.001)
    stamps, values = samples_of(time, 1000.0 * np.sin(math.pi * time) ** 2)
    cycle = measured(stamps, values, span(0.3, 0.9, 1.5))

    def integral(end: float) -> float:
        return 1000.0 * (0.5 * end - math.sin(2.0 * math.pi * end) / (4.0 * math.pi))

    # Trapezoids: h^2/12 (b - a) max f'' = 1e-6 / 12 x 1.2 x 2 pi^2 x 1000 = 2e-3
    assert cycle.impulse == pytest.approx(integral(1.5) - integral(0.3), abs=2e-3)
    assert cycle.stance_impulse == pytest.approx(integral(0.9) - integral(0.3), abs=2e-3)
    assert cycle.largest_force == pytest.approx(1000.0, rel=1e-5)  # half a step, 0.5 ms, off the peak: (pi 0.0005)^2
    assert cycle.largest_force_at == pytest.approx(100.0 * (0.5 - 0.3) / 1.2, abs=0.1)  # a step of 0.08 %
    assert cycle.largest_depth == pytest.approx(1e-3, rel=1e-5)


def test_times_in_bone_and_apart_and_the_loading_rate() -> None:
    time = np.arange(0.0, 2.0, 0.01)
    force = np.interp(time, [0.0, 0.52, 0.62, 2.0], [100.0, 100.0, 600.0, 600.0])  # 5000 N/s
    state = np.select([(time > 0.705) & (time < 0.905), (time > 1.205) & (time < 1.305)], [2.0, 0.0], 1.0)
    cycle = measured(*samples_of(time, force, state), span(0.5, 1.2, 1.6))
    assert cycle.bone_time == pytest.approx(0.2, abs=1e-9)  # ticks from 0.71 to 0.90 s: steps of whole 10 ms
    assert cycle.apart_time == pytest.approx(0.1, abs=1e-9)
    assert math.isclose(cycle.sliding_distance, 0.03 * (1.1 - 0.1), rel_tol=1e-9)  # the cycle but for 0.1 s apart
    assert cycle.largest_sliding_velocity == 0.03
    assert cycle.loading_rate == pytest.approx(5000.0, rel=1e-6)  # rounding of stamps: 1 ns in 20 ms


def test_mean_and_deviation_are_those_of_numpy() -> None:
    random = np.random.default_rng(0)
    series = random.normal(5.0, 2.0, (20, len(PERCENT), len(CURVES)))
    mean = Mean()
    assert mean.deviation is None
    for one in series:
        mean.add(one)
    # Rounding of 20 sums
    np.testing.assert_allclose(mean.mean, series.mean(axis=0), rtol=1e-13)
    np.testing.assert_allclose(mean.deviation, series.std(axis=0, ddof=1), rtol=1e-12)
    assert len(mean.first) == 12


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
def test_walking_has_its_cycles(rate: float) -> None:
    found = gathered(answers(walking(rate, 30.0)), 8192)
    assert found.mean.count == len(found.cycles) == found.strikes == 24  # from 0.08 to 29.72 s
    durations = [cycle.span.duration for cycle in found.cycles]
    assert durations == pytest.approx([STRIDE] * 24, abs=0.002)  # straight lines of 10 ms between samples
    assert np.mean([cycle.span.stance for cycle in found.cycles]) == pytest.approx(
        64.0, abs=0.5
    )  # ground reaction: 64.1
    halves = [peak.which for peak in stance_peaks(found) if peak.cycle is not None]
    assert halves == ["first", "second"] * 24
    first = [peak.percent for peak in stance_peaks(found) if peak.which == "first"]
    assert first == pytest.approx(
        [100.0 * (0.785 - 0.618) / STRIDE] * 24, abs=1.0
    )  # a heel strike is off by 4 ms: 0.3 %


@pytest.mark.parametrize("size", [1, 37, 400, 100_000])
def test_blocks_make_no_difference(size: int) -> None:
    stamps, angle, load = walking(200.0, 12.0)
    stamps[1500:] -= 2 * SECOND  # goes back
    stamps[2000:] += 3 * SECOND  # leaves a gap
    state = np.where(load > 900.0, 2.0, np.where(load < 130.0, 0.0, 1.0))
    whole = answers((stamps, angle, load), contact_state=state, error_estimate=1e-9 * load, fidelity=0.0 * load + 2.0,
                    status=np.where(load > 1200.0, 9.0, 0.0), force_error_estimate=1e-4 * load,
                    sliding_velocity=np.sin(load), evaluations=0.0 * load + 3.0)  # fmt: skip
    once, again = gathered(whole, len(stamps)), gathered(whole, size)
    assert again.moments == once.moments
    assert again.cycles == once.cycles
    np.testing.assert_array_equal(again.mean.mean, once.mean.mean)
    for name in ("ticks", "first_stamp", "last_stamp", "flagged", "levels", "evaluations", "largest_force"):
        assert getattr(again.totals, name) == getattr(once.totals, name)
    for errors in ("depth_errors", "force_errors"):
        for name in ("largest", "median", "known"):
            assert getattr(getattr(again.totals, errors), name) == getattr(getattr(once.totals, errors), name)
    for name in ("bone_time", "apart_time", "time", "longest_apart"):  # rounding of sums in another order
        assert getattr(again.totals, name) == pytest.approx(getattr(once.totals, name), rel=1e-12)
    np.testing.assert_array_equal(again.course.highest, once.course.highest)
    assert once.totals.flagged == {"STALE_INPUT": np.count_nonzero(load > 1200.0),
                                   "NOT_CONVERGED": np.count_nonzero(load > 1200.0)}  # fmt: skip
    assert once.totals.depth_errors.median == pytest.approx(np.median(1e-9 * load), rel=0.03)  # bins of 2.3 %
    assert once.totals.time == pytest.approx(2397 * 0.005, abs=1e-6)  # 2399 steps, without the one back and the gap


def test_errors_that_are_no_number_bound_nothing() -> None:
    errors = Errors()
    errors.add(np.full(3, np.nan))
    assert (errors.known, errors.largest, errors.median) == (False, math.inf, math.inf)
    errors.add(np.array([0.0, 1e-6, 3e-6, 2e-6]))
    assert (errors.known, errors.largest) == (True, math.inf)
    assert errors.median == pytest.approx(3e-6, rel=0.03)  # the fourth of seven; bins of 2.3 %


def test_no_cycle_goes_across_a_gap_or_a_reset() -> None:
    stamps, angle, load = walking(200.0, 12.0)
    whole = len(gathered(answers((stamps, angle, load)), 8192).cycles)
    for shift in (-2 * SECOND, 3 * SECOND):
        broken = stamps + np.where(np.arange(len(stamps)) >= 1290, shift, 0)
        found = gathered(answers((broken, angle, load)), 8192)
        assert len(found.cycles) == whole - 1
        elapsed = [moment.elapsed for moment in found.moments]
        assert elapsed == sorted(elapsed)


def test_standing_has_totals_and_no_cycles() -> None:
    time = np.arange(2000) / 200.0
    standing = (np.round(1e9 * time).astype(np.int64), 0.0 * time + 0.1, 0.0 * time + 400.0)
    found = gathered(answers(standing), 512)
    assert found.cycles == found.moments == []
    assert found.totals.ticks == 2000
    assert found.totals.largest_force == 400.0


def test_moments_have_the_contact_of_their_tick() -> None:
    samples = walking(200.0, 5.0)
    ticks = np.arange(len(samples[0]))
    found = gathered(answers(samples, error_estimate=1e-9 * ticks, force_error_estimate=1e-3 * ticks), 100)
    kinds = {moment.event.kind for moment in found.moments}
    assert kinds == {HEEL_STRIKE, TOE_OFF, LOAD_PEAK}
    for moment in found.moments:
        tick = int(np.searchsorted(samples[0], moment.event.stamp, "right")) - 1
        assert moment.load == moment.contact_force == samples[2][tick]
        assert (moment.depth_error, moment.force_error) == (1e-9 * tick, 1e-3 * tick)
        assert moment.elapsed == pytest.approx((moment.event.stamp - samples[0][0]) / 1e9, abs=1e-9)


@pytest.mark.parametrize("number", [100, 30_000])
def test_a_course_keeps_extremes(number: int) -> None:
    random = np.random.default_rng(0)
    elapsed = np.arange(number, dtype=np.int64) * 1_000_000
    values = random.standard_normal((number, 2))
    course = Course(2)
    for begin in range(0, number, 777):
        course.add(elapsed[begin : begin + 777], values[begin : begin + 777])
    time, lowest, highest = course.lines()
    assert len(time) <= BUCKETS
    buckets = elapsed // course.width
    begins = elapsed[np.unique(buckets, return_index=True)[1]]
    assert time == pytest.approx(1e-9 * begins)  # when something came, and not the middle of a bucket
    for bucket, low, high in zip(np.unique(buckets), lowest, highest, strict=True):
        np.testing.assert_array_equal(low, values[buckets == bucket].min(axis=0))
        np.testing.assert_array_equal(high, values[buckets == bucket].max(axis=0))
