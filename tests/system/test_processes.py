"""Processes of ours are never left behind."""

import signal
import subprocess
import sys

import psutil
import pytest

from knee_contact_ros.system import processes
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import child_process
from tests.helpers.processes import has_ended

PATIENCE = 30.0
PARENT = """
from pathlib import Path
from sys import argv
from time import sleep
from knee_contact_ros.system.processes import child_process
log = Path(argv[1])
with child_process("it", ["-c", "import time; print('begun', flush=True); time.sleep(600)"], log) as child:
    while not log.read_text():
        sleep(0.01)
    print(child.process.pid, flush=True)
    input()
"""
"""Program that keeps a process, says its number once it has begun, and waits"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_starts_ends_it(number, tmp_path, monkeypatch):
    started: list[subprocess.Popen[bytes]] = []

    class Interrupted(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *arguments, **more):
            super().__init__(*arguments, **more)
            started.append(self)
            signal.raise_signal(number)

    def interrupt(_number, _frame):
        raise KeyboardInterrupt

    monkeypatch.setattr(processes.subprocess, "Popen", Interrupted)
    before = signal.signal(number, interrupt)
    try:
        with (
            pytest.raises(KeyboardInterrupt),
            child_process("it", ["-c", "input()"], tmp_path / "log"),
        ):
            pytest.fail("it must not come this far")
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)
    assert len(started) == 1
    assert started[0].poll() is not None


@pytest.mark.parametrize(
    ("output", "told"),
    [
        ("", "it said nothing"),
        (
            "[ERROR] [1.5] [knee_contact]: why\n[INFO] [1.6] [knee_contact]: 601 ticks",
            r"\[ERROR\] .* why",
        ),
    ],
)
def test_the_reason_of_an_ended_process_is_reported(tmp_path, output, told):
    words = f"import sys; sys.stdout.write({output!r}); sys.exit(3)"
    with (
        pytest.raises(UsageError, match=f"^it ended with code 3: {told}$"),
        child_process("it", ["-c", words], tmp_path / "log") as child,
    ):
        child.process.wait()


def test_a_killed_parent_leaves_no_child(tmp_path):
    command = [sys.executable, "-c", PARENT, str(tmp_path / "log")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as parent:
        assert parent.stdout
        child = psutil.Process(int(parent.stdout.readline()))
        assert not has_ended(child)
        parent.kill()
    psutil.wait_procs([child], PATIENCE)
    assert has_ended(child)
