"""The process of a sink, seen from the node's: how it is started and ended, and whether it was stopped."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

CHILD = "knee_contact_ros.sinks.worker"
LAST_WORDS = 5.0
"""How long [s] a child may take to end once its socket is closed"""


def start_child(niceness: int) -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start a process of such a niceness beyond ours, and give our end of the sockets between us.

    It has a process group of its own, so that Ctrl-C in a terminal does not reach it: the node says when it shall end.
    But no session: Linux may share the processors out by session (`sched_autogroup_enabled`), and then one that works a
    little at a time starves beside busy ones of another, and niceness does not count.

    It imports from where this process does, and not from the working folder: a file there may have a library's name.

    Raises:
        OSError: no process can be started.
    """
    path = os.pathsep.join(str(Path(folder).absolute()) for folder in sys.path)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", CHILD, str(theirs.fileno()), str(niceness)],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            process_group=0,
            env=os.environ | {"PYTHONPATH": path},
        )
        return Connection(ours.detach()), process


def reap(process: subprocess.Popen[bytes]) -> None:
    """Have a process gone that has closed its socket or was left alone with it."""
    for _ in range(2):
        with suppress(subprocess.TimeoutExpired):
            process.wait(LAST_WORDS)
            return
        process.kill()


def is_stopped(pid: int) -> bool:
    """Whether a process was stopped by a signal."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2][1] in "Tt"
    except (OSError, IndexError):
        return False
