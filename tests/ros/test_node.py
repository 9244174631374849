"""The node over real topics: answers, faults, parameters, life cycle, files."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

import knee_contact_ros
from knee_contact_ros.core.types import Contact, Status
from knee_contact_ros.parameters import load_parameters
from knee_contact_ros.solve import solve
from knee_contact_ros.stream_in.bag import read_bag
from knee_contact_ros.topics import MESSAGE_TYPES
from tests.ros.conftest import NodeProcess, Peer, call

Start = Callable[..., NodeProcess]
STEP = 5_000_000
STAMPS = np.arange(40) * STEP
ANGLES = 0.2 + 0.3 * np.sin(STAMPS * 3e-9)
AXIAL = 1500.0 + 900.0 * np.sin(STAMPS * 2e-8)


def send_all(peer: Peer) -> None:
    """Publish the little series above and wait for its answers."""
    for stamp, angle, axial in zip(STAMPS.tolist(), ANGLES.tolist(), AXIAL.tolist(), strict=True):
        peer.send(stamp, angle, axial)
    peer.wait_until(lambda: len(peer.contacts) == len(STAMPS) and len(peer.wrenches) == len(STAMPS))


@pytest.mark.parametrize("name", ["healthy.yaml", "osteoarthritis.yaml"])
def test_the_node_gives_the_bits_of_the_python_calls(peer: Peer, start_node: Start, config: Path, name: str) -> None:
    start_node("--params-file", config / name)
    peer.wait_for_node()
    send_all(peer)
    series = knee_contact_ros.load_model(config / name).run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    for field in Contact._fields:
        if field != "contact_point":
            assert np.array_equal(series[field], [getattr(contact, field) for contact in peer.contacts]), field
    assert [contact.header.frame_id for contact in peer.contacts] == ["tibia_r"] * len(STAMPS)
    assert [-wrench.wrench.force.y for wrench in peer.wrenches] == series.contact_force.tolist()


def test_faulty_samples_are_refused_counted_and_the_node_goes_on(peer: Peer, start_node: Start) -> None:
    start_node("-p", "pairing.wait:=5.0")
    peer.wait_for_node()
    peer.send(0, 0.2, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == 1)  # nothing orders the samples of two topics
    peer.send(STEP, 0.2, float("nan"))
    peer.send_angle(2 * STEP, float("inf"))
    peer.send_angle(2 * STEP, 0.2, joint="elbow")
    peer.spin(0.3)
    peer.send(2 * STEP, 0.2, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == 2)
    peer.send_force(2 * STEP, 1000.0)
    peer.spin(0.3)
    peer.send(3 * STEP, 0.2, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == 3)
    stamps = [contact.header.stamp.nanosec for contact in peer.contacts]
    assert stamps == [0, 2 * STEP, 3 * STEP]
    assert [contact.status for contact in peer.contacts] == [0, Status.INPUT_REJECTED, Status.INPUT_REJECTED]
    expected = {"total": "4", "not_finite": "2", "joint_missing": "1", "load_not_in_order": "1"}
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: refused samples") == expected)
    # The refusals may have been told already before the third tick came.
    peer.wait_until(lambda: peer.diagnostics["knee_contact: ticks"]["ticks"] == "3")


def test_a_force_whose_angle_is_late_is_answered_with_the_last_one(peer: Peer, start_node: Start) -> None:
    start_node("-p", "pairing.wait:=0.2")
    peer.wait_for_node()
    peer.send(0, 0.2, 1000.0)
    peer.send_force(STEP, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == 2)
    assert peer.contacts[1].status == Status.INPUT_HELD
    assert peer.contacts[1].flexion_angle == 0.2


def test_knees_in_namespaces_differ_in_diagnostics(peer: Peer, start_node: Start) -> None:
    start_node("-r", "__ns:=/left")
    start_node("-r", "__ns:=/right")
    peer.wait_until(lambda: {"left/knee_contact: ticks", "right/knee_contact: ticks"} <= set(peer.diagnostics))


def test_a_looped_stream_starts_anew(peer: Peer, start_node: Start) -> None:
    start_node()
    peer.wait_for_node()
    for number, stamp in enumerate((0, STEP, 200 * STEP, 0, STEP), start=1):
        peer.send(stamp, 0.2, 1000.0 + stamp * 1e-5)
        peer.wait_until(lambda number=number: len(peer.contacts) == number)  # nothing orders samples of two topics
    statuses = [contact.status for contact in peer.contacts]
    assert statuses == [0, 0, Status.STALE_INPUT, Status.TIME_RESET, 0]
    assert peer.contacts[3].penetration_depth == peer.contacts[0].penetration_depth


def test_the_private_graph_stays_on_the_loopback_interface(peer: Peer, start_node: Start) -> None:
    node = start_node()
    peer.wait_for_node()
    sockets = psutil.Process(node.process.pid).net_connections(kind="inet")
    assert sockets
    assert {socket.laddr.ip for socket in sockets} == {"127.0.0.1"}


def test_replay_feeds_the_node_a_bag(
    peer: Peer, start_node: Start, right_bag: Path, config: Path, tmp_path: Path
) -> None:
    node = start_node("--params-file", config / "healthy.yaml", "-p", f"record.path:={tmp_path / 'live.mcap'}")
    peer.wait_for_node()  # which compiles first on a new machine, for longer than a replay waits
    command = [sys.executable, "-m", "knee_contact_ros.cli", "replay", str(right_bag), "--rate", "5", "--clock"]
    replay = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (replay.returncode, replay.stderr) == (0, "")
    assert replay.stdout.startswith("774 messages published")
    time.sleep(0.5)
    code, output = node.stop()
    assert code == 0, output
    assert "387 ticks, 0 samples refused" in output
    solve(right_bag, load_parameters(config / "healthy.yaml"), tmp_path / "offline.mcap", lambda done, total: None)
    types = {f"/{topic}": name for topic, name in MESSAGE_TYPES.items()}
    live, offline = (
        [(m.topic, m.log_time, str(m.message)) for m in read_bag(tmp_path / name, types)]
        for name in ("live.mcap", "offline.mcap")
    )
    assert live == offline


def test_a_full_disk_stops_the_recording_and_not_the_node(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    node = start_node("-p", f"record.path:={tmp_path / 'live.mcap'}", largest_file=8 * 1024)
    peer.wait_for_node()
    for i in range(400):
        peer.send(i * STEP, 0.2, 1000.0 + i)
        peer.spin(0.001)
    peer.wait_until(lambda: len(peer.contacts) == 400)
    code, output = node.stop()
    assert code == 0
    assert output.count("live.mcap stopped: File too large") == 1
    assert "400 ticks" in output
    assert not (tmp_path / "live.mcap").exists()


def test_a_silent_input_is_named(peer: Peer, start_node: Start) -> None:
    node = start_node("-r", "joint_states:=/exo/joint_states")
    peer.wait_until(lambda: peer.force.get_subscription_count() and peer.node.count_publishers("/diagnostics"))
    peer.send_force(0, 1000.0)
    peer.wait_until(lambda: peer.problems.get("knee_contact: joint_states") == "nothing received yet")
    peer.wait_until(lambda: "silent for" in peer.problems.get("knee_contact: joint_reaction_force", ""))
    peer.spin(6.0)
    _, output = node.stop()
    assert "listening to /exo/joint_states and /joint_reaction_force" in output
    assert output.count("nothing received on /exo/joint_states") == 1


def test_simulated_time_that_stands_still_does_not_stop_the_node(peer: Peer, start_node: Start) -> None:
    start_node("-p", "use_sim_time:=true", "-p", "pairing.wait:=0.2")
    peer.wait_for_node()
    peer.send(0, 0.2, 1000.0)
    peer.send_force(STEP, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == 2)
    peer.wait_until(lambda: "knee_contact: ticks" in peer.diagnostics)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_completes_the_files(peer: Peer, start_node: Start, tmp_path: Path, number: signal.Signals) -> None:
    recording, picture = tmp_path / "bag" / "bag_0.mcap", tmp_path / "knee.rrd"
    node = start_node(
        "-p", f"record.path:={recording}", "-p", "rerun.mode:=file", "-p", f"rerun.path:={picture}"
    )  # fmt: skip
    peer.wait_for_node()
    send_all(peer)
    peer.send_angle(int(STAMPS[-1]) + STEP, 0.1)  # an input without an answer
    peer.spin(0.3)
    code, output = node.stop(number)
    assert code == 0, output
    assert "40 ticks, 0 samples refused" in output
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["bag", "bag_0.mcap", "knee.rrd", "metadata.yaml"]
    messages = read_bag(recording.parent, {f"/{topic}": name for topic, name in MESSAGE_TYPES.items()})
    count = {f"/{topic}": sum(m.topic == f"/{topic}" for m in messages) for topic in MESSAGE_TYPES}
    assert count == {"/joint_states": 41, "/joint_reaction_force": 40, "/knee_contact": 40, "/knee_contact/wrench": 40}
    recorded = [m.message.penetration_depth for m in messages if m.topic == "/knee_contact"]
    assert recorded == [contact.penetration_depth for contact in peer.contacts]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "contact.damping:=-1.0"], "parameter contact.damping: -1.0 is not allowed"),
        (["-p", "contact.damping:=much"], "parameter contact.damping: 'much' is not allowed"),
        (["-p", "contact.dampin:=1.0"], "unknown parameter contact.dampin; did you mean contact.damping?"),
        (["-p", "femur.geometry:=profile", "-p", "femur.profile:=nowhere.csv"], "cannot read nowhere.csv"),
        (["-p", "record.path:=/proc/no/where.mcap"], "cannot write /proc/no/where.mcap"),
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml: cannot read the parameter file"),
    ],
)
def test_bad_parameters_end_the_node_at_once(start_node: Start, arguments: list[str], words: str) -> None:
    code, output = start_node(*arguments).wait()
    assert code == 2
    assert len(output.splitlines()) == 1, output
    assert words in output


def test_an_existing_recording_is_not_overwritten(start_node: Start, tmp_path: Path) -> None:
    (tmp_path / "out.mcap").write_text("precious")
    code, output = start_node("-p", f"record.path:={tmp_path / 'out.mcap'}").wait()
    assert (code, (tmp_path / "out.mcap").read_text()) == (2, "precious")
    assert "exists already" in output


def test_outputs_are_opened_all_or_none(start_node: Start, tmp_path: Path) -> None:
    (tmp_path / "old.rrd").touch()
    code, output = start_node(
        "-p", f"record.path:={tmp_path / 'new.mcap'}",
        "-p", "rerun.mode:=file", "-p", f"rerun.path:={tmp_path / 'old.rrd'}",
    ).wait()  # fmt: skip
    assert code == 2
    assert "old.rrd exists already" in output
    assert [path.name for path in tmp_path.iterdir()] == ["old.rrd"]


def test_the_life_cycle_is_ros_2s(peer: Peer, start_node: Start) -> None:
    start_node("-p", "autostart:=false")

    def state() -> int:
        return call(peer, GetState, "/knee_contact/get_state", GetState.Request()).current_state.id

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return call(peer, ChangeState, "/knee_contact/change_state", request).success

    def set_parameter(name: str, value: object) -> tuple[bool, str]:
        parameter = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        result = call(peer, SetParameters, "/knee_contact/set_parameters", request).results[0]
        return result.successful, result.reason

    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert set_parameter("contact.damping", -5.0) == (
        False,
        "parameter contact.damping: -5.0 is not allowed; it should be greater than or equal to 0",
    )
    assert set_parameter("contact.damping", 0.0) == (True, "")
    assert set_parameter("femur.profile", "nowhere.csv") == (True, "")
    assert set_parameter("femur.geometry", "profile") == (True, "")
    assert not change(Transition.TRANSITION_CONFIGURE)  # there is no such profile
    assert state() == State.PRIMARY_STATE_UNCONFIGURED
    assert set_parameter("femur.geometry", "circle") == (True, "")
    assert change(Transition.TRANSITION_CONFIGURE)
    refusal = "parameter femur.geometry cannot change while the node is configured, only after a cleanup"
    assert set_parameter("femur.geometry", "profile") == (False, refusal)
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.wait_for_node()
    send_all(peer)
    undamped = knee_contact_ros.load_model({"contact.damping": 0.0}).run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    assert undamped.penetration_depth.tolist() == [contact.penetration_depth for contact in peer.contacts]
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert state() == State.PRIMARY_STATE_INACTIVE
    peer.wait_until(lambda: not peer.force.get_subscription_count())
    assert change(Transition.TRANSITION_CLEANUP)
    assert set_parameter("tibia.slope", 0.0) == (True, "")
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.wait_for_node()
    peer.contacts.clear()
    peer.wrenches.clear()
    send_all(peer)
    assert peer.contacts[0].status == 0
    assert change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state() == State.PRIMARY_STATE_FINALIZED
