"""What the demo from sensors puts into the joint states, and how it compares contacts; it itself: `tests/ros`."""

import pytest

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.load_pipeline import joints_of, leg_sample
from knee_contact_ros.streams.messages import JointState, decode_joint_state, encode_joint_state

pytest.importorskip("rclpy", reason="the demo needs ROS")

from knee_contact_ros.commands.demo import with_assistance


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("effort", [(), (7.0, 8.0)])
def test_an_extending_torque_reaches_the_estimator_as_one(sign, effort):
    parameters = load_parameters({"knee.sign": sign, "knee.assisted": True}, LoadParameters)
    data = encode_joint_state(JointState(5, "", ("hip", "knee"), (0.1, 0.2), (), effort))
    message = decode_joint_state(with_assistance(data, parameters.knee, 6.0))
    assert message.effort == ((*effort, 0.0)[0], -6.0 * sign)
    sample = leg_sample(message, parameters, b"", 0)
    assert joints_of(sample.angle, sample.others).knee_assistance == 6.0
