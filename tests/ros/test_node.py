"""The node over real topics: the bits of the Python calls, of `solve` and of a recording, what it does without, and
what ends it.
"""

import re
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from knee_contact_ros.msg import KneeContact
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

import knee_contact_ros
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.streams.topics import EACH_TICK, recorded_topics, types_of
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.system.ros import NO_EVENTS_EXECUTOR
from tests.helpers.answers import FIELDS
from tests.helpers.forked import COMMAND
from tests.helpers.messages import RosMessages
from tests.helpers.needs import HAS_VIEWER, needs_viewer
from tests.helpers.offline import solve
from tests.helpers.package import WITHOUT_LIBRARY, copy_of_the_package
from tests.helpers.patience import patience
from tests.helpers.processes import has_ended, internet_sockets
from tests.ros.conftest import (
    ANGLES,
    AXIAL,
    STAMPS,
    STEP,
    answers_in,
    raw,
    set_parameters,
    trigger,
)


def assert_bits_of_python(peer, parameters):
    """Send the little series; the answers are those of the Python calls."""
    peer.send_series()
    series = knee_contact_ros.load_model(parameters).run(STAMPS / 1e9, ANGLES, 0.5 * AXIAL)
    for field in FIELDS:
        if field != "contact_point":
            assert np.array_equal(
                series[field], [getattr(contact, field) for contact in peer.contacts]
            ), field
    assert [contact.header.frame_id for contact in peer.contacts] == ["tibia_r"] * len(STAMPS)
    assert [-wrench.wrench.force.y for wrench in peer.wrenches] == series.contact_force.tolist()


def test_the_node_gives_the_bits_of_the_python_calls_and_opens_no_port_beyond_loopback(
    peer, start_node
):
    node = start_node("--params-file", "osteoarthritis.yaml")  # one of the package's own
    peer.wait_for_node()
    assert_bits_of_python(peer, "osteoarthritis")
    assert {socket.laddr.ip for socket in internet_sockets(psutil.Process(node.process.pid))} == {
        "127.0.0.1"
    }


def test_without_the_events_executor_or_numba_the_node_gives_the_same(peer, start_node, tmp_path):
    """Older rclpy lack the executor, which is said once; nobody needs Numba where the library is installed."""
    recording = tmp_path / "out.mcap"
    node = start_node(f"record.path:={recording}", without="numba,rclpy.experimental", anew=True)
    peer.wait_for_node()
    assert_bits_of_python(peer, "healthy")
    assert trigger(peer, "stop_recording")[0]
    peer.wait_until(
        lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("ticks") == str(len(STAMPS))
    )
    output = node.stop()
    assert recording.exists()
    assert output.count(NO_EVENTS_EXECUTOR) == 1
    assert "compiled model" not in output
    assert "40 ticks, 0 samples refused" in output


def test_a_subject_file_gives_the_node_the_knee_of_python(peer, start_node, tmp_path):
    path = tmp_path / "subject.yaml"
    path.write_text("mass: 60\nthickness: 0.0004\nparameters: [osteoarthritis]\n")
    start_node("--params-file", path)
    peer.wait_for_node()
    assert_bits_of_python(peer, str(path))


def test_a_silent_input_and_a_file_that_is_not_written_are_named(peer, start_node):
    node = start_node("-r", "joint_states:=/exo/joint_states", "-p", "rerun.path:=knee.rrd")
    peer.wait_until(
        lambda: peer.force.get_subscription_count() and peer.node.count_publishers("/diagnostics")
    )
    peer.send_force(0, 1000.0)
    peer.wait_until(
        lambda: peer.problems.get("knee_contact: joint_states") == "nothing received yet"
    )
    peer.wait_until(
        lambda: "silent for" in peer.problems.get("knee_contact: joint_reaction_force", "")
    )
    other = peer.node.create_publisher(Float64, "/exo/joint_states", 10)
    peer.spin(6.0)  # the log names it after 5 s
    peer.wait_until(
        lambda: (
            "std_msgs/msg/Float64 is published there"
            in peer.problems["knee_contact: joint_states"]
        )
    )
    output = node.stop()
    peer.node.destroy_publisher(other)
    assert "write knee.source: joint_states std_msgs/Float64 data on arrival" in output
    assert "listening to /exo/joint_states and /joint_reaction_force" in output
    assert "rerun.path 'knee.rrd' is not written: rerun.mode is off, not file" in output
    assert output.count("nothing received on /exo/joint_states") == 1
    assert re.search(r"for 5 s or more, in ROS domain \d+, discovery range \w+", output)


def test_simulated_time_stamps_the_diagnostics_and_nothing_else(peer, start_node):
    """At first it stands still, which does not stop the node."""
    start_node("use_sim_time:=true", "pairing.wait:=0.2")
    peer.wait_for_node()
    peer.send(0, 0.2, 1000.0)
    peer.send_force(STEP, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == len(peer.wrenches) == 2)
    peer.wait_until(lambda: "knee_contact: ticks" in peer.diagnostics)
    stamps: list[int] = []
    peer.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: stamps.append(m.header.stamp.sec), 10
    )
    clock = peer.node.create_publisher(Clock, "/clock", 10)
    # Again and again: a sample goes nowhere if the node has yet to hear of this publisher.
    peer.wait_until(
        lambda: clock.publish(Clock(clock=RosMessages.Time(sec=12_345))) or 12_345 in stamps
    )
    peer.send(2 * STEP, 0.2, 1000.0)
    peer.wait_until(lambda: len(peer.contacts) == len(peer.wrenches) == 3)
    for answers in (peer.contacts, peer.wrenches):
        assert [answer.header.stamp.nanosec for answer in answers] == [0, STEP, 2 * STEP]


def test_a_node_without_standard_streams_computes_and_outlives_its_terminal(peer, tmp_path):
    """Where it was asked to, as `nohup` does: by ignoring SIGHUP, which its children inherit."""
    recording = tmp_path / "bag.mcap"
    node = f"{sys.executable} -m {COMMAND} node --ros-args -p record.path:={recording}"
    command = ["/bin/sh", "-c", f"trap '' HUP; exec {node} <&- >&- 2>&-"]
    with subprocess.Popen(command) as process:
        try:
            peer.wait_for_node()
            process.send_signal(signal.SIGHUP)
            peer.spin(0.3)
            peer.send_series()
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(patience())
    assert process.returncode == 0
    assert answers_in(recording) == peer.contacts


BAD_OUTPUTS = "-p record.path:=/proc/no/where.mcap -p rerun.mode:={mode} -p rerun.port:={port}"


@needs_viewer
@pytest.mark.parametrize("mode", ["serve", "spawn"])
def test_no_output_keeps_the_node_from_computing(peer, start_node, mode, monkeypatch):
    """Told once as an error, and in /diagnostics for as long as it lasts."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1] if mode == "serve" else free_port()
        node = start_node(*BAD_OUTPUTS.format(mode=mode, port=port).split())
        peer.wait_for_node()
        peer.send_series()
        faults = {
            "recorder": "cannot write /proc/no/where.mcap: ",
            "viewer": f"rerun.port: {port} on 127.0.0.1: Address already"
            if mode == "serve"
            else "no screen for a viewer (DISPLAY is not set)",
        }
        peer.wait_until(
            lambda: all(
                words in peer.problems.get(f"knee_contact: {output}", "")
                for output, words in faults.items()
            )
        )
        code, said = node.end(signal.SIGINT)
    assert code == 1  # what the recorder should have kept is lost
    for words in faults.values():
        assert ["[ERROR]" in line for line in said.splitlines() if words in line] == [True]


TICKS = 60


def test_medial_and_lateral_answers_and_the_wrench_of_both(peer, start_node, tmp_path):
    """With a change amid them, of the medial one alone, and a reset; computed again from the recording: same bytes."""
    lateral: list[KneeContact] = []
    peer.node.create_subscription(
        KneeContact, "knee_contact/lateral", lateral.append, QoSProfile(depth=1000)
    )
    recording, redone, scene = (
        tmp_path / name for name in ("live.mcap", "redone.mcap", "knee.rrd")
    )
    shown = ("rerun.mode:=file", f"rerun.path:={scene}") if HAS_VIEWER else ()
    node = start_node(
        "load.compartment:=both",
        "load.share:=0.6",
        "lateral.contact.damping:=900.0",
        f"record.path:={recording}",
        *shown,
    )
    peer.wait_for_node()
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact/lateral"))
    axial = [800.0 + 300.0 * np.sin(0.4 * i) for i in range(TICKS)]
    for i, force in enumerate(axial):
        if i == TICKS // 2:
            peer.wait_until(lambda: len(peer.contacts) == TICKS // 2)
            assert set_parameters(
                peer, {"contact.stiffness": 5e7, "load.compartment_spacing": 0.05}
            ) == (True, "")
        if i == 3 * TICKS // 4:
            peer.wait_until(lambda: len(peer.contacts) == 3 * TICKS // 4)
            assert trigger(peer, "reset")[0]
        peer.send(i * STEP, 0.2, force)
    peer.wait_until(lambda: len(peer.contacts) == len(lateral) == len(peer.wrenches) == TICKS)
    node.stop()
    assert [one.header.stamp for one in lateral] == [one.header.stamp for one in peer.contacts]
    loads = np.array(
        [[one.load, other.load] for one, other in zip(peer.contacts, lateral, strict=True)]
    )
    assert loads.sum(axis=1) == pytest.approx(
        axial, rel=1e-15
    )  # a difference and a sum: two roundings
    assert loads[:, 0] == pytest.approx(0.6 * np.array(axial), rel=1e-15)
    places = [
        (one.contact_point.z, other.contact_point.z)
        for one, other in zip(peer.contacts, lateral, strict=True)
    ]
    assert places == (TICKS // 2) * [(-0.035, 0.035)] + (TICKS // 2) * [(-0.025, 0.025)]
    for contact, other, wrench in zip(peer.contacts, lateral, peer.wrenches, strict=True):
        forces = np.array([contact.contact_force, other.contact_force])
        assert wrench.wrench.force.y == pytest.approx(-forces.sum(), rel=1e-15)
        assert wrench.wrench.torque.x == pytest.approx(
            other.contact_point.z * (forces[1] - forces[0]), abs=1e-12
        )
    found, topics = read_provenance(recording), recorded_topics(has_both=True)
    assert found is not None
    assert found.parameters.lateral.contact.stiffness == found.parameters.contact.stiffness
    solve(recording, found, redone)
    assert raw(recording, topics) == raw(redone, topics)
    assert (
        len(raw(recording, topics)) == 5 * TICKS + 1 + 15
    )  # and a leg, which moves 50 times a second
    # On a busy machine the process of the scene needs longer to start than the node takes in all; it goes on by itself.
    peer.wait_until(lambda: scene.is_file() or not HAS_VIEWER)


@pytest.mark.usefixtures("hang_up")
def test_hanging_up_completes_the_files(peer, start_node, tmp_path):
    """As SIGINT and SIGTERM do, by which other tests end their nodes."""
    recording = tmp_path / "bag" / "bag_0.mcap"
    node = start_node(f"record.path:={recording}", anew=True)
    peer.wait_for_node()
    peer.send_series()
    peer.send_angle(int(STAMPS[-1]) + STEP, 0.1)  # an input without an answer
    peer.wait_until(lambda: peer.has_received("joint_states", 41))
    output = node.stop(signal.SIGHUP)
    assert "40 ticks, 0 samples refused" in output
    assert sorted(path.name for path in recording.parent.iterdir()) == [
        "bag_0.mcap",
        "metadata.yaml",
    ]
    messages = read_bag(recording.parent, types_of(EACH_TICK))
    count = {f"/{topic}": sum(m.topic == f"/{topic}" for m in messages) for topic in EACH_TICK}
    assert count == {
        "/joint_states": 41,
        "/joint_reaction_force": 40,
        "/knee_contact": 40,
        "/knee_contact/wrench": 40,
    }
    recorded = [m.message.penetration_depth for m in messages if m.topic == "/knee_contact"]
    assert recorded == [contact.penetration_depth for contact in peer.contacts]


def test_a_node_that_builds_the_model_ends_without_a_library(
    start_node,
    tmp_path,
    monkeypatch,
    request,
):
    """At the moment when its second child has begun, which builds; the first one records."""
    package = copy_of_the_package(tmp_path / "copy", WITHOUT_LIBRARY)
    monkeypatch.chdir(package.parent)
    node = start_node(f"record.path:={tmp_path / 'bag' / 'bag_0.mcap'}", anew=True)
    process, begun = psutil.Process(node.process.pid), list[psutil.Process]()
    while len(begun) < 2:
        assert node.process.poll() is None
        time.sleep(0.005)
        begun = process.children()
    node.process.send_signal(signal.SIGINT)  # as Ctrl-C in a demo, which reaches the node twice
    time.sleep(0.02)
    node.stop(signal.SIGTERM)
    assert not [child for child in begun if not has_ended(child)]
    assert not list(package.glob("model/*.so"))
    assert not list(tmp_path.glob("bag/*.partial"))
