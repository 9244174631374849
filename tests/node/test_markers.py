"""Markers for RViz: they are where the answer says. What the node publishes: `tests/ros/test_streams.py`."""

from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES
from knee_contact_ros.model.types import ContactState
from knee_contact_ros.node.marker_topic import METRES_PER_NEWTON, KneeMarkers
from knee_contact_ros.streams.topics import typestore
from knee_contact_ros.view.anatomy import PLATEAU_REACH, outlines_of
from knee_contact_ros.view.colours import STATE_COLOURS
from tests.helpers.answers import contact
from tests.helpers.markers import distance, drawn, place_of, sagitta

TIME = np.arange(0.0, 0.3, 0.03)
ANGLE = np.linspace(0.0, 0.9, len(TIME))
LOAD = np.where(TIME < 0.15, 900.0, -60.0)
"""Pressed, then pulled apart"""
FILES = {
    "femur.profile": "femur_medial.csv",
    "tibia.profile": "tibia_medial.csv",
    "translation.table": "translation_medial.csv",
}
FEMUR, TIBIA, POINT, FORCE = (
    f"knee/{name}" for name in ("femur", "tibia", "contact_point", "contact_force_on_femur")
)


def read(markers, frame_id, answer):
    data = markers.encode_markers(answer.stamp, frame_id, [answer.tobytes()])
    message: Any = typestore().deserialize_cdr(data, "visualization_msgs/msg/MarkerArray")
    assert {marker.header.frame_id for marker in message.markers} == {frame_id}
    assert len({marker.ns for marker in message.markers}) == len(message.markers) == 4
    return {marker.ns: marker for marker in message.markers}


@pytest.mark.parametrize("mechanism", MECHANISMS)
@pytest.mark.parametrize("tibia", TIBIAL_GEOMETRIES)
@pytest.mark.parametrize("femur", GEOMETRIES)
def test_surfaces_meet_as_deep_as_the_answer_says(femur, tibia, mechanism):
    names = {"femur.geometry": femur, "tibia.geometry": tibia, "translation.mechanism": mechanism}
    slope = {"tibia.slope": 0.1} if tibia == "plane" else {}
    model = knee_contact_ros.load_model(FILES | names | slope)
    series = model.run(TIME, ANGLE, LOAD)
    assert {0, 1} == {int(state) for state in series.contact_state}
    assert (
        sagitta(model.pair.femur.outline()) < 0.02 * series.penetration_depth.max()
    )  # else it would say nothing
    knee = KneeMarkers([outlines_of(model, "knee", 700.0)])
    for answer in series:
        markers = read(knee, "tibia", answer)
        surface, plateau = drawn(markers[FEMUR]), drawn(markers[TIBIA])
        point = place_of(markers[POINT])
        assert (point == [answer.contact_point.x, answer.contact_point.y, 0.0]).all()
        # What is drawn are corners on the surfaces, between which these bulge.
        if abs(point[0]) < PLATEAU_REACH:
            assert distance(point, plateau) <= 1.01 * sagitta(plateau) + 1e-12
        overlap = answer.penetration_depth - answer.gap
        facing = point - overlap * np.array([answer.normal_x, answer.normal_y, 0.0])
        assert distance(facing, surface) <= 1.01 * sagitta(surface) + 1e-12
        # Nothing of the femur lies deeper: no corner of it is beyond the tangent at the deepest point there.
        near = surface[np.linalg.norm(surface - facing, axis=1) < 0.01]
        beyond = (facing - near) @ np.array([answer.normal_x, answer.normal_y, 0.0])
        assert beyond.max() <= sagitta(surface) + 1e-12
        if answer.contact_force:
            begin, end = drawn(markers[FORCE])
            assert markers[FORCE].action == 0
            assert (begin == point).all()
            assert np.linalg.norm(end - begin) == pytest.approx(
                METRES_PER_NEWTON * answer.contact_force, rel=1e-9
            )
            force = np.array(
                [answer.contact_wrench.force.x, answer.contact_wrench.force.y, 0.0]
            )  # on the tibia
            assert end - begin == pytest.approx(-METRES_PER_NEWTON * force, rel=1e-9, abs=1e-12)
        else:
            assert markers[FORCE].action == 2


def test_colour_shows_the_state_and_a_pull_points_the_other_way():
    knee = KneeMarkers([outlines_of(knee_contact_ros.load_model({}), "knee", 700.0)])
    for state in ContactState:
        colour = read(knee, "tibia", contact(contact_state=int(state)))[POINT].color
        assert (
            np.round(255.0 * np.array([colour.r, colour.g, colour.b])).tolist()
            == STATE_COLOURS[state].tolist()
        )
    force = read(knee, "tibia", contact(contact_force=-50.0))[FORCE]
    begin, end = drawn(force)
    assert force.action == 0
    assert end - begin == pytest.approx([0.0, -1e-3, 0.0])


def test_nothing_is_left_of_the_answer_before():
    """One message is written over again and again, in other frames too."""
    markers = KneeMarkers([outlines_of(knee_contact_ros.load_model({}), "knee", 700.0)])
    apart = {
        "contact_force": 0.0,
        "contact_state": 0,
        "flexion_angle": 1.0,
        "femoral_height": 0.04,
    }
    answers = [
        contact(),
        contact(**apart),
        contact(stamp=5, contact_point=(0.02, 0.01, 0.0)),
        contact(contact_state=2),
    ]
    for frame_id in ("tibia_l", "tibia_l", "a longer name", "tibia_r"):
        for answer in answers:
            alone = KneeMarkers([outlines_of(knee_contact_ros.load_model({}), "knee", 700.0)])
            assert str(read(markers, frame_id, answer)) == str(read(alone, frame_id, answer))
