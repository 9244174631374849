"""Recorder and viewer in trouble, or told to begin and end while the node runs: no answer is lost by that."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.node.outputs import MOST_ENDING
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import has_ended
from tests.helpers.sinks import wait_until
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
@pytest.mark.parametrize("output", ["recorder", pytest.param("viewer", marks=needs_viewer)])
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
        stopped = call(peer, Trigger, "/knee_contact/stop_recording", Trigger.Request())
        assert not stopped.success
        assert stopped.message
    code, said = node.stop(signal.SIGTERM)
    unfinished = re.search(r"is not waited for: its process \(\d+\) goes on; (\d+) answers", said)
    assert bool(unfinished) == (number == signal.SIGSTOP)
    assert code == bool(unfinished and int(unfinished[1]))
    if unfinished:
        with suppress(psutil.NoSuchProcess):  # the system has let it go on, as its group is left alone
            child.resume()
        wait_until(lambda: has_ended(child))
    assert "out." in said  # it says what has become of the file
    assert "Traceback" not in said
    assert has_ended(child)
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
        peer.wait_until(lambda: peer.diagnostics.get("knee_contact: recorder", {}).get("written") == "30")
        assert ask(peer, "stop") == (True, f"{tmp_path}/{name}/out.mcap will be complete in a moment")
        walk(peer, begin + 30, 20)
    wait_until((tmp_path / "b" / "out.mcap").exists)
    following = (True, f"recording to {tmp_path}/b/out_1.mcap")  # the other one is there
    peer.wait_until(lambda: ask(peer, "start") == following)  # the node may not have heard of that yet
    assert node.stop()[0] == 0
    assert stamps(tmp_path / "a" / "out.mcap") == list(range(10, 40))
    assert stamps(tmp_path / "b" / "out.mcap") == list(range(60, 90))
    assert len(peer.contacts) == 110


def test_a_recording_that_cannot_begin_is_refused_with_the_reason_and_another_may(
    peer: Peer, start_node: Start, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    node = start_node()
    peer.wait_for_node()
    for name, reason in {
        "file/out.mcap": "Not a directory",
        "": "Is a directory",
        f"{'n' * 300}.mcap": "File name too long",
        f"{'n' * 250}.mcap": "File name too long",
        f"{'deep/' * 1000}out.mcap": "File name too long",
    }.items():
        path = tmp_path / name
        set_path(peer, str(path))
        assert ask(peer, "start") == (False, f"cannot write {path}: {reason}")
    walk(peer, 0, 10)
    set_path(peer, f"{tmp_path}/out.mcap")
    assert ask(peer, "start")[0] is True
    walk(peer, 10, 10)
    wait_until((tmp_path / "out.mcap.partial").exists)
    code, said = node.stop()
    assert code == 0
    assert "Traceback" not in said
    assert stamps(tmp_path / "out.mcap") == list(range(10, 20))


def test_no_more_recordings_than_four_are_being_completed(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    node = start_node()
    peer.wait_for_node()
    set_path(peer, f"{tmp_path}/out.mcap")
    for number in range(MOST_ENDING):
        assert ask(peer, "start")[0] is True
        walk(peer, 10 * number, 10)
        peer.wait_until(lambda number=number: len(children(node)) == number + 1)  # it is started in the background
        (child,) = [process for process in children(node) if process.status() != psutil.STATUS_STOPPED]
        told = {"written": "10", "process": str(child.pid)}
        peer.wait_until(lambda told=told: told.items() <= peer.diagnostics.get("knee_contact: recorder", {}).items())
        child.suspend()
        assert ask(peer, "stop")[0] is True
    assert ask(peer, "start") == (
        False,
        f"{MOST_ENDING} recordings are still being completed; try again when one is complete",
    )
    for child in children(node):
        child.resume()
    peer.wait_until(lambda: ask(peer, "start")[0])
    assert node.stop()[0] == 0
    complete = sorted(tmp_path.glob("*.mcap"))[:MOST_ENDING]
    assert [stamps(path) for path in complete] == [[*range(10 * i, 10 * i + 10)] for i in range(MOST_ENDING)]
