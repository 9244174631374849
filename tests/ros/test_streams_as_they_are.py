"""A node beside publishers and tools as they are: one start, one fault after another."""

from __future__ import annotations

from collections.abc import Callable

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import JointState

from knee_contact_ros.parameters.files import known_parameters
from tests.helpers.messages import header
from tests.ros.conftest import NodeProcess, Peer, RosMessages, call

MS = 1_000_000


def test_a_node_tells_what_is_wrong_and_always_answers(peer: Peer, start_node: Callable[..., NodeProcess]) -> None:
    node = start_node("-p", "contact.law:=two_layer_viscoelastic")
    peer.wait_for_node()
    names = list(call(peer, ListParameters, "/knee_contact/list_parameters", ListParameters.Request()).result.names)
    own = [name for name in names if name in known_parameters()]

    values = call(peer, GetParameters, "/knee_contact/get_parameters", GetParameters.Request(names=own)).values
    before = [ParameterMessage(name=name, value=value) for name, value in zip(own, values, strict=True)]
    assert len(own) > 100
    request = SetParameters.Request(parameters=before)  # as `ros2 param load` of `ros2 param dump` does
    results = call(peer, SetParameters, "/knee_contact/set_parameters", request).results
    assert {(result.successful, result.reason) for result in results} == {(True, "")}

    other = peer.node.create_publisher(JointState, "joint_states", 100)
    peer.wait_until(other.get_subscription_count)

    def alternate(start: int) -> int:
        for stamp in range(start, start + 100 * 5 * MS, 5 * MS):
            peer.send(stamp, 0.8, 900.0)
            message = JointState(header=header(RosMessages, stamp + MS, ""), name=["knee"], position=[0.0])
            other.publish(message)
            peer.spin(0.002)  # else all of one come before all of the other
        return start + 100 * 5 * MS

    now = [10**18]

    def told(entry: str, words: str) -> Callable[[], bool]:
        def look() -> bool:
            now[0] = alternate(now[0])
            return words in peer.problems.get(f"knee_contact: {entry}", "")

        return look

    peer.wait_until(told("joint_states", "publishers send it and disagree"))
    peer.node.destroy_publisher(other)
    for _ in range(20):
        message = JointState(header=header(RosMessages, now[0], ""), name=["hip", "knee"], position=[0.1])
        peer.angle.publish(message)
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: refused samples", {}).get("lengths_differ") == "20")
    _, output = node.stop()
    assert "the joint 'knee' of joint_states goes back and forth by about 0.80 rad between samples" in output
    assert "2 names and 1 values of position: it is not clear which value belongs to which joint" in output
    assert "this should not happen" not in output
