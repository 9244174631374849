"""The launch files: names and options, read from their text; and what RViz is given besides the markers.

The launch packages are not among the ROS 2 wheels. `tests/ros/test_launch.py` runs a file where they are.
"""

import math
import re
import runpy

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.commands.main import knee_contact
from knee_contact_ros.parameters.files import (
    STANDARD_PARAMETERS,
    known_parameters,
    load_parameters,
)
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.frames import ISB_SUFFIX, isb_transform
from knee_contact_ros.streams.topics import KNEE_CONTACT_MARKERS
from knee_contact_ros.system.files import PACKAGE, read_yaml, share_folder

FOLDER = share_folder() / "launch"
FILES = [
    "knee_contact.launch.py",
    "knee_load.launch.py",
    "replay.launch.py",
    "rviz.launch.py",
    "two_knees.launch.py",
]
OTHERS = {"--params-file", "--log-level", "--display-config", "--frame-id", "--child-frame-id"}
"""Options of ROS 2 itself, and of programs of other packages"""
OURS = {
    option
    for command in knee_contact.commands.values()
    for one in command.params
    for option in one.opts
}


def text_of(name):
    return (FOLDER / name).read_text(encoding="utf-8")


def named(name, *functions):
    """First arguments, as they are written, of all calls of some functions."""
    return set(re.findall(rf"\b(?:{'|'.join(functions)})\(\s*f?\"([^\"]+)\"", text_of(name)))


def test_all_launch_files_are_checked():
    assert sorted(path.name for path in FOLDER.iterdir() if path.is_file()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_arguments_are_declared_described_and_used(name):
    declared = named(name, "DeclareLaunchArgument")
    assert named(name, "LaunchConfiguration", "number") == declared
    for told in ("default_value=", "description="):
        assert text_of(name).count(told) == text_of(name).count("DeclareLaunchArgument(")


def test_what_holds_for_both_knees_is_listed_and_is_as_for_one():
    one, both = (
        dict(
            re.findall(
                r"DeclareLaunchArgument\(\s*\"(\w+)\",([^()]*)\)", text_of(f"{name}.launch.py")
            )
        )
        for name in ("knee_contact", "two_knees")
    )
    of_each_knee = {
        "node",
        "namespace",
        "params",
        "joint",
        "record",
        "rerun",
        "rerun_port",
        "rerun_knees",
    }
    assert {name: both.get(name) for name in one.keys() - of_each_knee} == {
        name: one[name] for name in one.keys() - of_each_knee
    }


@pytest.mark.parametrize("name", FILES)
def test_parameters_options_and_files_are_there(name):
    text = text_of(name)
    known = (
        known_parameters(LoadParameters) if name == "knee_load.launch.py" else known_parameters()
    )
    sections = {parameter.split(".")[0] for parameter in known}
    words = set(re.findall(r"\"([a-z_]+(?:\.[a-z_]+)+)\"", text))
    assert {
        word for word in words if word.split(".")[0] in sections and not word.endswith(".urdf")
    } <= set(known)
    assert set(re.findall(r"given\[\"([^\"]+)\"\]", text)) <= {*known, *STANDARD_PARAMETERS}
    assert set(re.findall(r"\"(--[a-z-]+)\"", text)) <= OURS | OTHERS
    included = re.findall(r"\"(\w+\.launch\.py)\"", text)
    assert set(included) <= set(FILES)
    if included:  # what is handed on is an argument there
        assert set(re.findall(r"^ +\"(\w+)\": ", text, re.MULTILINE)) <= named(
            included[0], "DeclareLaunchArgument"
        )
    assert f'PACKAGE = "{PACKAGE}"' in text
    for place in re.findall(
        r"PathJoinSubstitution\(\[(?:share|FindPackageShare\(PACKAGE\)), ([^\]]+)\]", text
    ):
        assert share_folder().joinpath(*re.findall(r"\"([^\"]+)\"", place)).exists()


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_loads(name):
    pytest.importorskip("launch_ros", reason="needs the ROS package launch_ros")
    description = runpy.run_path(str(FOLDER / name))["generate_launch_description"]()
    names = {argument.name for argument in description.get_launch_arguments()}
    for side in ("left", "right"):
        assert {
            argument.replace("{side}", side) for argument in named(name, "DeclareLaunchArgument")
        } <= names


LAYOUT = share_folder() / "config" / "rviz" / "knee_contact.rviz"
BONE = "tibia"


@pytest.fixture(scope="module")
def body():
    """Shank and thigh."""
    yourdfpy = pytest.importorskip("yourdfpy")
    return yourdfpy.URDF.load(str(share_folder() / "urdf" / "knee.urdf"))


def thigh_at(body, angle):
    """Where the thigh lies in the tibia frame at a flexion angle [rad], shape (4, 4)."""
    body.update_cfg({load_parameters({}).knee.joint_name: angle})
    return np.array(body.get_transform("thigh", BONE + ISB_SUFFIX))


def test_the_tibia_frame_lies_in_the_shank_as_the_node_says(body):
    transform = isb_transform(BONE + ISB_SUFFIX)
    assert transform
    assert (
        (transform.parent, transform.child)
        == (BONE, BONE + ISB_SUFFIX)
        == (body.base_link, BONE + ISB_SUFFIX)
    )
    found = body.get_transform(BONE + ISB_SUFFIX, BONE)
    assert found[:3, :3] == pytest.approx(
        Rotation.from_quat(transform.rotation).as_matrix(), abs=1e-15
    )
    assert found[:3, 3].tolist() == list(transform.translation)


def test_the_thigh_stands_in_line_and_turns_as_the_femur_does_as_far_as_a_knee(body):
    """Counter-clockwise with x to the right and y up: about the tibia frame's z axis."""
    extended = thigh_at(body, 0.0)
    assert extended[:3, 3] == pytest.approx(
        [0.0, load_parameters({}).femur.radius, 0.0], abs=1e-15
    )
    up, forward = extended[:3, 2], extended[:3, 0]  # superior and anterior
    assert [*up, *forward] == pytest.approx([0.0, 1.0, 0.0, 1.0, 0.0, 0.0], abs=1e-15)
    for angle in (0.1, 1.0, 2.6):
        flexed = thigh_at(body, angle)
        turn = flexed[:3, :3] @ extended[:3, :3].T
        assert turn == pytest.approx(
            Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix(), abs=1e-15
        )
        assert flexed[:3, 3].tolist() == extended[:3, 3].tolist()
    (joint,) = [joint for joint in body.robot.joints if joint.type == "revolute"]
    assert joint.name == load_parameters({}).knee.joint_name
    assert np.degrees([joint.limit.lower, joint.limit.upper]) == pytest.approx([0.0, 150.0])


def test_the_layout_shows_what_is_published(body):
    manager = read_yaml(LAYOUT)["Visualization Manager"]
    displays = {display["Class"]: display for display in manager["Displays"]}
    assert (
        displays["rviz_default_plugins/MarkerArray"]["Topic"]["Value"]
        == f"/{KNEE_CONTACT_MARKERS}"
    )
    model = displays["rviz_default_plugins/RobotModel"]["Description Topic"]
    assert (model["Value"], model["Durability Policy"]) == (
        "/robot_description",
        "Transient Local",
    )
    assert manager["Global Options"]["Fixed Frame"] in body.link_map


def test_the_knee_is_seen_from_its_right_side():
    """So that anterior is to the right on the screen, as everywhere here; RViz puts its eye where the angles say."""
    view = read_yaml(LAYOUT)["Visualization Manager"]["Views"]["Current"]
    yaw, pitch = float(view["Yaw"]), float(view["Pitch"])
    eye = np.array(
        [math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)]
    )
    transform = isb_transform(BONE + ISB_SUFFIX)
    assert transform
    to_the_right = Rotation.from_quat(transform.rotation).apply([0.0, 0.0, 1.0])
    assert eye == pytest.approx(to_the_right, abs=1e-6)  # the angle is written with six decimals
