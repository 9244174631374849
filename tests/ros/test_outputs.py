"""Recorder and viewer in trouble, or told to begin and end while the node runs: no answer is lost by that."""

from __future__ import annotations

import re
import signal
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from knee_contact_ros.node.outputs import MOST_ENDING
from knee_contact_ros.streams.topics import KNEE_CONTACT
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import has_ended
from tests.helpers.sinks import wait_until
from tests.ros.conftest import NodeProcess, Peer, Start, raw, set_parameters, trigger

STEP = 5_000_000


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
    return [message.log_time // STEP for message in raw(path, [KNEE_CONTACT])]


def begin_recording(peer: Peer, path: Path) -> tuple[bool, str]:
    """Name the next recording and have it begun."""
    assert set_parameters(peer, {"record.path": str(path)}) == (True, "")
    return trigger(peer, "start_recording")


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
        stopped, reason = trigger(peer, "stop_recording")
        assert reason and not stopped  # noqa: PT018
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


def test_recordings_begin_and_end_on_demand_or_are_refused_with_the_reason(
    peer: Peer, start_node: Start, tmp_path: Path
) -> None:
    """And no more than four are completed at a time."""
    (tmp_path / "file").touch()
    node = start_node()
    peer.wait_for_node()
    walk(peer, 0, 10)
    assert trigger(peer, "start_recording") == (False, "parameter record.path names no file")
    assert trigger(peer, "stop_recording") == (False, "nothing is being recorded")
    for name, reason in {
        "file/out.mcap": "Not a directory", "": "Is a directory", f"{'n' * 250}.mcap": "File name too long",
    }.items():  # fmt: skip
        path = tmp_path / name
        assert begin_recording(peer, path) == (False, f"cannot write {path}: {reason}")
    for number, name in enumerate(("a", "b")):
        path = tmp_path / name / "out.mcap"
        assert begin_recording(peer, path) == (True, f"recording to {path}")
        assert trigger(peer, "start_recording")[0] is False
        walk(peer, 10 + 50 * number, 30)
        peer.wait_until(lambda: peer.diagnostics.get("knee_contact: recorder", {}).get("written") == "30")
        assert trigger(peer, "stop_recording") == (True, f"{path} will be complete in a moment")
        walk(peer, 40 + 50 * number, 20)
    wait_until((tmp_path / "b" / "out.mcap").exists)
    peer.wait_until(lambda: not children(node))  # the node may not have heard of that yet
    stopped: list[psutil.Process] = []
    for number in range(MOST_ENDING):  # the names go on
        peer.wait_until(lambda: trigger(peer, "start_recording")[0])
        walk(peer, 200 + 10 * number, 10)
        peer.wait_until(lambda number=number: len(children(node)) == number + 1)  # it is started in the background
        (child,) = [process for process in children(node) if process not in stopped]
        told = {"written": "10", "process": str(child.pid)}
        peer.wait_until(lambda told=told: told.items() <= peer.diagnostics.get("knee_contact: recorder", {}).items())
        child.suspend()
        stopped.append(child)
        assert trigger(peer, "stop_recording")[0] is True
    many = f"{MOST_ENDING} recordings are still being completed; try again when one is complete"
    assert trigger(peer, "start_recording") == (False, many)
    for child in children(node):
        child.resume()
    peer.wait_until(lambda: trigger(peer, "start_recording")[0])
    code, said = node.stop()
    assert code == 0
    assert "Traceback" not in said
    assert stamps(tmp_path / "a" / "out.mcap") == list(range(10, 40))
    assert stamps(tmp_path / "b" / "out.mcap") == list(range(60, 90))
    for number in range(MOST_ENDING):
        ticks = range(200 + 10 * number, 210 + 10 * number)
        assert stamps(tmp_path / "b" / f"out_{number + 1}.mcap") == list(ticks)
