"""Gait events from angle and load, against what the ground reaction says of the shipped gaits."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.streams.gait_events import (
    HEEL_STRIKE,
    LOAD_PEAK,
    TOE_OFF,
    GaitEvents,
)
from knee_contact_ros.streams.topics import stamp_to_ns
from knee_contact_ros.system.files import share_folder

BODY_WEIGHT = 737.068
Samples = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]
GROUND_REACTION = {
    "right": {HEEL_STRIKE: [0.618, 1.853], TOE_OFF: [1.410]},
    "left": {HEEL_STRIKE: [1.247, 2.460], TOE_OFF: [0.788, 2.018]},
}
"""[s] at which the vertical ground reaction passes 20 N; bags/README.md"""
LARGEST_ERROR = 0.005
"""[s] measured 4.1 ms"""
STRIDE = 1.235
"""[s] of the right leg, from one heel strike to the next"""


def gait(side):
    bag = read_bag(share_folder() / "bags" / f"gait2354_{side}", INPUT_TYPES)
    angles = {
        stamp_to_ns(m.message.header.stamp): m.message.position[0]
        for m in bag
        if m.topic == "/joint_states"
    }
    forces = {
        stamp_to_ns(m.message.header.stamp): m.message.wrench.force.y
        for m in bag
        if m.topic != "/joint_states"
    }
    assert angles.keys() == forces.keys()
    stamps = sorted(angles)
    return (
        np.array(stamps),
        np.array([angles[stamp] for stamp in stamps]),
        np.array([-0.5 * forces[stamp] for stamp in stamps]),
    )


RIGHT, LEFT = gait("right"), gait("left")


def walking(rate, seconds):
    """The right leg's gait cycle over and over; its last 0.1 s goes over into the first one's beginning."""
    time, (stamps, angle, load) = np.arange(round(rate * seconds)) / rate, RIGHT
    phase, recorded, begin = (
        time % STRIDE,
        stamps / 1e9,
        GROUND_REACTION["right"][HEEL_STRIKE][0] - 0.08,
    )
    again = np.clip((phase - STRIDE + 0.08) / 0.08, 0.0, 1.0)
    signals = [
        (1.0 - again) * np.interp(begin + phase, recorded, signal)
        + again * np.interp(np.maximum(begin + phase - STRIDE, recorded[0]), recorded, signal)
        for signal in (angle, load)
    ]
    return (
        np.round(1e9 * time).astype(np.int64) + 1_700_000_000_000_000_000,
        signals[0],
        signals[1],
    )


def found(samples, cuts=()):
    """Events of samples that come in batches."""
    finder, events = GaitEvents(BODY_WEIGHT), []
    edges = [0, *sorted(cuts), len(samples[0])]
    for begin, end in pairwise(edges):
        events += finder.add_samples(
            samples[0][begin:end], samples[1][begin:end], samples[2][begin:end]
        )
    return events + finder.finish_events()


def times(events, kind):
    return [event.stamp / 1e9 for event in sorted(events) if event.kind == kind]


@pytest.mark.parametrize(("side", "samples"), [("right", RIGHT), ("left", LEFT)])
@pytest.mark.parametrize("kind", [HEEL_STRIKE, TOE_OFF])
@pytest.mark.parametrize("share", [1.0, 2.0], ids=["half of the load", "all of it"])
def test_events_of_the_shipped_gait_are_those_of_the_ground_reaction(side, samples, kind, share):
    stamps, angle, load = samples
    assert times(found((stamps, angle, share * load)), kind) == pytest.approx(
        GROUND_REACTION[side][kind], abs=LARGEST_ERROR
    )


def test_load_peaks_are_samples_and_events_say_what_they_are():
    events = [event for event in found(RIGHT) if event.kind == LOAD_PEAK]
    assert times(events, LOAD_PEAK) == [0.785, 1.205, 2.015, 2.430]
    assert [event.text for event in events][2] == "load peak 1.81 BW (1337.7 N)"
    assert times(found(LEFT), LOAD_PEAK) == [0.6, 1.395, 1.835]
    texts = {event.text for event in found(RIGHT)}
    assert {"toe-off at 49° of flexion", "heel strike at 2° of flexion"} <= texts


def test_a_maximum_in_a_pause_is_no_peak():
    """The filter finds it 55 ms before the pause of 0.3 s ends, where the load is only a little higher."""
    times = np.r_[np.arange(0.0, 2.001, 0.005), np.arange(2.3, 4.5, 0.005)]
    load = 1000.0 - 2000.0 * np.maximum(2.0 - times, 0.0)
    load = np.where(times > 2.2, 1000.1 - 2000.0 * (times - 2.3), load)
    stamps = np.round(1e9 * times).astype(np.int64)
    assert found((stamps, np.zeros(len(times)), load)) == []


@pytest.mark.parametrize("top", [1.5, 0.95, 0.8])
def test_both_humps_of_a_lightly_loaded_compartment_are_peaks(top):
    stamps, angle, load = walking(200.0, 8.0)
    finder = GaitEvents(BODY_WEIGHT)
    events = finder.add_samples(stamps, angle, top * BODY_WEIGHT / load.max() * load)
    peaks = times(events + finder.finish_events(), LOAD_PEAK)
    assert len(peaks) == 13  # of 6.5 strides


@pytest.mark.parametrize("rate", [37.0, 100.0, 200.0, 1000.0])
def test_every_step_is_found_at_any_rate(rate):
    events = found(walking(rate, 60.0))
    # 60 s are 48.6 strides: the last one has come to its second peak of stance, and not to its toe-off.
    strikes, steps = times(events, HEEL_STRIKE), times(events, TOE_OFF)
    assert len(strikes) == len(steps) + 1 == 49
    # Smoothing, and at 37 Hz straight lines of 27 ms between samples; the seam is at no event
    assert np.diff(strikes) == pytest.approx(STRIDE, abs=0.012)
    assert np.diff(steps) == pytest.approx(STRIDE, abs=0.012)
    assert len(times(events, LOAD_PEAK)) == 2 * 49


@given(
    st.lists(st.integers(0, 1500), max_size=30),
    st.integers(0, 3),
    st.sampled_from([100.0, 333.0, 1000.0]),
)
def test_batches_make_no_difference(cuts, noise, rate):
    stamps, angle, load = walking(rate, 1500 / rate)
    random = np.random.default_rng(noise)
    angle = angle + np.radians(noise) * random.standard_normal(len(angle))
    load = load + 30.0 * noise * random.standard_normal(len(load))
    stamps[700:] -= 100_000_000 * (noise == 2)  # goes back
    stamps[900:] += 2_000_000_000 * (noise == 3)  # leaves a gap
    assert sorted(found((stamps, angle, load), tuple(cuts))) == sorted(
        found((stamps, angle, load))
    )


def stopped(before, after, tilt, noise):
    """Gait of a knee that reaches a stop at 5° `before` landing [s] and leaves it `after` it; it tilts [rad/s]."""
    (stamps, angle, load), strike = walking(200.0, 12.35), 0.084
    time = (stamps - stamps[0]) / 1e9
    since = (time - strike + 0.5 * STRIDE) % STRIDE - 0.5 * STRIDE
    sooner = np.where(
        (since > -0.5) & (since <= -before), -0.5 + (since + 0.5) * 0.45 / (0.5 - before), since
    )
    bent = np.interp((sooner + strike) % STRIDE, time[:247], angle[:247], period=STRIDE)
    flat = np.radians(5.0) + tilt * (since + before)
    angle = np.where((since > -before) & (since < after), flat, np.maximum(bent, np.radians(5.0)))
    return stamps, angle + noise * np.random.default_rng(0).standard_normal(len(time)), load


@pytest.mark.parametrize("before", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("after", [0.0, 0.1, 0.3])
@pytest.mark.parametrize(("tilt", "noise"), [(0.0, 0.0), (0.03, 0.0), (-0.03, 0.0), (0.0, 0.005)])
def test_the_load_finds_heel_strikes_that_a_stop_hides(before, after, tilt, noise):
    samples = stopped(before, after, tilt, noise)
    events = found(samples)
    strikes = np.array(times(events, HEEL_STRIKE)) - samples[0][0] / 1e9
    # The seam of the repeated cycle is just before landing: it comes 15 ms early by the load
    assert strikes == pytest.approx(0.084 + STRIDE * np.arange(1, 10), abs=0.05)
    assert len(times(events, TOE_OFF)) == 10
    assert sorted(found(samples, tuple(range(0, 2470, 7)))) == sorted(events)


@pytest.mark.parametrize("largest", [35.0, 21.0, 17.0, 14.0, 10.0])
def test_the_load_finds_the_steps_of_a_knee_that_hardly_bends(largest):
    stamps, angle, load = walking(200.0, 12.35)
    samples = stamps, angle * np.radians(largest) / angle.max(), load
    events = found(samples)
    strikes, steps = (
        np.array(times(events, kind)) - stamps[0] / 1e9 for kind in (HEEL_STRIKE, TOE_OFF)
    )
    # By the load a heel strike is 20 ms early at the seam, as above, and a toe-off 13 ms late: it is 60 ms in the mean
    assert strikes == pytest.approx(0.084 + STRIDE * np.arange(1, 10), abs=0.025)
    assert steps == pytest.approx(0.874 + STRIDE * np.arange(10), abs=0.02)
    assert sorted(found(samples, tuple(range(0, 2470, 7)))) == sorted(events)


@pytest.mark.parametrize("after", [0.6, 0.75, 0.85])
def test_a_knee_that_is_locked_until_it_swings_leaves_the_ground_by_the_load(after):
    samples = stopped(0.1, after, 0.0, 0.0)
    steps = np.array(times(found(samples), TOE_OFF)) - samples[0][0] / 1e9
    assert steps == pytest.approx(0.874 + STRIDE * np.arange(10), abs=0.02)


@pytest.mark.parametrize("seed", range(40))
def test_swaying_has_no_toe_off(seed):
    random = np.random.default_rng(seed)
    turn, press, phase = random.uniform(1.2, 7.5, 3)
    angle = np.radians(12.0 + random.uniform(3.0, 10.0) * np.sin(turn * TIME + phase))
    load = 400.0 + random.uniform(50.0, 330.0) * np.sin((turn if seed % 3 else press) * TIME)
    assert times(found((STAMPS, angle, load)), TOE_OFF) == []


@pytest.mark.parametrize("seed", range(5))
def test_noise_does_not_multiply_events(seed):
    random = np.random.default_rng(seed)
    stamps, angle, load = walking(200.0, 20.0)
    clean = found((stamps, angle, load))
    noisy = found(
        (
            stamps,
            angle + np.radians(1.0) * random.standard_normal(len(angle)),
            load + 30.0 * random.standard_normal(len(load)),
        )
    )
    for kind, error in (
        (HEEL_STRIKE, 0.015),
        (TOE_OFF, 0.04),
    ):  # five times the spread that 200 seeds have
        inner, expected = (
            [time for time in times(events, kind) if 0.5 < time - stamps[0] / 1e9 < 19.5]
            for events in (noisy, clean)
        )
        assert inner == pytest.approx(expected, abs=error)
    assert abs(len(times(noisy, LOAD_PEAK)) - len(times(clean, LOAD_PEAK))) <= 1  # that at the end


def still(seconds=30.0, rate=1000.0):
    time = np.arange(round(seconds * rate)) / rate
    return np.round(1e9 * time).astype(np.int64), time


STAMPS, TIME = still()


def noise(size):
    return size * np.random.default_rng(0).standard_normal(len(TIME))


NO_GAIT = {
    "nothing moves": (0.0 * TIME + 0.1, 0.0 * TIME + 900.0),
    "standing": (0.05 + noise(np.radians(1.0)), 370.0 + noise(30.0)),
    "on one leg": (0.05 + noise(np.radians(1.0)), 950.0 + noise(30.0)),
    "swaying": (np.radians(5.0 + 4.0 * np.sin(2.0 * TIME)), 400.0 + 200.0 * np.sin(3.0 * TIME)),
    "squats": (
        np.radians(45.0 - 50.0 * np.cos(2.0 * TIME)).clip(0.0),
        900.0 - 500.0 * np.cos(2.0 * TIME),
    ),
    "leg held out": (np.radians(45.0 - 50.0 * np.cos(2.0 * TIME)).clip(0.0), 60.0 + 0.0 * TIME),
    "leg pulled up": (np.radians(45.0 - 50.0 * np.cos(2.0 * TIME)).clip(0.0), -60.0 + 0.0 * TIME),
    "kicking in the air": (np.radians(45.0 - 45.0 * np.cos(6.0 * TIME)), np.abs(noise(60.0))),
}


@pytest.mark.parametrize("name", NO_GAIT)
def test_no_gait_has_no_events(name):
    assert found((STAMPS, *NO_GAIT[name])) == []


def test_rising_from_a_chair_is_no_step():
    turn = np.cos(2.0 * TIME)
    angle = np.radians(45.0 - 50.0 * turn).clip(0.05)
    assert {each.kind for each in found((STAMPS, angle, 50.0 + 600.0 * (turn > -0.5)))} <= {
        LOAD_PEAK
    }
