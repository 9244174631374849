"""The process of a sink: it writes what the node sends, until the node requests its end or is gone.

It does not import ROS, and imports its output's libraries only once it runs. The node's side is `outputs.py`.
"""

import ctypes
import os
import platform
import signal
import sys
import time
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from struct import pack
from typing import Any

from ..streams.output import ENDED, FAILED, OPEN, REFUSED, Note, Report
from ..streams.topics import Ending
from ..system.errors import UsageError
from ..system.realtime import leave_processor

SWITCH_PERIOD = 1e-4
"""Longest time [s] for which a computing thread keeps the interpreter from the receiving thread"""
REPORT_PERIOD = 1.0
"""Time [s] between two checks whether the output must end, and between two reports"""
SET_ATTRIBUTES = {"x86_64": 314, "aarch64": 274}
"""Number of Linux's system call `sched_setattr`, by machine"""
SLICE = 100_000_000
"""Requested time slice of a processor [ns], the longest one allowed"""


def write_output(connection: Connection, module: str, arguments: tuple[Any, ...]) -> bool:
    """Open an output and write what is sent until the end, flushed in time; return False if it has failed."""
    output, written = None, 0
    safe = 0  # answers that a flush has handed to the operating system

    def report(state: str, reason: str = "", news: tuple[str, ...] = ()) -> None:
        with suppress(OSError):  # nobody may be there any more
            connection.send(Report(state, written, output.name if output else "", reason, news))

    try:
        output = import_module(module).open_output(*arguments)
        report(OPEN)
        flush_at = report_at = (
            0.0  # monotonic times [s]; what opening has written is flushed at once
        )
        sent: Any = ()
        unflushed = True
        while not isinstance(sent, Ending | None):
            wake_at = min(flush_at, report_at) if unflushed else report_at
            if connection.poll(max(wake_at - time.monotonic(), 0.0)):
                sent, unflushed = receive_item(connection), True
                if isinstance(sent, Note):
                    output.note(*sent)
                elif isinstance(sent, list):
                    output.write(sent)
                    written += len(sent)
            now = time.monotonic()
            if now >= flush_at and (unflushed or now >= report_at):
                output.flush()
                safe = written
                flush_at, unflushed = now + output.period, False
            if now >= report_at:
                report(OPEN, news=output.news())
                report_at = now + REPORT_PERIOD
        output.finish(sent)
        report(ENDED, news=output.news())
    except UsageError as error:
        report(REFUSED, str(error))
    except Exception as error:  # whatever it is, the node must know
        written = safe
        report(
            FAILED,
            (isinstance(error, OSError) and error.strerror) or f"{type(error).__name__}: {error}",
        )
        return False
    return True


def receive_item(connection: Connection) -> Any:
    """The next item; None if the node is gone."""
    try:
        return connection.recv()
    except (EOFError, OSError):
        return None


def lower_priority(niceness: int) -> None:
    """Give way to the node's process, and ignore signals that end a process: only the node ends this one.

    `niceness` is added to the node's. At 0 the process gets its share of a busy machine, but interrupts no other.
    Linux (from 6.12) lets a process finish its slice before one that wakes, unless the latter's slice is shorter. With
    the usual slices a sample would wait up to 3 ms for us. Earlier versions refuse or ignore the request.
    """
    # A service manager sends the first two to all processes of a node, the system the last one if the node is gone.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    if niceness:
        os.nice(niceness)
    if call := SET_ATTRIBUTES.get(platform.machine()):
        own = os.getpriority(os.PRIO_PROCESS, 0)
        ctypes.CDLL(None).syscall(
            call, 0, pack("IIQiIQQQ", 48, os.SCHED_BATCH, 0, own, 0, SLICE, 0, 0), 0
        )


def main() -> None:
    """Work on the socket whose number the command line names first; niceness and `Sink.apart` are behind it."""
    lower_priority(int(sys.argv[2]))
    if int(sys.argv[3]):
        leave_processor()
    sys.setswitchinterval(SWITCH_PERIOD)
    with Connection(int(sys.argv[1])) as connection:
        asked = receive_item(connection)
        well = not asked or write_output(connection, *asked)
    if not well:
        os._exit(
            1
        )  # libraries that try once more to write what could not be written would only be in the way


if __name__ == "__main__":
    main()
