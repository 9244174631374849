"""The topic of strides: the numbers of Python and of the report, once a stride, while somebody listens."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.node.contact_node import encode_stride
from knee_contact_ros.streams.strides import Span, Stride, strides_of
from tests.ros.conftest import Peer, Start
from tests.streams.test_gait_events import BODY_WEIGHT, walking


def test_each_stride_is_told_once_with_the_numbers_of_python(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    strides: list[JointState] = []
    peer.node.create_subscription(JointState, "knee_contact/stride", strides.append, 10)
    weight = ["-p", f"body_weight:={BODY_WEIGHT}", "-p", "load.compartment:=total", "-p", "pairing.wait:=5.0"]
    node = start_node("-p", f"record.path:={tmp_path / 'live.mcap'}", *weight)
    peer.wait_for_node()
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact/stride"))
    peer.spin(0.5)  # the node sees the subscription
    stamps, angle, load = walking(100.0, 8.0)
    for stamp, flexion, axial in zip(stamps.tolist(), angle.tolist(), load.tolist(), strict=True):
        peer.send(stamp, flexion, axial)
        peer.spin(0.002)
    peer.wait_until(lambda: len(peer.contacts) == len(stamps))
    peer.wait_until(lambda: len(strides) >= 5)
    assert node.stop()[0] == 0
    known = strides_of(read_answers(tmp_path / "live.mcap"), BODY_WEIGHT)
    assert len(strides) in (len(known) - 1, len(known))  # the end of a run may make a last one certain
    for message, stride in zip(strides, known, strict=False):
        numbers = dict(zip(message.name, message.position, strict=True))
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stride.span.end
        names = ("peak_force", "peak_depth", "impulse", "stance_impulse", "loading_rate", "usable")
        assert [numbers[name] for name in names] == [float(getattr(stride, name)) for name in names]
        assert numbers["stride_time"] == stride.span.duration
        assert numbers["stance_time"] == pytest.approx(0.01 * stride.span.stance * stride.span.duration, rel=1e-12)
        assert 0.2 < numbers["phase"] * numbers["stride_time"] < 0.7  # [s] after the heel strike


@pytest.mark.parametrize(("now", "phase"), [(2.5, 0.5), (2.0, 0.0), (1.9, math.nan), (3600.0, math.nan)])
def test_the_phase_is_not_told_where_stamps_have_jumped(now: float, phase: float) -> None:
    stride = Stride(Span(10**9, 16 * 10**8, 2 * 10**9), 1.0, 1.0, 1.0, 1.0, 1.0, usable=True, sliding_distance=0.0)
    message = deserialize_message(encode_stride(stride, "", round(now * 1e9)), JointState)
    assert message.position[message.name.index("phase")] == pytest.approx(phase, nan_ok=True)
