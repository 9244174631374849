"""The node over real topics: the bits of the Python calls, of `solve` and of a recording, and what it does without."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock

import knee_contact_ros
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.system.ros import NO_EVENTS
from tests.helpers.answers import FIELDS
from tests.helpers.messages import RosMessages
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import internet_sockets
from tests.ros.conftest import ANGLES, AXIAL, PATIENCE, STAMPS, STEP, Peer, Start, trigger


def assert_bits_of_python(peer: Peer, parameters: str) -> None:
    """Send the little series; the answers are those of the Python calls."""
    peer.send_series()
    series = knee_contact_ros.load_model(parameters).run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    for field in FIELDS:
        if field != "contact_point":
            assert np.array_equal(series[field], [getattr(contact, field) for contact in peer.contacts]), field
    assert [contact.header.frame_id for contact in peer.contacts] == ["tibia_r"] * len(STAMPS)
    assert [-wrench.wrench.force.y for wrench in peer.wrenches] == series.contact_force.tolist()


def test_the_node_gives_the_bits_of_the_python_calls_and_opens_no_port_beyond_loopback(
    peer: Peer, start_node: Start
) -> None:
    node = start_node("--params-file", "osteoarthritis.yaml")  # one of the package's own
    peer.wait_for_node()
    assert_bits_of_python(peer, "osteoarthritis")
    assert {socket.laddr.ip for socket in internet_sockets(psutil.Process(node.process.pid))} == {"127.0.0.1"}


@pytest.mark.parametrize(("library", "words"), [("numba", "Numba cannot be used"), ("rclpy.experimental", NO_EVENTS)])
def test_where_a_library_is_missing_the_node_says_so_once_and_gives_the_same(
    peer: Peer, start_node: Start, tmp_path: Path, library: str, words: str
) -> None:
    """Numba; and the events executor, which older rclpy have not."""
    node = start_node("-p", f"record.path:={tmp_path / 'out.mcap'}", without=library)
    peer.wait_for_node()
    assert_bits_of_python(peer, "healthy")
    assert trigger(peer, "stop_recording")[0]
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("ticks") == str(len(STAMPS)))
    code, output = node.stop()
    assert (code, (tmp_path / "out.mcap").exists()) == (0, True)
    assert output.count(words) == 1
    assert "40 ticks, 0 samples refused" in output
    assert "Traceback" not in output


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


def test_simulated_time_stamps_the_diagnostics_and_nothing_else(peer: Peer, start_node: Start) -> None:
    """At first it stands still, which does not stop the node."""
    start_node("-p", "use_sim_time:=true", "-p", "pairing.wait:=0.2")
    peer.wait_for_node()
    peer.send(0, 0.2, 1000.0)
    peer.send_force(STEP, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == len(peer.wrenches) == 2)
    peer.wait_until(lambda: "knee_contact: ticks" in peer.diagnostics)
    stamps: list[int] = []
    peer.node.create_subscription(DiagnosticArray, "/diagnostics", lambda m: stamps.append(m.header.stamp.sec), 10)
    clock = peer.node.create_publisher(Clock, "/clock", 10)
    # Again and again: a sample goes nowhere if the node has yet to hear of this publisher.
    peer.wait_until(lambda: clock.publish(Clock(clock=RosMessages.Time(sec=12_345))) or 12_345 in stamps)
    peer.send(2 * STEP, 0.2, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == len(peer.wrenches) == 3)
    for answers in (peer.contacts, peer.wrenches):
        assert [answer.header.stamp.nanosec for answer in answers] == [0, STEP, 2 * STEP]


def test_a_node_without_standard_streams_computes(peer: Peer, tmp_path: Path) -> None:
    recording = tmp_path / "bag.mcap"
    node = f"{sys.executable} -m knee_contact_ros.commands.main node --ros-args -p record.path:={recording}"
    with subprocess.Popen(["/bin/sh", "-c", f"exec {node} <&- >&- 2>&-"]) as process:
        try:
            peer.wait_for_node()
            peer.send_series()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
    assert (process.returncode, recording.exists()) == (0, True)


@pytest.mark.parametrize(
    ("output", "arguments", "words"),
    [
        ("recorder", ["record.path:=/proc/no/where.mcap"], "cannot write /proc/no/where.mcap: "),
        pytest.param("viewer", ["rerun.mode:=serve", "rerun.port:={taken}"],
                     "rerun.port: {taken} on 127.0.0.1: Address already", marks=needs_viewer),
        pytest.param("viewer", ["rerun.mode:=spawn", "rerun.port:={free}"],
                     "no screen for a viewer (DISPLAY is not set)", marks=needs_viewer),
    ],
)  # fmt: skip
def test_no_output_keeps_the_node_from_computing(
    peer: Peer, start_node: Start, output: str, arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Told once as an error, and in /diagnostics for as long as it lasts."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ports = {"taken": taken.getsockname()[1], "free": free_port()}
        node = start_node(*(part for rule in arguments for part in ("-p", rule.format(**ports))))
        peer.wait_for_node()
        peer.send_series()
        peer.wait_until(lambda: words.format(**ports) in peer.problems.get(f"knee_contact: {output}", ""))
        code, said = node.stop()
    assert code == 0
    assert ["[ERROR]" in line for line in said.splitlines() if words.format(**ports) in line] == [True]
    assert "Traceback" not in said
