"""`import-opensim --ground` without OpenSim itself: where the leg is, the tests say; test_by_opensim.py asks it."""

import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab import checks
from knee_contact_ros.lab.opensim import leg
from knee_contact_ros.lab.opensim.leg import FootForce, GroundFile, read_ground
from knee_contact_ros.lab.opensim.setups import data_file
from knee_contact_ros.lab.tables import read_storage
from knee_contact_ros.streams.topics import GROUND_REACTION_FORCE, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import (
    FREE,
    PLATE_TIME,
    STANDS,
    external,
    kinematics,
    outcome,
    plate,
    reactions,
    write_loads,
    write_model,
    write_plates,
)
from tests.lab.opensim.test_command import origin

TOPICS = INPUT_TYPES | {f"/{GROUND_REACTION_FORCE}": MESSAGE_TYPES[GROUND_REACTION_FORCE]}
HIP_ANGLE, TOES_UP = 0.3, 0.1
LEFT = {"stem": "1_ground_force_", "torque": "1_ground_torque_"}
ANKLE = np.tile([0.4, 0.09, 0.1], (len(PLATE_TIME), 1))
ARM = np.array([0.1, -0.09, 0.02])
"""[m] from the ankle to the centre of pressure of `plate`"""
FOUND = FootForce("ground_force_v", "ground_force_p", "ground_torque_")
OTHER = FootForce(*(f"1_{name}" for name in FOUND))


def expected():
    """Wrench of a plate about the ankle."""
    force = np.column_stack([50.0 + PLATE_TIME, 700.0 - 100.0 * PLATE_TIME, -40.0 + PLATE_TIME])
    return np.hstack([force, np.cross(ARM, force) + np.array(FREE)]) * STANDS[:, None]


def ground(tmp_path, **changed):
    """A right foot's plate."""
    path = write_plates(
        tmp_path / "grf.mot", plate("ground_force_r_", "ground_torque_r_") | changed
    )
    force = external("calcn_r", "ground_force_r_", "ground_torque_r_")
    return read_ground(write_loads(tmp_path / "grf.xml", "grf.mot", [force]), path, "right")


@pytest.fixture
def data(tmp_path):
    """Two plates by the names of OpenSim's examples."""
    return write_plates(
        tmp_path / "grf.mot",
        *(plate(f"{n}ground_force_", f"{n}ground_torque_") for n in ("", "1_")),
    )


def test_external_loads_say_which_force_is_on_which_foot(data):
    forces = [external("/bodyset/calcn_l"), external("calcn_r", **LEFT), external("pelvis")]
    loads = write_loads(data.parent / "grf.xml", " grf.mot ", forces)
    for side, force in (("right", OTHER), ("left", FOUND)):
        assert read_ground(loads, data_file(loads), side)[1:] == (
            (force,),
            ("ground: what acts on pelvis is left out",),
        )
    switches = ("<isDisabled> true </isDisabled>", "<appliesForce>false</appliesForce>")
    off = [external("calcn_r", more=switch) for switch in switches]
    loads = write_loads(
        loads, "grf.mot", [*off, external("calcn_r", torque=""), external("toes_r", **LEFT)]
    )
    assert read_ground(loads, data, "right").forces == (FOUND._replace(torque=""), OTHER)


def test_the_data_lie_beside_their_loads_or_where_a_tool_runs(data):
    (data.parent / "loads").mkdir()
    loads = write_loads(data.parent / "loads" / "grf.xml", "grf.mot", [external("calcn_r")])
    with pytest.raises(
        UsageError, match=r"grf\.xml names the datafile grf\.mot, which is not there"
    ):
        data_file(loads)
    assert data_file(loads, data.parent) == data_file(data) == data
    with pytest.raises(UsageError, match="names no datafile, which has the numbers"):
        data_file(write_loads(loads, "", []))


REFUSED_LOADS = [
    (external("calcn_l"), r"applies no force to the right foot; its forces act on calcn_l"),
    (
        external("calcn_r", more="<force_expressed_in_body>calcn_r</force_expressed_in_body>"),
        "force 'calcn_r': force_expressed_in_body is calcn_r, but must be ground",
    ),
    (
        external("calcn_r", more="<point_expressed_in_body>calcn_r</point_expressed_in_body>"),
        "point_expressed_in_body is calcn_r, but must be ground",
    ),
    (external("calcn_r").replace("ground_force_p", ""), "has no point_identifier"),
    (
        external("calcn_r", stem="2_force_"),
        "has no column 2_force_vx, 2_force_vy, 2_force_vz, 2_force_px",
    ),
    (external("calcn_r", torque="t"), "has no column tx, ty, tz; it has ground_force_vx"),
]


PLATES = [
    (("ground_force_", "1_ground_force_"), ("ground_torque_", "1_ground_torque_"), (0, 1)),
    (("ground_force_l_", "ground_force_r_"), ("ground_moment_l_m", "ground_moment_r_m"), (1, 0)),
    (("left_ground_force_", "right_ground_force_"), ("", ""), (1, 0)),
    (
        tuple(f"ground_force_{n}_" for n in range(3)),
        ("",) * 3,
        r"which of ground_force_0_vx, .* of the right foot\?",
    ),
    (("f_",), ("",), "has no ground force, as ground_force_vx, but f_vx"),
]


@pytest.mark.parametrize(("stems", "torques", "found"), PLATES)
def test_names_of_columns_tell_the_foot_or_it_is_asked_for(tmp_path, stems, torques, found):
    data = write_plates(tmp_path / "grf.mot", *map(plate, stems, torques))
    if isinstance(found, str):
        assert re.search(found, str(outcome(read_ground, data, data, "right")))
        return
    for side, number in zip(("right", "left"), found, strict=True):
        force = FootForce(f"{stems[number]}v", f"{stems[number]}p", torques[number])
        assert read_ground(data, data, side).forces == (force,)


def test_an_identifier_may_be_the_beginning_of_three_names(data):
    """Of a moment it is `1_ground_t` here; of a force and its point together it would not be clear, as for OpenSim."""
    force = external("calcn_r", **LEFT).replace("1_ground_torque_<", "1_ground_t<")
    assert "1_ground_t<" in force
    loads = write_loads(data.parent / "grf.xml", "grf.mot", [force])
    assert read_ground(loads, data, "right").forces[0].torque == "1_ground_torque_"


@pytest.mark.parametrize(("force", "says"), REFUSED_LOADS)
def test_loads_that_cannot_be_are_refused(data, force, says):
    loads = write_loads(data.parent / "grf.xml", "grf.mot", [force])
    assert says in (refused := str(outcome(read_ground, loads, data, "right")))
    assert "\n" not in refused


@pytest.mark.parametrize(
    "noise",
    [
        {},
        {
            "vy": np.where(STANDS, 700.0 - 100.0 * PLATE_TIME, 9.9),
            "px": np.where(STANDS, 0.5, 40.0),
        },
    ],
)
def test_the_torque_is_about_the_ankle_and_nothing_acts_in_the_air(tmp_path, noise):
    """Also where a plate tells no centre of pressure and a free moment all the same, or a few N anywhere."""
    told = leg.about_ankle(
        ground(tmp_path, **{f"ground_force_r_{axis}": v for axis, v in noise.items()}), ANKLE
    )
    assert told.values == pytest.approx(expected(), abs=1e-8)  # the file has twelve decimals
    assert not told.values[~STANDS].any()


def test_plates_below_one_foot_are_added(tmp_path):
    path = write_plates(tmp_path / "two.mot", plate("a_force_"), plate("b_force_", "b_torque_"))
    of_toes, of_heel = (
        FootForce("a_force_v", "a_force_p", ""),
        FootForce("b_force_v", "b_force_p", "b_torque_"),
    )
    both = leg.about_ankle(GroundFile(read_storage(path), (of_toes, of_heel), ()), ANKLE).values
    free = np.hstack([np.zeros(3), FREE]) * STANDS[:, None]
    assert both == pytest.approx(2.0 * expected() - free, abs=1e-8)


@pytest.mark.parametrize(
    ("axis", "values", "says"),
    [
        (
            "px",
            np.full(len(PLATE_TIME), 500.0),
            r"ankle of a standing foot is 499\.6 m, plausible is 0 to 0\.3",
        ),
        ("pz", np.full(len(PLATE_TIME), -0.3), r"is 0\.41231 m, .* the other foot's, not in m"),
        (
            "px",
            np.where(PLATE_TIME > 0.5, np.nan, 0.5),
            r"column ground_force_r_px is nan at 0\.505 s",
        ),
        (
            "vx",
            np.where(PLATE_TIME > 0.5, np.inf, 0.5),
            r"column ground_force_r_vx is inf at 0\.505 s",
        ),
        (
            "vy",
            np.where(STANDS, -700.0, 0.0),
            r"ground_force_r_vy: the peak is .*: it must be in N, upwards",
        ),
        (
            "vy",
            np.where(STANDS, 0.7, 0.0),
            r"ground_force_r_vy: the peak is .*: it must be in N, upwards",
        ),
    ],
)
def test_forces_that_cannot_act_on_this_foot_are_refused(tmp_path, axis, values, says):
    file = ground(tmp_path, **{f"ground_force_r_{axis}": values})
    with pytest.raises(UsageError, match=says):
        leg.about_ankle(leg.during(file, file.data.stamps), ANKLE)


def stands_still(table, degrees, model, frames, work):
    """A leg whose knee is ahead of its hip, above the plate of `storages.plate`."""
    assert degrees
    assert work.is_dir()
    knee = np.array([0.4, 0.5, 0.1])
    hip = knee + 0.4 * np.array([-np.sin(HIP_ANGLE), np.cos(HIP_ANGLE), 0.0])
    origins = np.array([hip, knee, ANKLE[0], hip, knee, ANKLE[0]])
    rotations = np.array([np.eye(3)] * len(frames))
    rotations[5, :2, :2] = [
        [np.cos(TOES_UP), -np.sin(TOES_UP)],
        [np.sin(TOES_UP), np.cos(TOES_UP)],
    ]
    rows = len(table.stamps)
    return leg.Frames((), np.array([rotations] * rows), np.array([origins] * rows), ())


@pytest.fixture
def results(tmp_path):
    q, jr = kinematics(tmp_path / "q.sto"), reactions(tmp_path / "jr.sto")
    return [
        "import-opensim",
        f"--kinematics={q}",
        f"--reactions={jr}",
        "--output",
        str(tmp_path / "walk"),
    ]


@pytest.fixture
def loads(tmp_path):
    """Model and external loads, of which the right foot's plate is the second."""
    write_plates(tmp_path / "grf.mot", plate("ground_force_"), plate(**LEFT))
    xml = write_loads(
        tmp_path / "grf.xml",
        "grf.mot",
        [external("calcn_r", **LEFT), external("calcn_l", torque="")],
    )
    return ["--ground", str(xml), "--model", str(write_model(tmp_path / "m.osim"))]


@pytest.fixture
def by_tests(monkeypatch):
    """As if OpenSim were installed."""
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: name)
    monkeypatch.setattr(leg, "frames_of", stands_still)


def numbers(wrench):
    return [getattr(vector, axis) for vector in (wrench.force, wrench.torque) for axis in "xyz"]  # type: ignore[attr-defined]


@pytest.mark.usefixtures("by_tests")
def test_the_bag_holds_the_values_of_the_legs_sensors(results, loads, tmp_path, capsys):
    assert main([*results, *loads, "--side", "right"]) == 0
    said = capsys.readouterr().out
    for part in (
        "1_ground_force_v(x y z)",
        "of grf.mot",
        "241 rows, 0.000 to 1.200 s, largest 700.0 N",
        "17.2 to 17.2 deg",
        "of hip_r, walker_knee_r, ankle_r of m.osim",
    ):
        assert part in said
    messages = read_bag(tmp_path / "walk", TOPICS)
    assert [message.topic for message in messages[:3]] == [
        "/joint_states",
        "/joint_reaction_force",
        "/ground_reaction_force",
    ]
    joints, _, first = (message.message for message in messages[:3])
    assert list(joints.name) == ["knee", "hip", "ankle"]
    assert list(joints.position[1:]) == pytest.approx([HIP_ANGLE, TOES_UP], abs=1e-15)
    assert list(joints.velocity[1:]) == [0.0, 0.0]
    assert first.header.frame_id == "ground"
    # An arm of (0.1, -0.09, 0.02) m, a force of (50, 700, -40) N and a free moment of (1, 7, -2) N m.
    torque = [3.6 - 14.0 + 1.0, 1.0 + 4.0 + 7.0, 70.0 + 4.5 - 2.0]
    assert numbers(first.wrench) == pytest.approx([50.0, 700.0, -40.0, *torque], abs=1e-9)
    air = [m.message.wrench for m in messages if m.topic == "/ground_reaction_force"][
        int(STANDS.sum()) + 1
    ]
    assert numbers(air) == [0.0] * 6
    record = origin(tmp_path / "walk")
    assert (record["ground"], record["ground_data"], len(record["ground_data_sha256"])) == (
        "grf.xml",
        "grf.mot",
        64,
    )
    assert "about the ankle joint's centre" in record["ground_force"]


@pytest.mark.usefixtures("by_tests")
def test_a_left_leg_is_mirrored(results, loads, tmp_path):
    assert main([*results, *loads, "--side", "left"]) == 0
    wrench = next(
        m.message.wrench
        for m in read_bag(tmp_path / "walk", TOPICS)
        if m.topic == "/ground_reaction_force"
    )
    assert numbers(wrench) == pytest.approx(
        [50.0, 700.0, 40.0, -(3.6 - 14.0), -(1.0 + 4.0), 70.0 + 4.5], abs=1e-9
    )
    notes = origin(tmp_path / "walk")["conversions"]
    assert "ground: left leg mirrored" in notes
    assert "ground: no free moment in the file" in notes


def test_the_joints_are_found_by_their_names_and_the_knees_angle(tmp_path):
    model = write_model(tmp_path / "m.osim")
    assert leg.leg_joints(model, "left", "knee_angle_l") == ["hip_l", "walker_knee_l", "ankle_l"]
    with pytest.raises(
        UsageError,
        match=r"m\.osim has no joint of the coordinate knee_angle_x; exactly one is needed",
    ):
        leg.leg_joints(model, "left", "knee_angle_x")
    write_model(
        model, [("ankle_a_r", "a"), ("ankle_b_r", "b"), ("hip_r", "hip"), ("knee_r", "knee")]
    )
    with pytest.raises(UsageError, match="has the joints ankle_a_r, ankle_b_r of the right ankle"):
        leg.leg_joints(model, "right", "knee")


def test_a_person_who_walks_elsewhere_is_refused():
    checks.check_heading(np.array([[0.8, 0.0, 0.6]]), Path("q.sto"))
    with pytest.raises(
        UsageError, match=r"q\.sto: .* is -1, plausible is 0\.7 to 1: turn markers"
    ):
        checks.check_heading(np.array([[-1.0, 0.0, 0.0]]), Path("q.sto"))
