"""The node's recordings: in several files, on disks that fill up, cannot be written or vanish, and after a cut."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from tests.ros.conftest import NodeProcess, Peer
from tests.ros.test_outputs import STEP, ask, set_path, stamps, walk
from tests.test_apart import readable, wait_until

Start = Callable[..., NodeProcess]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount, umount = shutil.which("mount"), shutil.which("umount")
    if os.geteuid() or not (mount and umount):
        pytest.skip("only root may mount a file system")
    command = [mount, "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    yield folder
    subprocess.run([umount, "--lazy", str(folder)], check=True)


def problem(peer: Peer) -> str:
    """What `/diagnostics` says of the recorder."""
    return peer.problems.get("knee_contact: recorder", "")


def test_a_recording_is_split_and_no_answer_is_lost(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    node = start_node("-p", f"record.path:={tmp_path}/knee_0.mcap", "-p", "record.max_duration:=1.0")
    peer.wait_for_node()
    walk(peer, 0, 500)
    wait_until((tmp_path / "knee_1.mcap").exists)
    walk(peer, 500, 250)
    code, said = node.stop()
    assert code == 0, said
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "knee_0.mcap", "knee_1.mcap", "knee_2.mcap", "knee_3.mcap", "metadata.yaml",
    ]  # fmt: skip
    assert stamps(tmp_path) == list(range(750))
    assert stamps(tmp_path / "knee_2.mcap") == list(range(400, 600))


def test_a_full_disk_ends_the_recording_and_not_the_node(peer: Peer, start_node: Start, small_disk: Path) -> None:
    node = start_node("-p", f"record.path:={small_disk}/knee.mcap", "-p", "record.min_free:=0.0")
    peer.wait_for_node()
    (small_disk / "other").write_bytes(bytes(900_000))
    sent = 0
    while problem(peer) in ("", "ok"):
        walk(peer, sent, 250)
        sent += 250
    walk(peer, sent, 20)
    code, said = node.stop()
    assert code == 0
    assert said.count(f"recording {small_disk}/knee.mcap stopped: No space left on device") == 1
    assert "Traceback" not in said
    assert f"{sent + 20} ticks" in said
    assert sorted(path.name for path in small_disk.iterdir()) == ["knee.mcap.partial", "other"]
    numbers = readable(small_disk / "knee.mcap.partial", STEP)
    assert len(numbers) > 50
    assert numbers == list(range(len(numbers)))


def test_a_recording_ends_whole_before_the_disk_is_full(peer: Peer, start_node: Start, small_disk: Path) -> None:
    node = start_node("-p", f"record.path:={small_disk}/knee.mcap", "-p", "record.min_free:=0.5")
    peer.wait_for_node()
    walk(peer, 0, 50)
    peer.spin(0.3)
    (small_disk / "other").write_bytes(bytes(600_000))
    peer.wait_until(lambda: "has ended" in problem(peer))
    walk(peer, 50, 50)
    code, said = node.stop()
    assert code == 0
    assert said.count(f"recording {small_disk}/knee.mcap has ended, complete up to here: ") == 1
    assert "parameter record.min_free keeps 0.5 MB" in said
    assert "100 ticks" in said
    assert sorted(path.name for path in small_disk.iterdir()) == ["knee.mcap", "metadata.yaml", "other"]
    assert stamps(small_disk / "knee.mcap") == list(range(50))


def test_too_little_space_is_refused_at_the_start(start_node: Start, small_disk: Path) -> None:
    code, said = start_node("-p", f"record.path:={small_disk}/new/knee.mcap").wait()
    assert code == 2
    words = "MB are free on its disk, and parameter record.min_free keeps 100 MB"
    assert [line for line in said.splitlines() if words in line and f"cannot write {small_disk}/new/knee.mcap" in line]
    assert "Traceback" not in said
    assert list(small_disk.iterdir()) == []


def test_a_disk_that_cannot_be_written_costs_no_answer(peer: Peer, start_node: Start, small_disk: Path) -> None:
    mount = shutil.which("mount")
    assert mount
    subprocess.run([mount, "-o", "remount,ro", str(small_disk)], check=True)
    code, said = start_node("-p", f"record.path:={small_disk}/knee.mcap", "-p", "record.min_free:=0.0").wait()
    assert code == 2
    assert f"cannot write {small_disk}/knee.mcap: Read-only file system" in said
    node = start_node("-p", "record.min_free:=0.0")
    peer.wait_for_node()
    set_path(peer, f"{small_disk}/knee.mcap")
    assert ask(peer, "start")[0] is True  # its process finds out
    peer.wait_until(lambda: "Read-only file system" in problem(peer))
    walk(peer, 0, 20)
    code, said = node.stop()
    assert code == 0
    assert said.count(f"cannot write {small_disk}/knee.mcap: Read-only file system") == 1
    assert "20 ticks" in said


def test_a_folder_that_is_removed_costs_no_answer(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    node = start_node("-p", f"record.path:={folder}/knee.mcap")
    peer.wait_for_node()
    walk(peer, 0, 20)
    shutil.rmtree(folder)
    peer.wait_until(lambda: "its file or folder was removed while it was written" in problem(peer))
    walk(peer, 20, 20)
    code, said = node.stop()
    assert code == 0
    assert said.count(f"recording {folder}/knee.mcap stopped: its file or folder was removed") == 1
    assert "40 ticks" in said
    assert "Traceback" not in said
    assert list(tmp_path.iterdir()) == []


def test_what_was_cut_off_is_named_at_the_next_start(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    cut_off = f"{tmp_path}/knee.mcap.partial is a recording that was cut off: `knee-contact recover"
    node = start_node("-p", f"record.path:={tmp_path}/knee.mcap")
    peer.wait_for_node()
    walk(peer, 0, 20)
    living = start_node("-p", f"record.path:={tmp_path}/knee.mcap", "-r", "__ns:=/other")
    code, said = living.wait()
    assert code == 2
    assert f"{tmp_path}/knee.mcap.partial is being written by another process; choose another name" in said
    assert cut_off not in said
    (recorder,) = psutil.Process(node.process.pid).children(recursive=True)
    for process in (node.process, recorder):
        process.send_signal(signal.SIGKILL)
    node.wait()
    recorder.wait(30.0)
    code, said = start_node("-p", f"record.path:={tmp_path}/knee.mcap").wait()
    assert code == 2
    assert f"{cut_off} {tmp_path}/knee.mcap.partial OUT.mcap` makes it whole; then move it away" in said
    following = start_node("-p", f"record.path:={tmp_path}/next.mcap", "-r", "__ns:=/another")
    wait_until((tmp_path / "next.mcap.partial").exists)
    peer.wait_until(lambda: peer.node.count_publishers("/another/knee_contact"))
    code, said = following.stop()
    assert code == 0
    assert said.count(cut_off) == 1
    assert "WARN" in next(line for line in said.splitlines() if cut_off in line)
    assert (tmp_path / "next.mcap").exists()
