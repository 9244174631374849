"""A node beside publishers and tools as they are: one start, one fault after another."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState

from knee_contact_ros.node.contact_node import LIVE
from knee_contact_ros.parameters.files import known_parameters
from tests.helpers.messages import header
from tests.ros.conftest import NodeProcess, Peer, RosMessages, call

MS = 1_000_000
OFTEN = 20
"""Number of random changes"""


def set_all(peer: Peer, parameters: list[ParameterMessage]) -> list[tuple[bool, str]]:
    request = SetParameters.Request(parameters=parameters)
    results = call(peer, SetParameters, "/knee_contact/set_parameters", request).results
    return [(result.successful, result.reason) for result in results]


def values_of(peer: Peer, names: list[str]) -> list[ParameterValue]:
    return list(call(peer, GetParameters, "/knee_contact/get_parameters", GetParameters.Request(names=names)).values)


def random_value(dice: random.Random, name: str) -> float | int | str | bool:
    """A value within or beyond the declared range, or of another type."""
    declaration = known_parameters()[name]
    least, most = declaration.limits.least, min(declaration.limits.most, 1e12)
    if dice.random() < 0.15 or not isinstance(declaration.default, (int, float)):
        return dice.choice(["x", True, -1, math.nan, math.inf, 0.0, 1e-250, -1e300])
    value = dice.choice([least, most, dice.uniform(least, most), 10 ** dice.uniform(-9, 9), least - 1.0, 2.0 * most])
    return round(value) if isinstance(declaration.default, int) and abs(value) < 2**62 else float(value)


def test_a_node_tells_what_is_wrong_and_always_answers(peer: Peer, start_node: Callable[..., NodeProcess]) -> None:
    node = start_node("-p", "contact.law:=two_layer_viscoelastic")
    peer.wait_for_node()
    names = list(call(peer, ListParameters, "/knee_contact/list_parameters", ListParameters.Request()).result.names)
    own = [name for name in names if name in known_parameters()]

    def dump() -> list[ParameterMessage]:
        return [ParameterMessage(name=name, value=value) for name, value in zip(own, values_of(peer, own), strict=True)]

    before = dump()
    assert len(own) > 100
    assert set_all(peer, before) == [(True, "")] * len(own)  # as `ros2 param load` of `ros2 param dump` does

    dice, live = random.Random(51), sorted(LIVE - {"record.path"})
    for _ in range(OFTEN):
        name = dice.choice(live)
        (old,) = values_of(peer, [name])
        wanted = Parameter(name, value=random_value(dice, name)).to_parameter_msg()
        ((successful, reason),) = set_all(peer, [wanted])
        (new,) = values_of(peer, [name])
        assert successful or (reason and new == old), (name, wanted)
    assert all(result == (True, "") for result in set_all(peer, [each for each in before if each.name in live]))

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
