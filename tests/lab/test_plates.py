"""Force plates of a C3D file: the wrench of the ground on one foot, wherever the plates lie and whoever walks where."""

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.streams.messages import WRENCH
from knee_contact_ros.streams.topics import LOAD_INPUTS, types_of
from tests.helpers.bags import raw_messages

MAP = """\
angle: {column: RKneeAngles.X, unit: deg}
plates: {}
body_weight: 700
"""
TIME = np.arange(300) / 100.0
FAST = np.arange(3000) / 1000.0
ORIGIN = np.array([0.0, 0.0, -40.0])
"""From the middle of a plate's sensor to that of its surface [mm], in its axes, of which z points down"""
SENSORS = np.array([120.0, 200.0, -40.0])
"""Of a plate of type 3: half the distances between its four sensors, and `ORIGIN`'s height [mm]"""
MIDDLES = {1: np.array([100.0, 1200.0, 0.0]), 2: np.array([130.0, 1900.0, 0.0])}
"""Middles of the plates [mm]: persons walk along y or back"""
STANCES = {"L": (0.4, 1.0, 1), "R": (1.0, 1.6, 2)}
"""Contacts [s] of each foot and the number of its plate"""


def ground(at, number):
    """Force on the foot [N], and centre of pressure [mm], in axes of the laboratory."""
    begin, end, _ = next(each for each in STANCES.values() if each[2] == number)
    phase = (at - begin) / (end - begin)
    on = ((phase > 0.0) & (phase < 1.0)) * np.sin(np.pi * np.clip(phase, 0.0, 1.0))
    force = np.array([20.0 * on, -100.0 * np.cos(np.pi * phase) * on, 800.0 * on])
    centre = MIDDLES[number][:, None] + np.array([10.0 + 0 * at, 200.0 * (phase - 0.5), 0 * at])
    return force, centre


def raw_channels(number, kind, way):
    """What a plate of a type tells, for a person that walks along y (1) or back (-1)."""
    force, centre = ground(FAST, number)
    turned = np.array([way, way, 1.0])[:, None]
    to_plate = np.diag([-1.0, 1.0, -1.0])
    force = to_plate @ (turned * force)
    away = to_plate @ (turned * (centre - MIDDLES[number][:, None])) * (force[2] != 0.0)
    if kind == 1:
        return np.array([*force, *away[:2], 0 * FAST])
    moment = np.cross((away + ORIGIN[:, None]).T, force.T).T
    if kind == 3:  # four sensors, which C3D's format numbers counter-clockwise seen from above
        x, y, z = moment / np.array([SENSORS[1], SENSORS[0], SENSORS[1]])[:, None]
        pairs = [force[0] - z, force[0] + z, force[1], force[1]]
        corners = [force[2] + a * x + b * y for a, b in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
        return np.array([*(0.5 * np.array(pairs)), *(0.25 * np.array(corners))])
    return np.vstack([force, moment])


def write(kind=2, way=1, leave_out=(), unseen=(), sign=1.0, bias=0.0, rests=9.0, event=()):
    """A walk with a foot on each of two plates, as a C3D file in mm.

    Markers may be `unseen`, the height of a plate's sensor have its other sign, and amplifiers a `bias` [N].
    From `rests` [s] on both feet stand beside the plates; `event` is the group EVENT.
    """
    ezc3d = pytest.importorskip("ezc3d")
    made = ezc3d.c3d()
    points = {"RKneeAngles": np.array([30.0 - 29.0 * np.cos(5.0 * TIME), 0 * TIME, 0 * TIME])}
    turned = np.array([way, way, 1.0])[:, None]
    for letter, (begin, end, number) in STANCES.items():
        start = MIDDLES[number] * np.array([1.0, 1.0, 0.0]) - np.array([0.0, 60.0, 0.0])
        after = np.clip(TIME, end, max(rests, end)) - end
        step = 2500.0 * (np.minimum(TIME - begin, 0.0) + after)
        for name, ahead, height in (
            ("ANK", 0.0, 90.0),
            ("HEE", -50.0, 40.0),
            ("TOE", 150.0, 50.0),
        ):
            offset = np.array([0 * TIME, ahead + step, height + 0 * TIME])
            points[f"{letter}{name}"] = turned * (start[:, None] + offset)
    names = [name for name in points if name not in leave_out]
    units = 8 * ["N"] if kind == 3 else [*3 * ["N"], *3 * ["Nmm"]]
    channels = [f"channel {number}" for number in range(2 * len(units))]
    for group, rate, labels in (("POINT", 100.0, names), ("ANALOG", 1000.0, channels)):
        made["parameters"][group]["RATE"]["value"] = [rate]
        made["parameters"][group]["LABELS"]["value"] = labels
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    made["parameters"]["ANALOG"]["UNITS"]["value"] = 2 * units
    sensor = [1.0, 1.0, sign] * (SENSORS if kind == 3 else ORIGIN)
    corners = []
    for place in MIDDLES.values():
        middle = turned[:, 0] * place
        corners.append(
            [
                middle + np.array([x, y, 0.0])
                for x, y in ((-200, 250), (200, 250), (200, -250), (-200, -250))
            ]
        )
    plates = {
        "USED": [2],
        "TYPE": [kind, kind],
        "ZERO": [1, 0],
        "CORNERS": np.transpose(corners, (2, 1, 0)),
        "ORIGIN": np.stack([sensor, sensor], axis=1),
        "CHANNEL": 1 + np.arange(len(channels)).reshape(2, -1).T,
        **({"CAL_MATRIX": np.stack([np.eye(6)] * 2, axis=2)} if kind == 4 else {}),
    }
    for name, value in plates.items():
        made["parameters"]["FORCE_PLATFORM"][name]["value"] = value
    for name, value in dict(event).items():
        made.add_parameter("EVENT", name, value)
    made["data"]["points"] = np.ones((4, len(names), len(TIME)))
    made["data"]["points"][:3] = np.stack([points[name] for name in names], axis=1)
    for name in unseen:
        made["data"]["points"][:, names.index(name)] = np.nan
    channels = np.vstack([raw_channels(number, kind, way) for number in MIDDLES])
    made["data"]["analogs"] = channels[None] + bias
    made.write("walk.c3d")


def wrenches():
    """Stamps [s], forces and torques of the bag."""
    found = [
        WRENCH.read_message(each.data, "ground_reaction_force")[0]
        for each in raw_messages(Path("bag"), types_of(LOAD_INPUTS))
        if each.topic == "/ground_reaction_force"
    ]
    stamps = np.array([each.stamp for each in found]) * 1e-9
    return (
        stamps,
        np.array([each.force for each in found]),
        np.array([each.torque for each in found]),
    )


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("kind", [1, 2, 3, 4])
def test_a_foot_is_found_on_its_plate_and_its_wrench_is_about_the_ankle(importing, kind, way):
    write(kind, way)
    importing(None, MAP)
    assert_right_foot()


def assert_right_foot():
    """The bag has the wrench of the right foot on its plate, and none in the air."""
    stamps, force, torque = wrenches()
    lab, centre = ground(stamps, 2)
    lateral = np.array([lab[1], lab[2], lab[0]]).T  # y ahead and z up, so x is to the right
    ankle = np.array([130.0, 1840.0, 90.0])[:, None]
    moment = np.cross(1e-3 * (centre - ankle).T, lab.T)
    inside = (stamps > 1.02) & (stamps < 1.58)
    assert inside.sum() > 50
    np.testing.assert_allclose(force[inside], lateral[inside], atol=2.0)
    np.testing.assert_allclose(torque[inside], moment[inside][:, [1, 2, 0]], atol=0.5)
    swings = (stamps < 0.98) | (stamps > 1.62)
    assert swings.sum() > 150
    np.testing.assert_allclose(force[swings], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    "change",
    [
        # As in a real file; ezc3d turns the distances of its sensors, too.
        {"kind": 3, "sign": -1.0},
        {"kind": 2, "sign": -1.0},
        {"bias": 30.0},
        {"unseen": ["RHEE"]},
    ],
)
def test_what_real_files_have_does_not_move_the_force(importing, change):
    write(**change)
    importing(None, MAP)
    assert_right_foot()


def test_a_foot_is_in_the_air_until_the_heel_strike_of_the_file(importing):
    """Its slowest marker stands a little earlier; beside the plates a standing foot has an unknown force."""
    landing = {"LABELS": ["Foot Strike"], "CONTEXTS": ["Right"], "TIMES": [[0.0], [2.3]]}
    for event, last in (((), 2.2), (landing, 2.3)):
        write(rests=2.2, event=event)
        importing(None, MAP)
        # A frame, and one of the difference that gives the speed
        assert wrenches()[0][-1] == pytest.approx(last, abs=0.021)


def test_plates_without_data_are_refused_in_a_line(importing):
    ezc3d = pytest.importorskip("ezc3d")
    write()
    made = ezc3d.c3d("walk.c3d")
    made["data"]["analogs"] = np.zeros((1, 0, 0))
    for name, value in (
        ("RATE", [0.0]),
        ("LABELS", []),
        ("UNITS", []),
        ("SCALE", []),
        ("OFFSET", []),
    ):
        made["parameters"]["ANALOG"][name]["value"] = value
    made.write("walk.c3d")
    assert "walk.c3d: its force plates have no data\n" in importing.refused(None, MAP)


def test_a_left_foot_is_mirrored_and_a_plate_may_be_named(importing):
    write()
    importing(None, MAP + "side: left\n")
    stamps, force, _ = wrenches()
    assert force[:, 1].max() == pytest.approx(800.0, rel=0.01)
    assert stamps[force[:, 1].argmax()] == pytest.approx(0.7, abs=0.02)
    assert force[:, 2].min() == pytest.approx(-20.0, rel=0.02)
    write(leave_out=["RHEE", "RTOE"])
    named = MAP.replace("{}", "{numbers: [2], ankle: [RANK], forward: +Y}")
    importing(None, named)
    stamps, force, _ = wrenches()
    assert force[:, 1].max() == pytest.approx(800.0, rel=0.01)
    assert 0.9 < stamps[0] < 1.1  # without a toe nobody knows whether it swings


@pytest.mark.parametrize(
    ("text", "leave_out", "words"),
    [
        ("{}", ["RANK"], "has no markers RANK; name them (map: plates.ankle, heel, toe)"),
        ("{heel: RHEEL}", [], "has no markers RHEEL"),
        (
            "{ankle: [LANK], heel: LTOE, toe: LTOE, numbers: [3]}",
            [],
            "no plate is touched by the right foot",
        ),
        ("{forward: up}", [], "allowed: , +X, +Y"),
        ("{file: other*}", [], "0 C3D files are given; say which with plates.file"),
    ],
)
def test_what_is_not_found_is_told(importing, text, leave_out, words):
    write(leave_out=leave_out)
    assert words in importing.refused(None, MAP.replace("{}", text))
