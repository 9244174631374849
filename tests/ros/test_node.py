"""The node over real topics: answers, faults, parameters, life cycle, files."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

import knee_contact_ros
from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import MESSAGE_TYPES, RECORDED
from knee_contact_ros.system.files import not_installed
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.system.ros import NO_EVENTS
from tests.helpers.answers import FIELDS
from tests.helpers.messages import RosMessages
from tests.helpers.needs import needs_viewer
from tests.helpers.sockets import internet_sockets
from tests.ros.conftest import PATIENCE, NodeProcess, Peer, call, own_words
from tests.ros.series import ANGLES, AXIAL, STAMPS, STEP, send_all

Start = Callable[..., NodeProcess]


@pytest.mark.parametrize("name", ["healthy.yaml", "osteoarthritis.yaml"])
def test_the_node_gives_the_bits_of_the_python_calls(peer: Peer, start_node: Start, config: Path, name: str) -> None:
    start_node("--params-file", name)  # one of the package's own
    peer.wait_for_node()
    send_all(peer)
    series = knee_contact_ros.load_model(config / name).run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    for field in FIELDS:
        if field != "contact_point":
            assert np.array_equal(series[field], [getattr(contact, field) for contact in peer.contacts]), field
    assert [contact.header.frame_id for contact in peer.contacts] == ["tibia_r"] * len(STAMPS)
    assert [-wrench.wrench.force.y for wrench in peer.wrenches] == series.contact_force.tolist()


def test_the_private_graph_stays_on_the_loopback_interface(peer: Peer, start_node: Start) -> None:
    node = start_node()
    peer.wait_for_node()
    sockets = internet_sockets(psutil.Process(node.process.pid))
    assert sockets
    assert {socket.laddr.ip for socket in sockets} == {"127.0.0.1"}


def test_replay_feeds_the_node_a_bag(
    peer: Peer, start_node: Start, right_bag: Path, config: Path, tmp_path: Path
) -> None:
    node = start_node("--params-file", config / "healthy.yaml", "-p", f"record.path:={tmp_path / 'live.mcap'}")
    peer.wait_for_node()  # which compiles first on a new machine, for longer than a replay waits
    command = [
        sys.executable,
        "-m",
        "knee_contact_ros.commands.main",
        "replay",
        str(right_bag),
        "--rate",
        "5",
        "--clock",
    ]
    replay = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (replay.returncode, own_words(replay.stderr)) == (0, "")
    assert replay.stdout.startswith("774 messages published")
    peer.wait_until(lambda: len(peer.contacts) == 387)
    code, output = node.stop()
    assert code == 0, output
    assert "387 ticks, 0 samples refused" in output
    solve(right_bag, load_parameters(config / "healthy.yaml"), tmp_path / "offline.mcap", lambda done, total: None)
    types = {f"/{topic}": MESSAGE_TYPES[topic] for topic in RECORDED}
    live, offline = (
        [(m.topic, m.log_time, str(m.message)) for m in read_bag(tmp_path / name, types)]
        for name in ("live.mcap", "offline.mcap")
    )
    assert live == offline


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
            send_all(peer)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(PATIENCE)
    assert (process.returncode, recording.exists()) == (0, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-p", "contact.damping:=-1.0"], "parameter contact.damping: -1.0 is not allowed"),
        (["-p", "contact.damping:=much"], "parameter contact.damping: 'much' is not allowed"),
        (["-p", "contact.dampin:=1.0"], "unknown parameter contact.dampin; did you mean contact.damping?"),
        (["-p", "femur.geometry:=profile", "-p", "femur.profile:=nowhere.csv"], "cannot read nowhere.csv"),
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml: cannot read the parameter file"),
        (["-p", "record.path:=/tmp/kn\udce9e.mcap"], r"'record.path:=/tmp/kn\udce9e.mcap' is no UTF-8"),
        (["-p", "qos_overrides./knee_contact.publisher.depth:=seven"], "knee_contact.publisher.depth: 'seven' is not"),
        (["-p", "qos_overrides./diagnostics.publisher.depth:=-1"], "/diagnostics.publisher.depth: -1 is not allowed"),
        (["-p", "qos_overrides./joint_states.subscription.reliability:=perhaps"], "reliability: 'perhaps' is not"),
        (["-p", "qos_overrides./knee_contact/wrench.publisher.depth:=[1, 2]"], "depth: [1, 2] is not allowed"),
        (
            ["-p", "qos_overrides./joint_states.subscriptoin.depth:=7"],
            "unknown parameter qos_overrides./joint_states.s",
        ),
    ],
)
def test_bad_parameters_end_the_node_at_once(start_node: Start, arguments: list[str], words: str) -> None:
    code, output = start_node(*arguments).wait()
    assert code == 2
    assert len(output.splitlines()) == 1, output
    assert words in output


@pytest.mark.parametrize(
    ("output", "arguments", "words"),
    [
        ("recorder", ["record.path:=/proc/no/where.mcap"], "cannot write /proc/no/where.mcap: "),
        pytest.param(
            "viewer",
            ["rerun.mode:=file", "rerun.path:=/dev/null/no.rrd"],
            "cannot write /dev/null/no.rrd: Not a dir",
            marks=needs_viewer,
        ),
        pytest.param(
            "viewer",
            ["rerun.mode:=serve", "rerun.port:={taken}"],
            "rerun.port: {taken} on 127.0.0.1: Address already",
            marks=needs_viewer,
        ),
        pytest.param(
            "viewer",
            ["rerun.mode:=spawn", "rerun.port:={free}"],
            "no screen for a viewer (DISPLAY is not set)",
            marks=needs_viewer,
        ),
    ],
)
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
        send_all(peer)
        peer.wait_until(lambda: words.format(**ports) in peer.problems.get(f"knee_contact: {output}", ""))
        code, said = node.stop()
    assert code == 0
    assert ["[ERROR]" in line for line in said.splitlines() if words.format(**ports) in line] == [True]
    assert "Traceback" not in said


@pytest.mark.parametrize("mode", ["file", "serve", "spawn"])
def test_a_node_without_rerun_tells_what_to_install(start_node: Start, tmp_path: Path, mode: str) -> None:
    arguments = ["-p", f"record.path:={tmp_path / 'new.mcap'}", "-p", f"rerun.mode:={mode}", "-p", "rerun.path:=x.rrd"]
    code, output = start_node(*arguments, without="rerun_cli").wait()
    assert code == 2
    assert output == (f"knee-contact: parameter rerun.mode: {mode}: {not_installed('rerun-sdk', 'viewer')}\n")
    assert not list(tmp_path.iterdir())


def test_an_older_rclpy_without_the_events_executor_will_do(
    peer: Peer, start_node: Start, config: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "out.mcap"
    node = start_node(
        "--params-file", config / "healthy.yaml", "-p", f"record.path:={recording}", without="rclpy.experimental"
    )  # fmt: skip
    peer.wait_for_node()
    send_all(peer)
    series = knee_contact_ros.load_model(config / "healthy.yaml").run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    assert [contact.penetration_depth for contact in peer.contacts] == series.penetration_depth.tolist()
    assert call(peer, Trigger, "/knee_contact/stop_recording", Trigger.Request()).success
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("ticks") == str(len(STAMPS)))
    code, output = node.stop()
    assert (code, recording.exists()) == (0, True)
    assert output.count(NO_EVENTS) == 1
    assert "Traceback" not in output
