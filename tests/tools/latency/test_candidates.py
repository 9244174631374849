"""The nodes that are measured: which ends of theirs are failures."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import child_process
from knee_contact_ros.tools.latency import candidates

STANDS_IN = """
import signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
print("ready", flush=True)
if {waits}:
    signal.sigwait([signal.SIGINT])
sys.exit({code})
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """What it says."""
    return tmp_path / "log"


def run(log: Path, monkeypatch: pytest.MonkeyPatch, code: int, waits: bool) -> None:
    """Run a node that ends with a code when it is told to, or before."""
    program = STANDS_IN.format(code=code, waits=waits)
    monkeypatch.setattr(candidates, "node_process", lambda _files, _work, _: child_process("it", ["-c", program], log))
    with candidates.start_ours([], log.parent, 10.0) as child:
        while "ready" not in log.read_text():
            time.sleep(0.01)
        if not waits:
            child.process.wait()
            child.check()


@pytest.mark.parametrize("code", [0, 1])
def test_files_that_are_completed_later_are_no_failure(log: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    run(log, monkeypatch, code, waits=True)


@pytest.mark.parametrize(("code", "waits"), [(2, True), (1, False), (2, False)])
def test_any_other_end_is_a_failure(log: Path, monkeypatch: pytest.MonkeyPatch, code: int, waits: bool) -> None:
    with pytest.raises(UsageError, match=f"it ended with code {code}: ready"):
        run(log, monkeypatch, code, waits)
