"""`knee-contact calibrate` without a measured load: a made walker's faulty sensors are found, small faults are kept."""

import math

import numpy as np
import pytest

from knee_contact_ros import calibrate, estimate_load
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.lab.calibrate.walk import DEVIATIONS, KEPT, MEAN_FLEXION
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import LOAD_INPUTS, MESSAGE_TYPES
from tests import ROOT
from tests.helpers.commands import run
from tests.helpers.walking import ANGLES, FORCE

MASS, STANCE, SWING, STEP = 70.0, 0.7, 0.42, 0.005
WEIGHT = MASS * 9.80665
STAND, STRIDES = 3.0, 5
ZERO, CLOCK, BODY = NAMES = ("knee.offset", "pairing.angle_delay", "person.mass")
FREE = " ".join(f"--free {name}" for name in NAMES)
ANGLE_TOLERANCE, CLOCK_TOLERANCE = 0.01, 0.002
"""[rad], [s]: delays are tried in steps of 1 ms, and angles every 5 ms are interpolated to forces"""


def flexion(time):
    """The mean knee from 0 s on, which stands at 0 before."""
    part = time % (STANCE + SWING)
    stance = np.interp(part / STANCE, np.linspace(0, 1, 21), MEAN_FLEXION.stance)
    swing = np.interp((part - STANCE) / SWING, np.linspace(0, 1, 9), MEAN_FLEXION.swing)
    return np.where(time < 0, 0.0, np.where(part < STANCE, stance, swing))


def force(time, stands_on):
    """Newtons upward; over a stride half the weight on average."""
    part = (time % (STANCE + SWING)) / STANCE
    shape = np.where(part < 1, 1 + 0.2 * np.cos(4 * math.pi * (part - 0.25)), 0.0)
    return WEIGHT * np.where(time < 0, stands_on, 0.5 * (STANCE + SWING) / STANCE * shape)


def walk(path, *, stands_on=0.0, strides=STRIDES, offset=0.0, late=0.0, sign=1.0):
    """A bag of a stand that bears a part of the weight, and strides, by sensors that are off and late."""
    times = np.arange(-STAND if stands_on else 0.0, strides * (STANCE + SWING) + 0.3, STEP)
    with BagWriter(path, alone=True) as writer:
        for name in LOAD_INPUTS:
            writer.add_topic(f"/{name}", MESSAGE_TYPES[name])
        rows = zip(
            times, sign * flexion(times - late) + offset, force(times, stands_on), strict=True
        )
        for time, angle, up in rows:
            stamp = round((time + 10.0) * 1e9)
            joints = JointState(stamp, "", ("knee",), (float(angle),), (), ())
            wrench = WrenchStamped(stamp, "plate", (0.0, float(up), 0.0), (0.0, 0.0, 0.0))
            writer.write_message(ANGLES, stamp, encode_joint_state(joints))
            writer.write_message(FORCE, stamp, encode_wrench_stamped(wrench))
    return path


def found_in(tmp_path, options=""):
    output = tmp_path / "me.yaml"
    bag = tmp_path / "walk.mcap"
    assert run(f"calibrate {bag} {FREE} --output {output} {options}") == 0
    return load_parameters([str(output)], LoadParameters)


def loads_of(bag, params):
    """Estimated loads [N] of the four strides, without the ends of the recording where angles are missing."""
    found = estimate_load(bag, params)
    inner = np.arange(0.1, 4 * (STANCE + SWING), STEP) + 10.0
    return np.interp(inner, found["stamp"] * 1e-9, found["axial_force"])


@pytest.mark.parametrize("late", [-0.03, 0.03])
def test_large_faults_are_found_and_the_estimate_is_that_of_right_sensors(tmp_path, late):
    mass = 1.3 * MASS
    bag = walk(tmp_path / "walk.mcap", offset=0.35, late=late)
    found = found_in(tmp_path, f"-p person.mass:={mass}")
    assert found.knee.offset == pytest.approx(-0.35, abs=ANGLE_TOLERANCE)
    assert found.pairing.angle_delay == pytest.approx(late, abs=CLOCK_TOLERANCE)
    assert found.person.mass == pytest.approx(MASS, rel=0.01)  # a sample of the stance's 140
    right = walk(tmp_path / "right.mcap")
    each = (right, {BODY: MASS}), (bag, str(tmp_path / "me.yaml")), (bag, {BODY: mass})
    truth, loads, faulty = (loads_of(*one) for one in each)
    # 0.01 rad, 2 ms and 1 % make a fiftieth of the weight; the faults more than ten times as much
    assert np.sqrt(np.mean((loads - truth) ** 2)) < 0.02 * WEIGHT
    assert np.sqrt(np.mean((faulty - truth) ** 2)) > 0.2 * WEIGHT


def test_what_people_differ_by_is_kept_as_given(tmp_path, capsys):
    walk(tmp_path / "walk.mcap", offset=math.radians(5.0), late=0.01)
    given = "-p person.mass:=73.5 -p knee.offset:=0.01 -p pairing.angle_delay:=0.002"
    found = found_in(tmp_path, given)
    assert (found.knee.offset, found.pairing.angle_delay, found.person.mass) == (0.01, 0.002, 73.5)
    assert capsys.readouterr().out.count("so it is kept as given") == 3


def test_a_stand_tells_a_small_zero_and_one_on_this_leg_the_mass(tmp_path, capsys):
    walk(tmp_path / "walk.mcap", stands_on=0.5, offset=math.radians(5.0))
    found = found_in(tmp_path, "-p person.mass:=73.5")
    assert found.knee.offset == pytest.approx(
        -math.radians(5.0), abs=1e-6
    )  # nine digits are written
    assert found.person.mass == 73.5  # both legs stand
    assert "5.0 deg in the straightest stand, which is 0" in capsys.readouterr().out
    (tmp_path / "walk.mcap").unlink()
    walk(tmp_path / "walk.mcap", stands_on=1.0)
    found = found_in(tmp_path, "-p person.mass:=73.5 --overwrite")
    assert found.person.mass == pytest.approx(MASS, rel=1e-6)


def test_intervals_are_what_people_differ_by(tmp_path):
    bag = walk(tmp_path / "walk.mcap", offset=0.35, late=0.03)
    found = calibrate(bag, None, [ZERO, CLOCK], level=0.6827)  # of one standard deviation
    for name, interval in found.intervals.items():
        assert interval.high - found.values[name] == pytest.approx(DEVIATIONS[name], rel=1e-3)
        assert abs(found.values[name]) > KEPT * DEVIATIONS[name]
    assert found.residuals == {}


CASES = [
    (
        {"strides": 0},
        "",
        "whole strides: 0, stands: 0, which do not tell knee.offset; level walking",
    ),
    ({"strides": 0, "stands_on": 0.5}, "", "which do not tell pairing.angle_delay"),
    ({"sign": -1.0}, "", "does not bend as in level walking (r -"),
    ({"late": 0.17}, "", "fit best at the longest delay tried, 0.15 s"),
    ({}, "-p ground.components:=net", "ground.components net is no ground force"),
    ({}, "--free person.tone", "it is not a parameter that can be fitted to a walk without"),
]


@pytest.mark.parametrize(("made", "options", "reason"), CASES)
def test_what_is_no_walk_is_refused_in_one_line(tmp_path, capsys, made, options, reason):
    bag = walk(tmp_path / "walk.mcap", **made)
    assert run(f"calibrate {bag} {FREE} --output {tmp_path}/me.yaml {options}") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert list(tmp_path.iterdir()) == [bag]


def test_a_value_beyond_the_given_range_is_refused(tmp_path, capsys):
    bag = walk(tmp_path / "walk.mcap", offset=0.5)
    output = f"--output {tmp_path}/me.yaml"
    assert run(f"calibrate {bag} --free knee.offset=-0.1:0.1 {output}") == 2
    assert " rad, allowed: -0.1 to 0.1; in walking it bends" in capsys.readouterr().err


def test_a_measured_walk_of_one_more_person_is_within_what_people_differ_by():
    """gait2354's walk, which made none of the constants."""
    found = calibrate(
        ROOT / "bags" / "gait2354_right_sensors",
        ["load/gait2354", {ZERO: 0.35, CLOCK: -0.05}],
        [ZERO, CLOCK],
    )
    for name, value in found.values.items():
        assert abs(value) <= KEPT * DEVIATIONS[name]
