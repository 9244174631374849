"""The keeper of all other processes of ours: started, watched, ended as a user would, and never left behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import FrameType
from typing import IO, Any, NamedTuple

from knee_contact_ros.system.errors import UsageError

Process = subprocess.Popen[bytes]
PATIENCE = 30.0
"""How long [s] a process may take to end, as a rule"""
LAST_WORDS = 5.0
"""How long [s] a process may take to end once its socket is closed"""
RUN_MODULE = (
    "import sys; sys.path[:] = filter(None, sys.path); del sys.argv[0]; "
    "import runpy; runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
)
"""`python -P -m`, which Python 3.10 has not"""
OWN_GROUP: dict[str, Any] = {"process_group": 0} if sys.version_info >= (3, 11) else {"preexec_fn": os.setpgrp}
"""For `Popen`: a process group of its own"""


class Child(NamedTuple):
    """A process, and what it says."""

    name: str
    process: Process
    log: Path

    def check(self) -> None:
        """Tell if it has died.

        Raises:
            UsageError: it has.
        """
        if self.process.poll() is not None:
            lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            raise UsageError(
                f"{self.name} ended with code {self.process.returncode}: {lines[-1] if lines else 'it said nothing'}"
            )


def start(command: Sequence[str], output: IO[bytes] | None, **how: Any) -> Process:
    """A process that reads nothing, and says what it says to `output`, or where we do; `how` as for `Popen`.

    Raises:
        OSError: it cannot be started.
    """
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, **how)


@contextmanager
def kept(command: Sequence[str], output: IO[bytes], patience: float, **how: Any) -> Iterator[Process]:
    """A process that is ended at the end, whatever happens; see `start` and `end`."""
    process = None
    try:
        with signals_later():
            process = start(command, output, **how)
        yield process
    finally:
        if process:
            end(process, patience)


@contextmanager
def child_process(name: str, arguments: Sequence[str], log: Path, patience: float = PATIENCE) -> Iterator[Child]:
    """`python` with these arguments and its output in `log`; at the end it gets SIGINT and `patience` [s].

    Raises:
        UsageError: it failed, or did not end.
    """
    try:
        with log.open("wb") as output, kept([sys.executable, *arguments], output, patience) as process:
            child = Child(name, process, log)
            yield child
            process.send_signal(signal.SIGINT)
            process.wait(patience)
            if process.returncode:
                child.check()
    except subprocess.TimeoutExpired:
        raise UsageError(f"{name} did not end within {patience:g} s") from None


def python_module(module: str, *arguments: str) -> dict[str, Any]:
    """For `Popen`: a module in a process that imports from where this one does.

    And not from the working folder: a file there may have a library's name.
    """
    path = os.pathsep.join(str(Path(folder).absolute()) for folder in sys.path)
    command = [sys.executable, "-c", RUN_MODULE, module, *arguments]
    return {"command": command, "env": os.environ | {"PYTHONPATH": path}}


def connected(module: str, *arguments: str) -> tuple[Connection, Process]:
    """A module of ours in a process of its own, and our end of the sockets between us.

    Its own end is the number that its command line names first. It has a process group of its own, so that Ctrl-C in a
    terminal does not reach it: we say when it shall end. But no session: Linux may share the processors out by session
    (`sched_autogroup_enabled`), and then one that works a little at a time starves beside busy ones of another, and
    niceness does not count.

    Raises:
        OSError: no process can be started.
    """
    ours, theirs = socket.socketpair()
    with ours, theirs:
        how = python_module(module, str(theirs.fileno()), *arguments)
        process = start(output=None, pass_fds=[theirs.fileno()], **OWN_GROUP, **how)
        return Connection(ours.detach()), process


def reap(process: Process) -> None:
    """Have a process gone that has closed its socket or was left alone with it."""
    for _ in range(2):
        with suppress(subprocess.TimeoutExpired):
            process.wait(LAST_WORDS)
            return
        process.kill()


def end(process: Process, patience: float) -> None:
    """End a process if it still runs, at once if it does not listen or the user is in a hurry."""
    try:
        if process.poll() is None:
            process.terminate()
            process.wait(patience)
    except subprocess.TimeoutExpired:
        pass
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


def is_stopped(pid: int) -> bool:
    """Whether a process was stopped by a signal."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2][1] in "Tt"
    except (OSError, IndexError):
        return False


@contextmanager
def signals_later() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back meanwhile: one between a process's start and its being known would leave it behind.

    Of the main thread only, which alone has them.
    """
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for late in came:
            signal.raise_signal(late)


@contextmanager
def interrupted_by_sigterm() -> Iterator[None]:
    """Have SIGTERM do meanwhile what Ctrl-C does, so that what was begun is cleared away. Of the main thread only.

    Raises:
        KeyboardInterrupt: it came.
    """

    def on_terminate(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    previous = signal.signal(signal.SIGTERM, on_terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
