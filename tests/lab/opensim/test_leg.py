"""`import-opensim --ground` without OpenSim itself: where the leg is, the tests say; test_leg_by_opensim.py asks it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.reader import INPUT_TYPES, read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.opensim import leg
from knee_contact_ros.lab.opensim.leg import LegJoints, Places, leg_joints, thigh_angle
from knee_contact_ros.lab.tables import Storage
from knee_contact_ros.streams.topics import GROUND_REACTION_FORCE, MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import not_installed
from tests.lab.opensim.plates import JOINT, MODEL, STANDS, external, plate, write_loads, write_model, write_plates
from tests.lab.opensim.storages import kinematics, reactions, write_storage
from tests.lab.opensim.test_import_opensim import origin

TOPICS = INPUT_TYPES | {f"/{GROUND_REACTION_FORCE}": MESSAGE_TYPES[GROUND_REACTION_FORCE]}
HIP_ANGLE, TOES_UP = 0.3, 0.1


def stands_still(storage: Storage, degrees: bool, model: Path, joints: LegJoints, work: Path) -> Places:
    """A leg whose knee is ahead of its hip, above the plate of `plates.plate`."""
    assert degrees
    assert work.is_dir()
    knee = np.array([0.4, 0.5, 0.1])
    hip = knee + 0.4 * np.array([-np.sin(HIP_ANGLE), np.cos(HIP_ANGLE), 0.0])
    rows = np.ones((len(storage.stamps), 1))
    ankle, forward = np.array([0.4, 0.09, 0.1]), np.array([1.0, 0.0, 0.0])
    return Places(storage.stamps, rows * hip, rows * knee, rows * ankle, rows * forward, TOES_UP * rows[:, 0])


@pytest.fixture
def results(tmp_path: Path) -> list[str]:
    q, jr = kinematics(tmp_path / "q.sto"), reactions(tmp_path / "jr.sto")
    return ["import-opensim", "--kinematics", str(q), "--reactions", str(jr), "--output", str(tmp_path / "walk")]


@pytest.fixture
def loads(tmp_path: Path) -> list[str]:
    """Model and external loads, of which the right foot's plate is the second."""
    write_plates(tmp_path / "grf.mot", plate("ground_force_", ""), plate("1_ground_force_", "1_ground_torque_"))
    forces = [external("calcn_r", "1_ground_force_", "1_ground_torque_"), external("calcn_l", torque="")]
    xml = write_loads(tmp_path / "grf.xml", "grf.mot", forces)
    return ["--ground", str(xml), "--model", str(write_model(tmp_path / "m.osim"))]


@pytest.fixture
def by_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if OpenSim were installed."""
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: name)
    monkeypatch.setattr(leg, "places_of", stands_still)


@pytest.mark.usefixtures("by_tests")
def test_the_bag_holds_what_the_legs_sensors_would_have_told(
    results: list[str], loads: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*results, *loads, "--side", "right"]) == 0
    said = capsys.readouterr().out
    for part in ("1_ground_force_v(x y z)", "of grf.mot", "241 rows, 0.000 to 1.200 s, 700.0 N upwards at most",
                 "17.2 to 17.2 deg to the vertical", "of hip_r, walker_knee_r, ankle_r of m.osim"):  # fmt: skip
        assert part in said
    messages = read_bag(tmp_path / "walk", TOPICS)
    first = {message.topic: message.message for message in messages[:3]}
    assert [message.topic for message in messages[:3]] == [
        "/joint_states", "/joint_reaction_force", "/ground_reaction_force",
    ]  # fmt: skip
    joints = first["/joint_states"]
    assert list(joints.name) == ["knee", "hip", "ankle"]
    assert list(joints.position[1:]) == pytest.approx([HIP_ANGLE, TOES_UP], abs=1e-15)
    assert list(joints.velocity[1:]) == [0.0, 0.0]
    ground = first["/ground_reaction_force"]
    assert ground.header.frame_id == "ground"
    # An arm of (0.1, -0.09, 0.02) m, a force of (50, 700, -40) N and a free moment of (1, 7, -2) N m.
    assert numbers(ground.wrench.force) == pytest.approx([50.0, 700.0, -40.0], abs=1e-9)
    assert numbers(ground.wrench.torque) == pytest.approx([3.6 - 14.0 + 1.0, 1.0 + 4.0 + 7.0, 70.0 + 4.5 - 2.0])
    air = [m.message.wrench for m in messages if m.topic == "/ground_reaction_force"][int(STANDS.sum()) + 1]
    assert numbers(air.force) == numbers(air.torque) == [0.0, 0.0, 0.0]
    record = origin(tmp_path / "walk")
    assert (record["ground"], record["ground_data"]) == ("grf.xml", "grf.mot")
    assert len(record["ground_data_sha256"]) == 64
    assert "about the ankle joint's centre" in record["ground_force"]


def numbers(vector: object) -> list[float]:
    return [getattr(vector, axis) for axis in "xyz"]


@pytest.mark.usefixtures("by_tests")
def test_a_left_leg_is_mirrored(results: list[str], loads: list[str], tmp_path: Path) -> None:
    assert main([*results, *loads, "--side", "left"]) == 0
    wrench = next(m.message.wrench for m in read_bag(tmp_path / "walk", TOPICS) if m.topic == "/ground_reaction_force")
    assert numbers(wrench.force) == pytest.approx([50.0, 700.0, 40.0], abs=1e-9)
    assert numbers(wrench.torque) == pytest.approx([-(3.6 - 14.0), -(1.0 + 4.0), 70.0 + 4.5])
    notes = origin(tmp_path / "walk")["conversions"]
    assert "ground: left leg mirrored" in notes
    assert "ground: no free moment in the file" in notes


@pytest.mark.usefixtures("by_tests")
@pytest.mark.parametrize("rate", ["200", "0"])
def test_the_knee_is_the_same_as_without(results: list[str], loads: list[str], tmp_path: Path, rate: str) -> None:
    """With rate 0 each keeps its stamps: the ground those of its file."""
    arguments = [*results, "--side", "right", "--rate", rate, "--overwrite"]
    knees = []
    for more, topics in (([], INPUT_TYPES), (loads, TOPICS)):
        assert main([*arguments, *more]) == 0
        messages = read_bag(tmp_path / "walk", topics)
        angles = [(m.log_time, m.message.position[0]) for m in messages if m.topic == "/joint_states"]
        forces = [(m.log_time, str(m.message)) for m in messages if m.topic == "/joint_reaction_force"]
        knees.append((angles, forces))
        ground = [m.log_time for m in messages if m.topic == "/ground_reaction_force"]
    assert knees[0] == knees[1]
    assert ground == [5_000_000 * row for row in range(241)]
    assert len(knees[1][0]) == (241 if rate == "200" else 121)


def test_the_thighs_angle_grows_as_the_knee_goes_ahead() -> None:
    points = np.zeros((2, 3))
    knee = np.array([[0.3, -0.4, 0.1], [-0.4, -0.4, 0.1]])
    places = Places(np.arange(2), points, knee, points, points, points[:, 0])
    assert thigh_angle(places) == pytest.approx([np.arctan2(3, 4), -np.pi / 4])


def test_the_joints_are_found_by_their_names_and_the_knees_angle(tmp_path: Path) -> None:
    model = write_model(tmp_path / "m.osim")
    assert leg_joints(model, "left", "knee_angle_l").names == ("hip_l", "walker_knee_l", "ankle_l")
    with pytest.raises(UsageError, match=r"m\.osim has no joint of the coordinate knee_angle_x, and one is needed"):
        leg_joints(model, "left", "knee_angle_x")
    twice = "".join(JOINT.format(f"ankle_{n}_r", f"angle_{n}") for n in "ab") + JOINT.format("hip_r", "hip")
    model.write_text(MODEL.format(twice + JOINT.format("knee_r", "knee")))
    with pytest.raises(UsageError, match="has the joints ankle_a_r, ankle_b_r of the right ankle"):
        leg_joints(model, "right", "knee")


@pytest.mark.usefixtures("by_tests")
def test_a_person_who_walks_elsewhere_is_refused(
    results: list[str], loads: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def turned(*arguments: object) -> Places:
        places = stands_still(*arguments)  # type: ignore[arg-type]
        return places._replace(forward=-places.forward)

    monkeypatch.setattr(leg, "places_of", turned)
    assert main([*results, *loads, "--side", "right"]) == 2
    assert "the pelvis points to x -1.00, z " in capsys.readouterr().err


@pytest.mark.usefixtures("by_tests")
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--ground", "grf.mot"], "--ground needs --model M.osim, which tells where the ankle is"),
        (["--ground", "--model", "m.osim"], "--ground FILE is missing; only with --setup it is found"),
        (["--ground", "none.mot", "--model", "m.osim"], "cannot read none.mot"),
        (["--ground", "none.xml", "--model", "m.osim"], "cannot read none.xml"),
        (
            ["--ground", "q.sto", "--model", "m.osim"],
            "q.sto has no ground force, as ground_force_vx, but hip_flexion_r",
        ),
        (["--ground", "late.mot", "--model", "m.osim"], "late.mot spans 10 to 11 s, and the kinematics 0 to 1.2 s"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    results: list[str],
    loads: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    says: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    late = plate("ground_force_r_", "")
    write_storage(tmp_path / "late.mot", np.linspace(10.0, 11.0, 241), late, "yes")
    assert main([*results, "--side", "right", *arguments]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not list(tmp_path.glob("walk*"))


def test_without_opensim_one_line_says_what_to_install(
    results: list[str],
    loads: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("knee_contact_ros.system.files.find_spec", lambda name: None)
    assert main([*results, *loads, "--side", "right"]) == 2
    assert capsys.readouterr().err == f"knee-contact: {not_installed('opensim', 'opensim')}\n"
    assert not (tmp_path / "walk").exists()
