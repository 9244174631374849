"""Why an input is silent: the sentence names what is there, and a line that the node then accepts."""

import re

import pytest

from knee_contact_ros.node.inputs import installed_types
from knee_contact_ros.node.silence import reason_of_silence
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.sources import (
    JOINT_STATE_TYPE,
    WRENCH_STAMPED_TYPE,
    source_of,
)
from knee_contact_ros.streams.conversion import converters

OTHERS = {"/rosout": {"rcl_interfaces/msg/Log"}, "/tf": set[str]()}


def reason_for_force(graph, topic="ft"):
    source = source_of(topic, WRENCH_STAMPED_TYPE)
    return reason_of_silence(
        "load.source", source, f"/{topic}", JOINT_STATE_TYPE, 0, OTHERS | graph
    )


def reason_for_angle(graph, joints=1):
    source = source_of("joint_states", JOINT_STATE_TYPE)
    return reason_of_silence(
        "knee.source", source, "/joint_states", WRENCH_STAMPED_TYPE, joints, OTHERS | graph
    )


@pytest.mark.parametrize(
    ("kind", "line"),
    [
        ("std_msgs/msg/Float64", "data on arrival"),
        ("std_msgs/msg/Float32MultiArray", None),
        (
            "geometry_msgs/msg/Wrench",
            "force.x, force.y, force.z, torque.x, torque.y, torque.z on arrival",
        ),
        ("geometry_msgs/msg/Vector3Stamped", "vector.x, vector.y, vector.z"),
        ("sensor_msgs/msg/FluidPressure", None),
        ("sensor_msgs/msg/Range", None),
    ],
)
def test_another_type_of_force_is_named_with_a_line_that_works(kind, line):
    text = reason_for_force({"/ft": {kind}})
    assert (
        f"{kind} is published there, and not {WRENCH_STAMPED_TYPE}; write load.source: ft " in text
    )
    written = re.search(r"write load.source: (.*)", text)
    assert written
    value = written[1]
    if line is None:
        before, _, behind = value.partition(", with one of ")
        field = behind.split(", ")[0]
        value = before.replace("FIELD", field)
    else:
        assert value.endswith(line)
    converters(load_parameters({"load.source": value}), installed_types)


def test_an_encoder_of_one_number_is_named_with_its_line():
    text = reason_for_angle({"/joint_states": {"std_msgs/msg/Float64"}})
    assert text.endswith("write knee.source: joint_states std_msgs/Float64 data on arrival")
    assert "FIELD" in reason_for_angle({"/joint_states": {"std_msgs/msg/Float64"}}, joints=2)


def test_what_cannot_be_read_is_said():
    assert reason_for_force({"/ft": {"exo_msgs/msg/Force"}}).endswith(
        "and the ROS 2 package exo_msgs is not installed here"
    )
    assert reason_for_force({"/ft": {"std_msgs/msg/String"}}).endswith("that type has no number")


def test_swapped_topics_are_said():
    swapped = "the type of the other input: are the two swapped?"
    assert swapped in reason_for_force({"/ft": {JOINT_STATE_TYPE}})
    assert swapped in reason_for_angle({"/joint_states": {WRENCH_STAMPED_TYPE}})


def test_a_misspelt_name_is_told_the_right_one():
    one = {"/exo/ft": {WRENCH_STAMPED_TYPE}}
    assert reason_for_force(one).endswith("is on /exo/ft: write load.source: /exo/ft")
    two = one | {"/exo/left_ft": {WRENCH_STAMPED_TYPE}}
    assert reason_for_force(two, "exo/f").endswith("did you mean /exo/ft?")
    assert reason_for_force(two, "elsewhere").endswith("is on /exo/ft, /exo/left_ft")
    other = {"/exo/ft_sensor": {"std_msgs/msg/Float64"}}
    assert reason_for_force(other, "exo/ft_senso").endswith("did you mean /exo/ft_sensor?")
    assert reason_for_force({}).endswith("nobody publishes that type")


def test_right_types_and_an_empty_graph():
    assert reason_for_force({"/ft": {WRENCH_STAMPED_TYPE}}) == ""
    source = source_of("humans/*/ft", WRENCH_STAMPED_TYPE)
    arguments = "load.source", source, "/humans/*/ft", JOINT_STATE_TYPE, 0
    assert reason_of_silence(*arguments, {"/humans/a/ft": {WRENCH_STAMPED_TYPE}}) == ""
    assert "no other node publishes anything" in reason_of_silence(*arguments, {"/tf": set()})
