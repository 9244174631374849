"""What is gathered of a run, against known signals."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.report.figures import over_cycle
from knee_contact_ros.lab.report.page import summary
from knee_contact_ros.lab.report.runs import BUCKETS, CURVES, FIELDS, PERCENT, Gathered, Run
from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, LOAD_PEAK, TOE_OFF
from knee_contact_ros.streams.watch import Doubts
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, Samples, walking

SECOND = 1_000_000_000


def gathered(samples: Samples, **columns: np.ndarray) -> Gathered:
    """Of answers to angle and load: a contact force that is the load, and other fields as given, else 0."""
    stamps, angle, load = samples
    known = {"stamp": stamps, "flexion_angle": angle, "load": load, "contact_force": load,
             "penetration_depth": 1e-6 * load, "contact_state": np.ones(len(stamps)), **columns}  # fmt: skip
    zero = np.zeros(len(stamps))
    return Gathered({name: known.get(name, zero) for name in FIELDS}, BODY_WEIGHT, Doubts())


def told(of: Gathered) -> dict[str, str]:
    return summary(Run("a", "a", Path("a"), "/knee_contact", Parameters(), "", Counter(), (), of))


@pytest.mark.parametrize("rate", [100.0, 200.0, 1000.0])
def test_walking_has_its_cycles(rate: float) -> None:
    stamps, angle, load = walking(rate, 30.0)
    state = np.where(load > 900.0, 2.0, np.where(load < 130.0, 0.0, 1.0))
    found = gathered((stamps, angle, load), contact_state=state, sliding_velocity=np.full(len(load), -0.03))
    assert len(found.cycles) == found.strikes == 24  # from 0.08 to 29.72 s
    # Durations: straight lines of 10 ms between samples. Stance: of the ground reaction 64.1 %
    assert [cycle.span.duration for cycle in found.cycles] == pytest.approx([STRIDE] * 24, abs=0.002)
    assert np.mean([cycle.span.stance for cycle in found.cycles]) == pytest.approx(64.0, abs=0.5)
    assert [peak.which for peak in found.peaks if peak.cycle is not None] == ["first", "second"] * 24
    first = [peak.percent for peak in found.peaks if peak.which == "first"]
    assert first == pytest.approx([100.0 * (0.785 - 0.618) / STRIDE] * 24, abs=1.0)  # a strike is off by 4 ms: 0.3 %
    time = (stamps - stamps[0]) / SECOND
    for cycle in found.cycles:
        span, numbers = cycle.span, cycle.numbers
        begin, toe_off, end = ((stamp - int(stamps[0])) / SECOND for stamp in (span.start, span.toe_off, span.end))
        at = begin + (end - begin) * PERCENT / 100.0
        # Stamps are rounded to 1 ns, of a load that changes by some 100 kN/s at most
        assert cycle.curves[:, CURVES.index("load")] == pytest.approx(np.interp(at, time, load), abs=1e-3)
        for name, until in (("impulse_N_s", end), ("stance_impulse_N_s", toe_off)):
            fine = np.unique(np.concatenate([[begin, until], time[(time > begin) & (time < until)]]))
            force = np.interp(fine, time, load)
            assert numbers[name] == pytest.approx(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(fine)), rel=1e-6)
        inside = (time > begin) & (time <= end)
        assert numbers["bone_contact_s"] == pytest.approx((state[inside] == 2.0).sum() / rate, abs=1.0 / rate)
        assert numbers["lifted_off_s"] == pytest.approx((state[inside] == 0.0).sum() / rate, abs=1.0 / rate)
        touching = numbers["duration_s"] - numbers["lifted_off_s"]
        assert numbers["sliding_distance_mm"] == pytest.approx(30.0 * touching, rel=1e-9)
        assert numbers["largest_sliding_velocity_mm_per_s"] == 30.0
        assert numbers["largest_contact_force_N"] == pytest.approx(load[inside].max(), rel=1e-9)
        assert numbers["largest_penetration_depth_mm"] == pytest.approx(1e-3 * load[inside].max(), rel=1e-9)
        assert math.isnan(numbers["largest_peak_pressure_MPa"])  # the model is not known
    curves = [cycle.curves for cycle in found.cycles]
    np.testing.assert_array_equal(found.mean, np.mean(curves, axis=0))
    np.testing.assert_array_equal(found.deviation, np.std(curves, axis=0, ddof=1))


def test_the_loading_rate_is_the_steepest_rise_of_early_stance() -> None:
    stamps, angle, load = walking(1000.0, 5.0)
    strike = gathered((stamps, angle, load)).cycles[0].span.start
    force = np.interp((stamps - strike) / SECOND, [0.0, 0.1, 0.2], [100.0, 100.0, 600.0])  # 5000 N/s
    (cycle, *_) = gathered((stamps, angle, load), contact_force=force).cycles
    assert cycle.numbers["loading_rate_N_per_s"] == pytest.approx(5000.0, rel=1e-6)  # stamps: 1 ns in 20 ms


def test_totals_leave_out_gaps_and_stamps_that_went_back() -> None:
    stamps, angle, load = walking(200.0, 12.0)
    stamps[1500:] -= 2 * SECOND
    stamps[2000:] += 3 * SECOND
    flags = np.where(load > 1200.0, 9.0, 0.0)
    found = gathered((stamps, angle, load), error_estimate=1e-9 * load, status=flags,
                     force_error_estimate=np.where(np.arange(len(load)) == 7, np.nan, 1.0))  # fmt: skip
    assert found.flagged == dict.fromkeys(("STALE_INPUT", "NOT_CONVERGED"), np.count_nonzero(load > 1200.0))
    assert found.flagged_otherwise == np.count_nonzero(load > 1200.0)
    assert found.time == pytest.approx(2397 * 0.005, abs=1e-6)  # 2399 steps, without the one back and the gap
    assert found.elapsed[1500] == found.elapsed[1499]  # as if it had gone on at once
    median, largest = 1e3 * np.median(load), 1e3 * load.max()
    assert told(found)["error bound of the depth"] == f"{1e-6 * largest:.2g} µm at most, {1e-6 * median:.2g} µm median"
    assert told(found)["error bound of the contact force"] == "no bound at most, 1 N median"
    none = gathered((stamps, angle, load), force_error_estimate=np.full(len(load), np.nan))
    assert told(none)["error bound of the contact force"] == "not in this recording"


def test_moments_have_the_contact_of_their_tick() -> None:
    samples = walking(200.0, 5.0)
    ticks = np.arange(len(samples[0]))
    found = gathered(samples, error_estimate=1e-9 * ticks, force_error_estimate=1e-3 * ticks)
    assert {moment.event.kind for moment in found.moments} == {HEEL_STRIKE, TOE_OFF, LOAD_PEAK}
    for moment in found.moments:
        tick = int(np.searchsorted(samples[0], moment.event.stamp, "right")) - 1
        assert moment.load == moment.contact_force == samples[2][tick]
        assert (moment.depth_error, moment.force_error) == (1e-9 * tick, 1e-3 * tick)
        assert moment.elapsed == pytest.approx((moment.event.stamp - samples[0][0]) / 1e9, abs=1e-9)


@pytest.mark.parametrize("number", [100, 30_000])
def test_a_course_keeps_extremes(number: int) -> None:
    stamps = 1_000_000 * np.arange(number, dtype=np.int64)
    values = np.random.default_rng(0).standard_normal(number)
    width, time, ranges = gathered((stamps, values, 0.0 * values)).course()
    assert len(time) <= BUCKETS
    buckets = stamps // width
    assert time == pytest.approx(1e-9 * stamps[np.unique(buckets, return_index=True)[1]])
    for bucket, low, high in zip(np.unique(buckets), *ranges["flexion_angle"], strict=True):
        assert (low, high) == (values[buckets == bucket].min(), values[buckets == bucket].max())


def test_what_an_old_recording_lacks_draws_no_empty_figure() -> None:
    stamps, angle, load = walking(200.0, 5.0)
    unknown = np.full(len(stamps), np.nan)
    columns = dict.fromkeys((*FIELDS, *SPREAD), unknown) | dict.fromkeys(("contact_state", "status"), 0.0 * load)
    columns |= {"stamp": stamps, "flexion_angle": angle, "load": load, "contact_force": load, "fidelity": 0.0 * load}
    of = Gathered(columns | {"penetration_depth": 1e-6 * load}, BODY_WEIGHT, Doubts())
    run = Run("a", "a", Path("a"), "/knee_contact", Parameters(), "", Counter(), (), of)
    assert [each.name for each in over_cycle([run], [run])] == ["contact_force", "depth", "flexion"]
