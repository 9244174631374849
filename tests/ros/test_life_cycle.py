"""The managed node: its states, what each transition answers, completes and forgets, and what ends the process."""

import os
import signal

import psutil
import pytest
from lifecycle_msgs.msg import State

import knee_contact_ros
from knee_contact_ros.model.types import Status
from tests.ros.conftest import (
    ANGLES,
    AXIAL,
    STAMPS,
    answers_in,
    change_state,
    set_parameters,
    state_of,
    trigger,
)

MILLISECOND = 1_000_000


def test_the_life_cycle_is_ros_2s(peer, start_node, tmp_path):
    node = start_node("autostart:=false", f"record.path:={tmp_path / 'first.mcap'}")

    def set_parameter(name, value):
        return set_parameters(peer, {name: value})

    assert state_of(peer) == State.PRIMARY_STATE_UNCONFIGURED
    accepted, reason = set_parameter(
        "contact.damping", -5.0
    )  # in rclpy's words, by the range that we declare
    assert not accepted
    assert all(word in reason for word in ("contact.damping", "Min: 0.0", "value: -5.0"))
    assert set_parameter("contact.damping", 0.0) == (True, "")
    assert set_parameter("femur.profile", "nowhere.csv") == (True, "")
    assert set_parameter("femur.geometry", "profile") == (True, "")
    assert not change_state(peer, "configure")  # there is no such profile
    assert state_of(peer) == State.PRIMARY_STATE_UNCONFIGURED
    assert set_parameter("femur.geometry", "circle") == (True, "")
    assert change_state(peer, "configure")
    refusal = (
        "parameter femur.geometry cannot change while the node is configured, only after a cleanup"
    )
    assert set_parameter("femur.geometry", "profile") == (False, refusal)
    assert change_state(peer, "activate")
    peer.wait_for_node()
    peer.send_series()
    undamped = knee_contact_ros.load_model({"contact.damping": 0.0}).run(
        STAMPS / 1e9, ANGLES, 0.5 * AXIAL
    )
    assert undamped.penetration_depth.tolist() == [
        contact.penetration_depth for contact in peer.contacts
    ]
    assert change_state(peer, "deactivate")
    assert state_of(peer) == State.PRIMARY_STATE_INACTIVE
    peer.wait_until(lambda: not peer.force.get_subscription_count())
    assert change_state(peer, "cleanup")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first.mcap", "metadata.yaml"]
    assert not psutil.Process(node.process.pid).children()
    peer.wait_until(lambda: not peer.node.count_publishers("knee_contact"))
    assert set_parameter("tibia.slope", 0.0) == (True, "")
    assert set_parameter("record.path", str(tmp_path / "second.mcap")) == (True, "")
    assert change_state(peer, "configure")
    assert change_state(peer, "activate")
    peer.wait_for_node()
    peer.contacts.clear()
    peer.wrenches.clear()
    peer.send_series()
    assert peer.contacts[0].status == 0
    assert change_state(peer, "shutdown")
    assert state_of(peer) == State.PRIMARY_STATE_FINALIZED
    first = answers_in(tmp_path / "first.mcap")
    assert [answer.penetration_depth for answer in first] == undamped.penetration_depth.tolist()
    assert answers_in(tmp_path / "second.mcap") == peer.contacts
    node.stop()


def test_time_may_have_gone_anywhere_while_the_node_was_inactive(peer, start_node):
    """Forces before the last tick are answered from rest, and said so; by no angle of before, if forces come first."""
    start_node("pairing.wait:=5.0")
    peer.wait_for_node()
    begins = (10**10, 5 * 10**9, 0)
    for number, begin in enumerate(begins):
        stamps = [begin + i * 5 * MILLISECOND for i in range(10)]
        if number:
            for transition in ("deactivate", "activate"):
                assert change_state(peer, transition)
            peer.wait_for_node()
            peer.contacts.clear()
        if number == 2:
            for stamp in stamps:
                peer.send_force(stamp, 900.0)
            peer.spin(0.3)
        for stamp in stamps:
            peer.send_angle(stamp, 0.1 * number)
            if number < 2:
                peer.send_force(stamp, 900.0)
        peer.wait_until(lambda: len(peer.contacts) == 10)
        assert [contact.status for contact in peer.contacts] == [
            Status.TIME_RESET if number else 0,
            *[0] * 9,
        ]
        assert {contact.flexion_angle for contact in peer.contacts} == {0.1 * number}


def test_a_transition_that_fails_leaves_the_node_unconfigured(peer, start_node):
    override = "qos_overrides./joint_states.subscription.depth"
    node = start_node("autostart:=false", f"{override}:=seven")
    assert change_state(peer, "configure")
    assert not change_state(peer, "activate")
    assert state_of(peer) == State.PRIMARY_STATE_UNCONFIGURED
    assert change_state(peer, "configure")
    assert change_state(peer, "cleanup")
    assert (
        f"cannot listen: parameter {override}: 'seven' is not allowed; it must be a whole number"
        in node.stop()
    )


def test_forces_that_wait_are_answered_before_the_streams_are_left(peer, start_node, tmp_path):
    """At a reset, when the node is deactivated and when it ends; one recording goes through all of it."""
    recording = tmp_path / "all.mcap"
    node = start_node("pairing.wait:=10.0", f"record.path:={recording}")
    peer.wait_for_node()

    def leave_one_waiting(stamp):
        answered = len(peer.contacts)
        peer.send(stamp, 0.2, 900.0)
        peer.wait_until(lambda: len(peer.contacts) == answered + 1)
        peer.send_force(stamp + 5 * MILLISECOND, 900.0)
        peer.wait_until(lambda: peer.has_received("joint_reaction_force", answered + 2))

    leave_one_waiting(0)
    assert trigger(peer, "reset")[0]
    peer.wait_until(lambda: len(peer.contacts) == 2)
    leave_one_waiting(200 * MILLISECOND)
    assert change_state(peer, "deactivate")
    peer.wait_until(lambda: len(peer.contacts) == 4)
    assert change_state(peer, "activate")
    peer.wait_for_node()
    leave_one_waiting(400 * MILLISECOND)
    node.stop(signal.SIGTERM)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["all.mcap", "metadata.yaml"]
    anew = Status.TIME_RESET
    answers = answers_in(recording)
    assert [answer.status for answer in answers] == [
        0,
        Status.INPUT_HELD,
        *[anew, Status.INPUT_HELD] * 2,
    ]
    assert answers[:4] == peer.contacts[:4]


def test_a_real_time_node_goes_first_while_it_is_active_and_its_outputs_do_not(
    peer, start_node, tmp_path
):
    node = start_node("realtime:=true", f"record.path:={tmp_path / 'knee.mcap'}")
    peer.wait_for_node()
    process = psutil.Process(node.process.pid)

    def policies():
        return {os.sched_getscheduler(thread.id) for thread in process.threads()}

    if os.SCHED_FIFO not in policies():
        assert "real-time scheduling is forbidden here" in node.stop()
        pytest.skip("real-time scheduling is not allowed here")
    assert policies() == {os.SCHED_FIFO}
    (recorder,) = process.children()
    assert os.sched_getscheduler(recorder.pid) == os.SCHED_BATCH
    assert len(recorder.cpu_affinity()) == max(len(process.cpu_affinity()) - 1, 1)
    process.send_signal(signal.SIGXCPU)
    peer.wait_until(lambda: policies() == {os.SCHED_OTHER})
    assert change_state(peer, "deactivate")
    assert change_state(peer, "activate")
    assert policies() == {os.SCHED_FIFO}
    assert "real-time scheduling is off until the next activation" in node.stop()
