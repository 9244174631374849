"""Estimates sample by sample, and their bytes against those of the message."""

from __future__ import annotations

import math
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from knee_contact_ros.joint_reaction.estimator import LEVELS, PACKING, Estimate, Estimator, Level, Trust
from knee_contact_ros.joint_reaction.leg import UNKNOWN, Ground, Joints, MotionFilter
from knee_contact_ros.joint_reaction.muscles import Person
from knee_contact_ros.model.types import UNUSABLE, Status
from tests import ROOT
from tests.joint_reaction.examples import EPOCH, LEG, MS, PERSON, angles, ground, walking
from tests.joint_reaction.lagrange import Chain

TYPE = "knee_contact_ros/msg/LoadEstimate"
WINDOW = 0.05
UNCALIBRATED = Trust(calibrated=False)
STANCE = Ground((20.0, 700.0, -15.0), (3.0, 2.0, 40.0))
NOT_MEASURED = (UNKNOWN, UNKNOWN, UNKNOWN)
each_level = pytest.mark.parametrize("level", LEVELS)
draws = st.integers(0, 2**32).map(Random)


@pytest.fixture(scope="module")
def store() -> Any:
    """Messages of rosbags, ours among them."""
    store, path = get_typestore(Stores.ROS2_JAZZY), ROOT / "msg" / "LoadEstimate.msg"
    store.register(get_types_from_msg(path.read_text(encoding="utf-8"), TYPE))
    return store


class Seeing:
    """An estimator that is told the joints at every stamp, with what it sees of their motion."""

    def __init__(self, estimator: Estimator, window: float) -> None:
        self.estimator, self.motion = estimator, MotionFilter(window)

    def at(self, stamp: int, joints: Joints, sensed: Ground, status: int = 0) -> Estimate:
        return self.estimator.at(joints, self.motion.see(stamp, joints), sensed, status)


def estimator(level: str, person: Person = PERSON, window: float = WINDOW, trust: Trust = UNCALIBRATED) -> Seeing:
    return Seeing(Estimator(level, person, trust), window)


def at_once(level: str, joints: Joints, sensed: Ground, person: Person = PERSON) -> Estimate:
    return estimator(level, person).at(EPOCH, joints, sensed)


def same(one: Estimate, other: Estimate) -> bool:
    """To the bit; what is not a number is like itself."""
    return PACKING.pack(*one) == PACKING.pack(*other)


def test_fields_are_those_of_the_message(store: Any) -> None:
    (header, _), *fields = store.fielddefs[TYPE][1]
    assert header == "header"
    assert tuple(name for name, _ in fields) == Estimate._fields
    codes = {"float64": "d", "uint8": "B", "bool": "?"}
    assert PACKING.format == "<" + "".join(codes[detail[0]] for _, (_, detail) in fields)


@given(
    estimate=st.builds(Estimate, *[st.floats()] * 11, st.integers(0, 255), st.booleans(), st.integers(0, 255)),
    frame=st.text(st.characters(codec="ascii", exclude_characters="\x00"), max_size=9),
)
def test_bytes_are_those_that_rosbags_writes(store: Any, estimate: Estimate, frame: str) -> None:
    time, header = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    message = store.types[TYPE](header=header(stamp=time(sec=1, nanosec=2), frame_id=frame), **estimate._asdict())
    data = bytes(store.serialize_cdr(message, TYPE))
    begin = 4 + -(-(12 + len(frame) + 1) // 8) * 8  # behind 4 B, from which it counts: stamp, length, text, a zero
    assert data[begin:].rstrip(b"\x00") == PACKING.pack(*estimate).rstrip(b"\x00")  # rosbags may pad behind
    assert len(data) - begin in range(PACKING.size, PACKING.size + 4)


def test_constants_are_those_of_the_message(store: Any) -> None:
    constants = {name: value for name, _, value in store.fielddefs[TYPE][0]}
    levels = {level.name: level.value for level in Level}
    assert {name: constants[name] for name in levels} == levels
    bits = {bit.name: bit.value for bit in [Status.OK, *Status] if bit.name in constants}
    assert constants.keys() == {*levels, *bits, "UNUSABLE"}
    assert {name: constants[name] for name in bits} == bits
    assert constants["UNUSABLE"] == UNUSABLE & sum(bits.values())


@each_level
def test_bits_are_the_same_whatever_came_before_the_window(level: str) -> None:
    samples, draw, sensed = walking(600, MS, 0.3), Random(1), {}
    one = estimator(level)
    for number in range(300):
        one.at(EPOCH - (500 - number) * MS, angles(draw), ground(draw))
    for stamp, joints in samples:
        sensed[stamp] = ground(draw)
        found = one.at(stamp, joints, sensed[stamp])
    other = estimator(level)
    for stamp, joints in samples:
        if samples[-1][0] - stamp <= round(1e9 * WINDOW):
            expected = other.at(stamp, joints, sensed[stamp])
    assert same(found, expected)


@pytest.mark.parametrize(("level", "number"), [("ground_force", 0), ("knee_moment", 1), ("ankle_moment", 2)])
def test_what_is_passed_through(level: str, number: int) -> None:
    found = estimator(level, trust=Trust(calibrated=True)).at(EPOCH, Joints(0.4, 0.2, 0.1, 12.5, 3.0), STANCE, 17)
    assert (found.flexion_angle, found.assistance) == (0.4, 12.5)
    assert (found.level, found.calibrated, found.status) == (number, True, 17)
    assert at_once(level, Joints(0.4, 0.2, 0.1), STANCE)[-3:] == (number, False, 0)


@each_level
def test_the_standard_deviation_is_the_levels_or_what_was_given(level: str) -> None:
    weight, error = 75.0 * 9.80665, LEVELS[level].error

    def told(trust: Trust) -> tuple[float, float]:
        found = estimator(level, trust=trust).at(EPOCH, Joints(0.4, 0.2, 0.1), STANCE)
        return found.axial_force, found.standard_deviation

    rounding = 1e-15  # of products in another order
    for calibrated, measured in ((False, error.uncalibrated), (True, error.calibrated)):
        axial, deviation = told(Trust(calibrated))
        expected = math.sqrt((measured.floor * weight) ** 2 + (measured.part * axial) ** 2)
        assert deviation == pytest.approx(expected, rel=4 * rounding)
        assert told(Trust(calibrated, 0.2))[1] == pytest.approx(0.2 * weight, rel=rounding)


@each_level
def test_without_calibration_and_with_less_known_it_is_farther_off(level: str) -> None:
    measured, least = LEVELS[level].error, LEVELS["ankle_moment"].error
    for axial in (-100.0, 0.0, 300.0, 3000.0):
        told = measured.calibrated.at(axial, 700.0)
        assert 0.0 < told < measured.uncalibrated.at(axial, 700.0)
        assert measured.calibrated.at(-axial, 700.0) == told
        if axial < 1000.0:
            assert told >= least.calibrated.at(axial, 700.0)


@each_level
@given(draw=draws)
def test_the_axial_force_is_all_that_presses(level: str, draw: Random) -> None:
    found = at_once(level, angles(draw), ground(draw))
    parts = found[3:7]
    assert found.axial_force == pytest.approx(sum(parts), rel=1e-14, abs=1e-10)  # roundings of it, and of 100 kN
    assert min(parts[1:]) >= 0.0


@each_level
@given(draw=draws)
def test_forces_hold_the_moment_each_by_its_own_arm(level: str, draw: Random) -> None:
    joints = angles(draw)._replace(flexion=0.0)
    found = at_once(level, joints, ground(draw))
    flexing = 0.02616 * found.hamstrings_force + 0.02220 * found.gastrocnemius_force
    held = PERSON.moment_arm_scale * (0.04463 * found.quadriceps_force - flexing)
    assert held == pytest.approx(found.knee_moment, abs=1e-10)  # roundings of some kN m


def unknown(estimate: Estimate) -> set[str]:
    return {name for name, value in estimate._asdict().items() if math.isnan(value)}


OF_THE_KNEE = {
    "axial_force",
    "standard_deviation",
    "resultant_force",
    "quadriceps_force",
    "knee_moment",
    "frontal_moment",
}
FULL = Joints(0.4, 0.2, 0.1)


@pytest.mark.parametrize(
    ("level", "joints", "torque", "expected"),
    [
        ("ground_force", FULL, (1.0, 2.0, 3.0), {"ankle_moment", "frontal_moment"}),
        ("ground_force", Joints(0.4, UNKNOWN, UNKNOWN), NOT_MEASURED, {"ankle_moment", "frontal_moment"}),
        ("knee_moment", FULL, (1.0, 2.0, 3.0), {"ankle_moment"}),
        ("knee_moment", FULL._replace(ankle=UNKNOWN), (1.0, 2.0, 3.0), {"ankle_moment"}),
        ("knee_moment", FULL._replace(hip=UNKNOWN), (1.0, 2.0, 3.0), {"ankle_moment"}),
        ("knee_moment", FULL, NOT_MEASURED, {"ankle_moment", *OF_THE_KNEE} - {"resultant_force"}),
        ("knee_moment", Joints(0.4, UNKNOWN, UNKNOWN), (1.0, 2.0, 3.0), {"ankle_moment", *OF_THE_KNEE}),
        ("ankle_moment", FULL, (1.0, 2.0, 3.0), set()),
        ("ankle_moment", FULL._replace(hip=UNKNOWN), (1.0, 2.0, 3.0), set()),
        ("ankle_moment", FULL._replace(ankle=UNKNOWN), (1.0, 2.0, 3.0), set()),
    ],
)
def test_what_is_not_known_is_not_a_number(level: str, joints: Joints, torque: Any, expected: set[str]) -> None:
    assert unknown(at_once(level, joints, Ground((20.0, 700.0, -15.0), torque))) == expected
    found = estimator(level)
    for number in range(100):
        later = found.at(EPOCH + number * MS, joints, Ground((20.0, 700.0, -15.0), torque))
    assert unknown(later) == expected


def test_the_calf_is_asked_for_where_the_ankle_is_known_alone() -> None:
    forces = {level: at_once(level, FULL, STANCE).gastrocnemius_force for level in LEVELS}
    assert forces["ground_force"] == forces["knee_moment"] == 0.0
    assert forces["ankle_moment"] > 100.0


@given(draw=draws)
def test_moments_of_joints_that_turn_steadily_quicker_are_those_of_lagrange(draw: Random) -> None:
    """Parabolas: the angles of now, the rates of half a window before."""
    curves = np.array([[draw.uniform(-0.5, 0.5), draw.uniform(-5.0, 5.0), draw.uniform(-60.0, 60.0)] for _ in range(3)])
    sensed, one = ground(draw), estimator("ankle_moment")
    for number in range(-50, 1):
        time = 1e-3 * number
        hip, flexion, ankle = curves @ (1.0, time, 0.5 * time * time)
        joints = Joints(float(flexion), float(hip), float(ankle), 7.0, 4.0)
        found = one.at(EPOCH + number * MS, joints, sensed)
    rates = curves[:, 1] - 0.5 * WINDOW * curves[:, 2]
    expected = Chain(LEG).holds(curves[:, 0], rates, curves[:, 2], np.array(sensed.force[:2]), sensed.torque[2])
    # Accelerations to 4e-9 rad/s^2 (`test_motion.py`), with inertias of 2 kg m^2 and masses by lengths of 4 kg m
    told = (found.knee_moment + 7.0, found.ankle_moment + 4.0, found.resultant_force)
    assert told == pytest.approx(expected, abs=2e-8)
