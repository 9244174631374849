"""Commands that run a node, each in a process of its own that need not import anything.

Imports are most of what a node's start costs. Here one process, the nursery, has imported what all of them need, and
forks: the new process runs the command as `python -m` does, with its own arguments, output, signals, threads and end.
"""

from __future__ import annotations

import gc
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from ctypes import CDLL
from functools import cache, cached_property
from importlib import import_module
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from pathlib import Path
from threading import Thread
from typing import NamedTuple

from knee_contact_ros.system.processes import Process, connected, reap

COMMAND = "knee_contact_ros.commands.main"
IMPORTED = (
    "knee_contact_ros.bags.recorder",
    "knee_contact_ros.commands.live",
    "knee_contact_ros.model.compiler",
    "knee_contact_ros.streams.load_stream",
    "knee_contact_ros.streams.contact_stream",
    "knee_contact_ros.view.markers",
    "rich.progress",
    "yaml",
)
"""Modules that the command imports sooner or later, if it runs a node; none of ROS, whose libraries begin threads"""
OUTPUTS = (1, 2)
"""File descriptors of standard output and of standard error"""
PR_SET_PDEATHSIG = 1
"""Option of Linux's `prctl`: the signal that a process gets when its parent is gone"""
LOOK_PERIOD = 0.02
"""Time [s] between two looks whether a process has ended"""


class Birth(NamedTuple):
    """What the nursery is asked for."""

    arguments: tuple[str, ...]
    """Arguments of the command"""
    without: str
    """Name of a module that must look absent; empty if there is none"""
    folder: str
    """Working folder"""


class Forked:
    """A process that the nursery has forked, used like a `Popen`."""

    def __init__(self, nursery: Nursery, pid: int, output: int) -> None:
        """Read what it says from a file descriptor, `output`."""
        self.pid = pid
        self.returncode: int | None = None
        self.stdout = os.fdopen(output)
        self._nursery = nursery
        self._said = ""

    def poll(self) -> int | None:
        """Return its code, if it has ended."""
        if self.returncode is None:
            self.returncode = self._nursery.code_of(self.pid)
        return self.returncode

    def wait(self, timeout: float) -> int:
        """Wait for its end."""
        deadline = time.monotonic() + timeout
        while (code := self.poll()) is None:
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(COMMAND, timeout)
            time.sleep(LOOK_PERIOD)
        return code

    def communicate(self, timeout: float) -> tuple[str, None]:
        """Wait for its end, and that of all others which have its output; return what was said, and no errors."""
        thread = Thread(target=self._listen, daemon=True)
        thread.start()
        thread.join(timeout)
        self.wait(0.0 if thread.is_alive() else timeout)
        return self._said, None

    def _listen(self) -> None:
        if not self.stdout.closed:
            with self.stdout:
                self._said = self.stdout.read()

    def send_signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it still runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Kill it."""
        self.send_signal(signal.SIGKILL)


class Nursery:
    """Our side."""

    def __init__(self) -> None:
        """The process that imports is started when it is first needed."""
        self._environment = environment()

    @cached_property
    def _end(self) -> tuple[Connection, Process]:
        """Our end of the connection to the process that imports, and that process."""
        return connected(__name__)

    def is_like_us(self) -> bool:
        """Whether its environment is ours: modules may read that when they are imported."""
        return self._environment == environment()

    def fork(self, arguments: Sequence[str], without: str = "") -> Forked:
        """Have a process forked that runs the command with these arguments, `without` a module."""
        connection, process = self._end
        ours, theirs = os.pipe()
        connection.send(Birth(tuple(arguments), without, str(Path.cwd())))
        send_handle(connection, theirs, process.pid)
        os.close(theirs)
        return Forked(self, connection.recv(), ours)

    def code_of(self, pid: int) -> int | None:
        """Code of a process that has ended; it is not to be asked for again then."""
        connection, _ = self._end
        connection.send(pid)
        code: int | None = connection.recv()
        return code

    def close(self) -> None:
        """End the process, if there is one."""
        if "_end" in vars(self):
            connection, process = self._end
            connection.close()
            reap(process)


@cache
def nursery() -> Nursery:
    """The one of this process."""
    return Nursery()


def environment() -> dict[str, str]:
    """Environment variables, without what pytest says there of each test."""
    return {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}


def serve(connection: Connection) -> Birth | None:
    """Fork until the other side is gone, and return None; in each process that was forked, return what it is to do."""
    while True:
        try:
            asked: Birth | int = connection.recv()
        except EOFError:
            return None
        if isinstance(asked, int):
            pid, status = os.waitpid(asked, os.WNOHANG)
            connection.send(os.waitstatus_to_exitcode(status) if pid else None)
            continue
        output = recv_handle(connection)
        pid = os.fork()
        if not pid:
            for number in OUTPUTS:
                os.dup2(output, number)
        os.close(output)
        if not pid:
            connection.close()
            CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
            return asked
        connection.send(pid)


def main() -> None:
    """Be the nursery, and then what it has forked."""
    for module in IMPORTED:
        import_module(module)
    assert "rclpy" not in sys.modules, "its tracing starts threads, which a fork loses"
    gc.freeze()  # what is shared with those that are forked stays so: their garbage collections do not touch it
    birth = serve(Connection(int(sys.argv[1])))
    if birth:
        os.chdir(birth.folder)
        if birth.without:
            assert birth.without not in sys.modules, "the nursery has imported it"
            sys.modules[birth.without] = None  # type: ignore[assignment]
        sys.argv[1:] = birth.arguments
        runpy.run_module(COMMAND, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
