"""Recorder and viewer in trouble, told to begin and end while the node runs, or asked for the last seconds:
no answer is lost by that.
"""

import re
import shutil
import signal
from contextlib import suppress
from functools import partial

import numpy as np
import psutil
import pytest

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.provenance import Change, read_provenance
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, Status
from knee_contact_ros.node.outputs import MAX_ENDING
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT
from knee_contact_ros.system.errors import UsageError
from tests.helpers.needs import needs_viewer
from tests.helpers.offline import solve
from tests.helpers.patience import wait_until
from tests.helpers.processes import has_ended
from tests.ros.conftest import answers_in, raw, set_parameters, trigger

STEP = 5_000_000


def walk(peer, begin, number):
    """Publish samples number `begin` to `begin + number` and wait for their answers."""
    answered = len(peer.contacts)
    for i in range(begin, begin + number):
        peer.send(i * STEP, 0.2, 900.0 + i)
    peer.wait_until(lambda: len(peer.contacts) == answered + number)


def children(node):
    """The processes of recorder and viewer."""
    return psutil.Process(node.process.pid).children(recursive=True)


def stamps(path):
    """Numbers of the samples whose answers a recording holds."""
    return [message.log_time // STEP for message in raw(path, [KNEE_CONTACT])]


def begin_recording(peer, path):
    """Name the next recording and have it begun."""
    assert set_parameters(peer, {"record.path": str(path)}) == (True, "")
    return trigger(peer, "start_recording")


def test_a_killed_node_leaves_a_complete_recording(peer, start_node, tmp_path):
    """The recorder outlives it by as long as it takes to complete the file."""
    node = start_node(f"record.path:={tmp_path}/out.mcap")
    peer.wait_for_node()
    walk(peer, 0, 100)
    (child,) = children(node)
    peer.spin(0.1)
    node.process.kill()
    child.wait(30.0)
    assert stamps(tmp_path / "out.mcap") == list(range(100))


@needs_viewer
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_outputs_that_die_or_stall_cost_no_answer(peer, start_node, tmp_path, number):
    recording, scene = tmp_path / "out.mcap", tmp_path / "out.rrd"
    given = f"record.path:={recording}", "rerun.mode:=file", f"rerun.path:={scene}"
    node = start_node(*given)
    peer.wait_for_node()
    walk(peer, 0, 20)
    outputs = children(node)
    assert len(outputs) == 2
    for output in outputs:
        output.send_signal(number)
    walk(peer, 20, 200)
    if number == signal.SIGKILL:
        for name in ("recorder", "viewer"):
            peer.wait_until(
                lambda name=name: peer.problems.get(f"knee_contact: {name}", "ok") != "ok"
            )
        walk(peer, 220, 20)
        stopped, reason = trigger(peer, "stop_recording")
        assert reason and not stopped  # noqa: PT018
    code, said = node.end(signal.SIGTERM)
    left = re.findall(r"is not waited for: its process \(\d+\) goes on; (\d+) answers", said)
    assert len(left) == (2 if number == signal.SIGSTOP else 0)
    # A killed recorder has gaps; a stalled one lacks what it was not sent.
    assert code == (any(map(int, left)) if left else 1)
    for output in outputs:
        with suppress(
            psutil.NoSuchProcess
        ):  # the system has let it go on, as its group is left alone
            output.resume()
    wait_until(lambda: all(map(has_ended, outputs)))
    assert str(recording) in said  # it says what has become of the files
    assert str(scene) in said
    assert "Traceback" not in said
    assert [contact.status for contact in peer.contacts] == [0] * len(peer.contacts)


def test_recordings_begin_and_end_on_demand_or_are_refused_with_the_reason(
    peer, start_node, tmp_path
):
    """And no more than four are completed at a time."""
    (tmp_path / "file").touch()
    node = start_node()
    peer.wait_for_node()
    walk(peer, 0, 10)
    assert trigger(peer, "start_recording") == (False, "parameter record.path names no file")
    assert trigger(peer, "stop_recording") == (False, "nothing is being recorded")
    for name, reason in {
        "file/out.mcap": "Not a directory",
        "": "Is a directory",
        "/": "Is a directory",
        f"{'n' * 250}.mcap": "File name too long",
    }.items():
        path = tmp_path / name
        assert begin_recording(peer, path) == (False, f"cannot write {path}: {reason}")
        assert trigger(peer, "save_snapshot") == (False, f"cannot write {path}: {reason}")
    for number, name in enumerate(("a", "b")):
        path = tmp_path / name / "out.mcap"
        assert begin_recording(peer, path) == (True, f"recording to {path}")
        assert trigger(peer, "start_recording")[0] is False
        walk(peer, 10 + 50 * number, 30)
        peer.wait_until(
            lambda: peer.diagnostics.get("knee_contact: recorder", {}).get("written") == "30"
        )
        assert trigger(peer, "stop_recording") == (True, f"{path} will be complete in a moment")
        walk(peer, 40 + 50 * number, 20)
    wait_until((tmp_path / "b" / "out.mcap").exists)
    peer.wait_until(lambda: not children(node))  # the node may not have heard of that yet
    stopped: list[psutil.Process] = []
    for number in range(MAX_ENDING):  # the names go on
        peer.wait_until(lambda: trigger(peer, "start_recording")[0])
        walk(peer, 200 + 10 * number, 10)
        peer.wait_until(
            lambda number=number: len(children(node)) == number + 1
        )  # it is started in the background
        (child,) = [process for process in children(node) if process not in stopped]
        told = {"written": "10", "process": str(child.pid)}
        peer.wait_until(
            lambda told=told: (
                told.items() <= peer.diagnostics.get("knee_contact: recorder", {}).items()
            )
        )
        child.suspend()
        stopped.append(child)
        assert trigger(peer, "stop_recording")[0] is True
    many = f"{MAX_ENDING} recordings are still being completed; try again when one is complete"
    assert trigger(peer, "start_recording") == (False, many)
    for child in children(node):
        child.resume()
    peer.wait_until(lambda: trigger(peer, "start_recording")[0])
    node.stop()
    assert stamps(tmp_path / "a" / "out.mcap") == list(range(10, 40))
    assert stamps(tmp_path / "b" / "out.mcap") == list(range(60, 90))
    for number in range(MAX_ENDING):
        ticks = range(200 + 10 * number, 210 + 10 * number)
        assert stamps(tmp_path / "b" / f"out_{number + 1}.mcap") == list(ticks)


def test_each_recording_may_have_a_folder_of_its_own(peer, start_node, tmp_path):
    """So `metadata.yaml` of one life, or of one start of a recording, names all files of that one."""
    node = start_node(f'record.path:="{tmp_path}/{{stamp}}/knee.mcap"', "pairing.wait:=0.2")
    peer.wait_for_node()
    walk(peer, 0, 20)
    assert trigger(peer, "stop_recording")[0]
    peer.spin(1.1)  # names go by the second
    begun = trigger(peer, "start_recording")
    walk(peer, 20, 20)
    node.stop()
    first, second = sorted(tmp_path.iterdir())
    for folder, numbers in ((first, range(20)), (second, range(20, 40))):
        assert re.fullmatch(r"\d{4}(_\d\d){2}-\d\d(_\d\d){2}", folder.name)
        assert stamps(folder) == list(numbers)
    assert begun == (True, f"recording to {second / 'knee.mcap'}")


def test_a_snapshot_is_a_complete_recording_of_the_last_seconds(peer, start_node, tmp_path):
    """Without a recorder: what a ring in memory holds, with parameters and resets, is solved again to the same bits."""
    given = [
        f"record.path:={tmp_path / 'knee.mcap'}",
        "record.snapshot:=0.5",
        "pairing.wait:=5.0",
    ]
    node = start_node(*given)
    peer.wait_for_node()
    assert trigger(peer, "stop_recording")[0]
    save = partial(trigger, peer, "save_snapshot")
    saved, reason = save()
    assert not saved
    assert "there is nothing to save" in reason
    walk(peer, 0, 300)
    peer.wait_until(lambda: len(peer.contacts) == 300)
    assert (
        save()[1]
        == f"{tmp_path / 'knee_snapshot.mcap'} will be complete in a moment: 100 answers, 0.495 s"
    )
    wait_until((tmp_path / "knee_snapshot.mcap").exists)
    assert trigger(peer, "reset")[0]
    walk(peer, 300, 40)
    peer.wait_until(lambda: len(peer.contacts) == 340)
    assert save()[1].startswith(f"{tmp_path / 'knee_snapshot_1.mcap'} ")
    walk(peer, 100, 40)  # the clock is set back
    peer.wait_until(lambda: len(peer.contacts) == 380)
    third = [save()]
    wait_until(lambda: third[-1][0] or third.append(save()))  # once the one before is open
    assert third[-1][1].endswith("moment: 101 answers, 0.495 s")
    wait_until(
        (tmp_path / "knee_snapshot_2.mcap").exists
    )  # a busy node's end waits for no output that is slow
    assert "is there already" not in node.stop()  # the answers have told the names
    assert stamps(tmp_path / "knee_snapshot_2.mcap") == [*range(279, 340), *range(100, 140)]
    assert stamps(tmp_path / "knee_snapshot.mcap") == list(range(200, 300))
    assert stamps(tmp_path / "knee_snapshot_1.mcap") == list(range(240, 340))
    how = read_provenance(tmp_path / "knee_snapshot_1.mcap")
    assert how is not None
    assert (how.ticks_before, how.changes) == (240, (Change(60, None),))
    solve(tmp_path / "knee_snapshot_1.mcap", how, tmp_path / "again.mcap")
    live, again = (
        read_answers(tmp_path / name) for name in ("knee_snapshot_1.mcap", "again.mcap")
    )
    fields = list(MESSAGE_FIELDS)
    assert np.array_equal(live.view(FLAT)[fields], again.view(FLAT)[fields])


def test_recordings_end_and_begin_between_two_angles(peer, start_node, tmp_path):
    """They hold the later one, to which their last answers are interpolated; one has held answers, and no angle."""
    node = start_node(f"record.path:={tmp_path / 'r.mcap'}", "pairing.wait:=0.2")
    peer.wait_for_node()
    answered = 0

    def force(*numbers):
        nonlocal answered
        for number in numbers:
            peer.send_force(number * STEP, 900.0 + number)
        answered += len(numbers)
        peer.wait_until(lambda: len(peer.contacts) == answered)

    peer.send_angle(0, 0.2)
    peer.send_angle(10 * STEP, 0.7)
    force(*range(4))
    assert trigger(peer, "save_snapshot")[0]
    assert trigger(peer, "stop_recording")[0]
    peer.wait_until(lambda: trigger(peer, "start_recording")[0])
    force(*range(4, 8))
    assert trigger(peer, "stop_recording")[0]
    force(8, 11)
    peer.wait_until(lambda: trigger(peer, "start_recording")[0])
    force(12, 13)
    assert trigger(peer, "stop_recording")[0]
    node.stop()
    parts = {"r": slice(4), "r_snapshot": slice(4), "r_1": slice(4, 8), "r_2": slice(10, 12)}
    for name, part in parts.items():
        path = tmp_path / f"{name}.mcap"
        solve(path, read_provenance(path), tmp_path / "again.mcap", overwrite=True)
        assert answers_in(tmp_path / "again.mcap") == answers_in(path) == peer.contacts[part]
    with pytest.raises(UsageError, match="joint_states has no messages"):
        raw(tmp_path / "r_2.mcap", [JOINT_STATES])
    assert [each.status for each in peer.contacts] == [0] * 9 + [int(Status.INPUT_HELD)] * 3


def test_a_recording_whose_folder_is_removed_ends_and_not_the_node(peer, start_node, tmp_path):
    folder = tmp_path / "bag"
    node = start_node(f"record.path:={folder}/knee.mcap")
    peer.wait_for_node()
    wait_until((folder / "knee.mcap.partial").exists)
    walk(peer, 0, 20)
    shutil.rmtree(folder)
    peer.wait_until(lambda: "was removed" in peer.problems.get("knee_contact: recorder", ""))
    walk(peer, 20, 20)
    code, said = node.end(signal.SIGINT)
    assert code == 1
    words = f"recording {folder}/knee.mcap stopped: its file or folder was removed while it was written"
    assert said.count(words) == 1
    assert "40 ticks" in said
    assert not folder.exists()
