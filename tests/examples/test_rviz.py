"""What RViz is given besides the markers: shank and thigh against the conventions, the layout against both."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.frames import ISB, isb_transform
from knee_contact_ros.streams.topics import KNEE_CONTACT_MARKERS
from knee_contact_ros.system.files import read_yaml, share_folder

LAYOUT = share_folder() / "config" / "rviz" / "knee_contact.rviz"
BONE = "tibia"


@pytest.fixture(scope="module")
def body() -> Any:
    """Shank and thigh."""
    yourdfpy = pytest.importorskip("yourdfpy")
    return yourdfpy.URDF.load(str(share_folder() / "urdf" / "knee.urdf"))


def thigh_at(body: Any, angle: float) -> np.ndarray:
    """Where the thigh lies in the tibia frame at a flexion angle [rad], shape (4, 4)."""
    body.update_cfg({load_parameters({}).knee.joint_name: angle})
    return np.array(body.get_transform("thigh", BONE + ISB))


def test_the_tibia_frame_lies_in_the_shank_as_the_node_says(body: Any) -> None:
    transform = isb_transform(BONE + ISB)
    assert transform
    assert (transform.parent, transform.child) == (BONE, BONE + ISB) == (body.base_link, BONE + ISB)
    found = body.get_transform(BONE + ISB, BONE)
    assert found[:3, :3] == pytest.approx(Rotation.from_quat(transform.rotation).as_matrix(), abs=1e-15)
    assert found[:3, 3].tolist() == list(transform.translation)


def test_shank_and_thigh_stand_in_line_at_full_extension(body: Any) -> None:
    extended = thigh_at(body, 0.0)
    assert extended[:3, 3] == pytest.approx([0.0, load_parameters({}).femur.radius, 0.0], abs=1e-15)
    assert extended[:3, 2] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)  # up is superior
    assert extended[:3, 0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)  # forward is anterior


@pytest.mark.parametrize("angle", [0.1, 1.0, 2.6])
def test_the_thigh_turns_as_the_femur_does(body: Any, angle: float) -> None:
    """Counter-clockwise with x to the right and y up: about the tibia frame's z axis."""
    extended, flexed = thigh_at(body, 0.0), thigh_at(body, angle)
    turn = flexed[:3, :3] @ extended[:3, :3].T
    assert turn == pytest.approx(Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix(), abs=1e-15)
    assert flexed[:3, 3].tolist() == extended[:3, 3].tolist()


def test_flexion_has_the_range_of_a_knee(body: Any) -> None:
    (joint,) = [joint for joint in body.robot.joints if joint.type == "revolute"]
    assert joint.name == load_parameters({}).knee.joint_name
    assert np.degrees([joint.limit.lower, joint.limit.upper]) == pytest.approx([0.0, 150.0])


def test_the_layout_shows_what_is_published(body: Any) -> None:
    manager = read_yaml(LAYOUT)["Visualization Manager"]
    displays = {display["Class"]: display for display in manager["Displays"]}
    assert displays["rviz_default_plugins/MarkerArray"]["Topic"]["Value"] == f"/{KNEE_CONTACT_MARKERS}"
    model = displays["rviz_default_plugins/RobotModel"]["Description Topic"]
    assert (model["Value"], model["Durability Policy"]) == ("/robot_description", "Transient Local")
    assert manager["Global Options"]["Fixed Frame"] in body.link_map


def test_the_knee_is_seen_from_its_right_side() -> None:
    """So that anterior is to the right on the screen, as everywhere here; RViz puts its eye where the angles say."""
    view = read_yaml(LAYOUT)["Visualization Manager"]["Views"]["Current"]
    yaw, pitch = float(view["Yaw"]), float(view["Pitch"])
    eye = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)])
    transform = isb_transform(BONE + ISB)
    assert transform
    to_the_right = Rotation.from_quat(transform.rotation).apply([0.0, 0.0, 1.0])
    assert eye == pytest.approx(to_the_right, abs=1e-6)  # the angle is written with six decimals
