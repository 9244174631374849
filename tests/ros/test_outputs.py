"""Recorder and viewer in trouble, or told to begin and end while the node runs: no answer is lost by that."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from knee_contact_ros.stream_in.bag import read_bag
from knee_contact_ros.topics import KNEE_CONTACT, MESSAGE_TYPES
from tests.ros.conftest import NodeProcess, Peer, call

Start = Callable[..., NodeProcess]
STEP = 5_000_000
CONTACTS = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}


def walk(peer: Peer, begin: int, number: int) -> None:
    """Publish samples number `begin` to `begin + number` and wait for their answers."""
    answered = len(peer.contacts)
    for i in range(begin, begin + number):
        peer.send(i * STEP, 0.2, 900.0 + i)
    peer.wait_until(lambda: len(peer.contacts) == answered + number)


def children(node: NodeProcess) -> list[psutil.Process]:
    """The processes of recorder and viewer."""
    return psutil.Process(node.process.pid).children(recursive=True)


def stamps(path: Path) -> list[int]:
    """Numbers of the samples whose answers a recording holds."""
    return [message.log_time // STEP for message in read_bag(path, CONTACTS)]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("output", ["recorder", "viewer"])
def test_an_output_that_dies_or_stalls_costs_no_answer(
    peer: Peer, start_node: Start, tmp_path: Path, output: str, number: signal.Signals
) -> None:
    arguments = {
        "recorder": ["-p", f"record.path:={tmp_path}/out.mcap"],
        "viewer": ["-p", "rerun.mode:=file", "-p", f"rerun.path:={tmp_path}/out.rrd"],
    }
    node = start_node(*arguments[output])
    peer.wait_for_node()
    walk(peer, 0, 20)
    (child,) = children(node)
    child.send_signal(number)
    walk(peer, 20, 200)
    if number == signal.SIGKILL:
        peer.wait_until(lambda: peer.problems.get(f"knee_contact: {output}", "ok") != "ok")
        walk(peer, 220, 20)
    code, said = node.stop()
    assert code == 0
    assert "out." in said  # it says what has become of the file
    assert "Traceback" not in said
    assert not child.is_running()
    assert [contact.status for contact in peer.contacts] == [0] * len(peer.contacts)


def test_a_killed_node_leaves_a_complete_recording(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """The recorder outlives it by as long as it takes to complete the file."""
    node = start_node("-p", f"record.path:={tmp_path}/out.mcap")
    peer.wait_for_node()
    walk(peer, 0, 100)
    (child,) = children(node)
    peer.spin(0.1)
    node.process.kill()
    child.wait(30.0)
    assert stamps(tmp_path / "out.mcap") == list(range(100))


def ask(peer: Peer, what: str) -> tuple[bool, str]:
    """Have a recording begun or ended."""
    answer = call(peer, Trigger, f"/knee_contact/{what}_recording", Trigger.Request())
    return answer.success, answer.message


def set_path(peer: Peer, path: str) -> None:
    """Name the next recording."""
    request = SetParameters.Request(parameters=[Parameter("record.path", value=path).to_parameter_msg()])
    assert call(peer, SetParameters, "/knee_contact/set_parameters", request).results[0].successful


def test_a_recording_begins_and_ends_on_demand(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    node = start_node()
    peer.wait_for_node()
    walk(peer, 0, 10)
    assert ask(peer, "start") == (False, "parameter record.path names no file")
    assert ask(peer, "stop") == (False, "nothing is being recorded")
    for begin, name in ((10, "a"), (60, "b")):
        set_path(peer, f"{tmp_path}/{name}/out.mcap")
        assert ask(peer, "start") == (True, f"recording to {tmp_path}/{name}/out.mcap")
        assert ask(peer, "start")[0] is False
        walk(peer, begin, 30)
        assert ask(peer, "stop") == (True, f"{tmp_path}/{name}/out.mcap will be complete in a moment")
        walk(peer, begin + 30, 20)
    assert ask(peer, "start")[0] is False  # it is being completed, or is there
    assert node.stop()[0] == 0
    assert stamps(tmp_path / "a" / "out.mcap") == list(range(10, 40))
    assert stamps(tmp_path / "b" / "out.mcap") == list(range(60, 90))
    assert len(peer.contacts) == 110


def test_a_recording_that_cannot_begin_is_told_and_another_may(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    node = start_node()
    peer.wait_for_node()
    set_path(peer, f"{tmp_path}/file/out.mcap")
    assert ask(peer, "start")[0] is True  # its process finds out
    peer.wait_until(lambda: "cannot write" in peer.problems.get("knee_contact: recorder", ""))
    walk(peer, 0, 10)
    set_path(peer, f"{tmp_path}/out.mcap")
    assert ask(peer, "start")[0] is True
    walk(peer, 10, 10)
    code, said = node.stop()
    assert code == 0
    assert said.count(f"cannot write {tmp_path}/file/out.mcap") == 1
    assert stamps(tmp_path / "out.mcap") == list(range(10, 20))
