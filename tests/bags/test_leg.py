"""The leg in recordings: what is drawn of it, and where."""

import math

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_answers, read_bag
from knee_contact_ros.bags.leg import POSE_PERIOD, description
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import (
    MESSAGE_TYPES,
    ROBOT_DESCRIPTION,
    TF,
    stamp_to_ns,
    types_of,
)
from tests.helpers.offline import solve


@pytest.fixture(scope="module")
def recording(right_bag, tmp_path_factory):
    path = tmp_path_factory.mktemp("leg") / "out.mcap"
    solve(right_bag, load_parameters(["healthy"]), path)
    return path


def test_the_thigh_is_where_the_answers_have_the_femur(recording):
    answers = read_answers(recording)
    by_stamp = {int(answer["stamp"]): answer for answer in answers}
    moves = [message.message.transforms for message in read_bag(recording, types_of([TF]))]
    stamps = [stamp_to_ns(one.header.stamp) for (one,) in moves]
    assert (
        len({stamp // POSE_PERIOD for stamp in stamps})
        == len(stamps)
        == len({s // POSE_PERIOD for s in by_stamp})
    )
    for stamp, (one,) in zip(stamps, moves, strict=True):
        assert (one.header.frame_id, one.child_frame_id) == ("tibia_r", "tibia_r/thigh")
        place, turn, answer = one.transform.translation, one.transform.rotation, by_stamp[stamp]
        assert (place.x, place.y, place.z) == (0.0, answer["femoral_height"], 0.0)  # a hinge
        assert (turn.x, turn.y) == (0.0, 0.0)
        assert 2.0 * math.atan2(turn.z, turn.w) == pytest.approx(
            answer["flexion_angle"], abs=1e-12
        )


def test_the_description_is_a_leg_whose_condyles_touch_the_plateau(recording):
    yourdfpy = pytest.importorskip(
        "yourdfpy", reason="needs yourdfpy, of the development environment"
    )
    types = {f"/{ROBOT_DESCRIPTION}": MESSAGE_TYPES[ROBOT_DESCRIPTION]}
    (message,) = read_bag(recording, types)
    urdf = recording.with_suffix(".urdf")
    urdf.write_text(message.message.data)
    leg = yourdfpy.URDF.load(str(urdf))
    assert set(leg.link_map) == {"tibia_r", "tibia_r/thigh"}
    for frame, link in (("", "shank"), ('a "b" & <c>', 'a "b" & <c>')):
        urdf.write_text(description(frame)[8:-1].decode())
        assert set(yourdfpy.URDF.load(str(urdf)).link_map) == {link, f"{link}/thigh"}
    plateau, condyles = (
        leg.link_map["tibia_r"].visuals[1],
        leg.link_map["tibia_r/thigh"].visuals[1],
    )
    top = plateau.origin[1, 3] + 0.5 * plateau.geometry.box.size[1]
    assert top == 0.0
    height = read_answers(recording)["femoral_height"]
    assert np.all(np.abs(height - condyles.geometry.cylinder.radius) < 1e-3)
