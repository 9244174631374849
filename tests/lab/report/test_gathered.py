"""What is gathered of a run, against known signals."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.report import summary
from knee_contact_ros.lab.report.gathered import ANSWER_FIELDS, CYCLE_PERCENT, Gathered
from knee_contact_ros.lab.report.runs import ReportRun
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.watch import Doubts
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, walking

SECOND = 1_000_000_000


def gathered(samples, **columns):
    """Of answers to angle and load: a contact force that is the load, and other fields as given, else 0."""
    stamps, angle, load = samples
    known = {
        "stamp": stamps,
        "flexion_angle": angle,
        "load": load,
        "contact_force": load,
        "penetration_depth": 1e-6 * load,
        "contact_state": np.ones(len(stamps)),
        **columns,
    }
    zero = np.zeros(len(stamps))
    return Gathered({name: known.get(name, zero) for name in ANSWER_FIELDS}, BODY_WEIGHT, Doubts())


def summary_of(of):
    return summary(
        ReportRun("a", "a", Path("a"), "/knee_contact", Parameters(), "", Counter(), (), of)
    )


def test_walking_has_its_cycles():
    rate = 100.0
    stamps, angle, load = walking(rate, 30.0)
    state = np.where(load > 900.0, 2.0, np.where(load < 130.0, 0.0, 1.0))
    found = gathered(
        (stamps, angle, load), contact_state=state, sliding_velocity=np.full(len(load), -0.03)
    )
    assert len(found.spans) == found.strikes == 24  # from 0.08 to 29.72 s
    strides = found.strides
    # Durations: straight lines of 10 ms between samples. Stance: of the ground reaction 64.1 %
    assert strides["duration_s"].to_numpy() == pytest.approx(STRIDE, abs=0.002)
    assert strides["stance_percent"].mean() == pytest.approx(64.0, abs=0.5)
    assert found.peaks.dropna(subset="cycle")["peak"].tolist() == ["first", "second"] * 24
    first = found.peaks[found.peaks["peak"] == "first"]["gait_cycle_percent"]
    assert first.to_numpy() == pytest.approx(
        100.0 * (0.785 - 0.618) / STRIDE, abs=1.0
    )  # a strike is off by 4 ms
    time = (stamps - stamps[0]) / SECOND
    for span, curves, (_, numbers) in zip(
        found.spans, found.curves["load"], strides.iterrows(), strict=True
    ):
        begin, toe_off, end = (
            (stamp - int(stamps[0])) / SECOND for stamp in (span.start, span.toe_off, span.end)
        )
        at = begin + (end - begin) * CYCLE_PERCENT / 100.0
        # Stamps are rounded to 1 ns, of a load that changes by some 100 kN/s at most
        assert curves == pytest.approx(np.interp(at, time, load), abs=1e-3)
        for name, until in (("impulse_N_s", end), ("stance_impulse_N_s", toe_off)):
            fine = np.unique(
                np.concatenate([[begin, until], time[(time > begin) & (time < until)]])
            )
            force = np.interp(fine, time, load)
            assert numbers[name] == pytest.approx(
                np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(fine)), rel=1e-6
            )
        inside = (time > begin) & (time <= end)
        for name, each in (("bone_contact_s", 2.0), ("lifted_off_s", 0.0)):
            lasted = (state[inside] == each).sum() / rate
            assert numbers[name] == pytest.approx(lasted, abs=1.0 / rate)
        touching = numbers["duration_s"] - numbers["lifted_off_s"]
        assert numbers["sliding_distance_mm"] == pytest.approx(30.0 * touching, rel=1e-9)
        assert numbers["largest_sliding_velocity_mm_per_s"] == 30.0
        assert numbers["largest_contact_force_N"] == pytest.approx(load[inside].max(), rel=1e-9)
        assert numbers["largest_penetration_depth_mm"] == pytest.approx(
            1e-3 * load[inside].max(), rel=1e-9
        )
    assert strides["largest_peak_pressure_MPa"].isna().all()  # the model is not known
    ramp = np.interp(
        (stamps - found.spans[0].start) / SECOND, [0.0, 0.1, 0.2], [100.0, 100.0, 600.0]
    )  # 5000 N/s
    steep = gathered((stamps, angle, load), contact_force=ramp).strides["loading_rate_N_per_s"]
    assert steep[0] == pytest.approx(5000.0, rel=1e-6)  # stamps: 1 ns in 20 ms


def test_totals_leave_out_gaps_and_stamps_that_went_back():
    stamps, angle, load = walking(200.0, 12.0)
    stamps[1500:] -= 2 * SECOND
    stamps[2000:] += 3 * SECOND
    flags = np.where(load > 1200.0, 9.0, 0.0)
    found = gathered(
        (stamps, angle, load),
        error_estimate=1e-9 * load,
        status=flags,
        force_error_estimate=np.where(np.arange(len(load)) == 7, np.nan, 1.0),
    )
    number = np.count_nonzero(load > 1200.0)
    assert summary_of(found)["ticks not converged"] == str(number)
    assert summary_of(found)["ticks flagged otherwise"] == f"{number} ({number} × STALE_INPUT)"
    assert found.seconds.sum() == pytest.approx(
        2397 * 0.005, abs=1e-6
    )  # 2399 steps, without the one back and the gap
    assert found.elapsed[1500] == found.elapsed[1499]  # as if it had gone on at once
    median, largest = 1e3 * np.median(load), 1e3 * load.max()
    assert (
        summary_of(found)["error bound of the depth"]
        == f"{1e-6 * largest:.2g} µm at most, {1e-6 * median:.2g} µm median"
    )
    assert summary_of(found)["error bound of the contact force"] == "no bound at most, 1 N median"
