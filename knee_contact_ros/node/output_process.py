"""The process of a sink: it writes what the node sends, until the node tells it to end or is gone.

It imports no ROS, and what its output needs only once it runs. The node's side is `outputs.py`.
"""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import time
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

from knee_contact_ros.streams.output import DONE, ENDED, FAILED, OPEN, REFUSED, Discard, Job, Note, Output, Report
from knee_contact_ros.system.errors import UsageError

REPORT_PERIOD = 1.0
"""Shortest time [s] between two reports on the number of answers"""
SWITCH_PERIOD = 1e-4
"""Longest time [s] that a computing thread keeps the interpreter from the one that receives: it asks for it often"""
LOOK_PERIOD = 1.0
"""Time [s] between two checks whether the output has to end"""
NEARLY = 0.875
"""Share of the time between two flushes from which a flush is due already, instead of a moment later"""
LATE = 2.0
"""Share from which a flush is due even though more answers wait, which would be taken first"""


class Child:
    """Receives answers and writes them to the output."""

    def __init__(self, connection: Connection) -> None:
        self.written = 0
        self._connection = connection
        self._readable = select.poll()
        self._readable.register(connection.fileno(), select.POLLIN)
        self._reported = 0
        self._name = ""

    def work(self, job: Job) -> bool:
        """Open the output of a job and write to it until the end; return False if it has failed."""
        try:
            output = import_module(job.module).open_output(*job.arguments)
            self._name = output.name
            self._report(OPEN, remarks=output.news())
            reason = self._keep(output)
            self._name = output.name
            self._report(ENDED if reason else DONE, reason, output.news())
        except UsageError as error:
            self._report(REFUSED, str(error))
        except Exception as error:  # whatever it is, the node must know
            self._report(FAILED, (isinstance(error, OSError) and error.strerror) or f"{type(error).__name__}: {error}")
            return False
        return True

    def _keep(self, output: Output) -> str:
        """Write what is sent until the end, flushed in time; return why the output ended early, or an empty text."""
        reported = looked = time.monotonic()
        flushed = looked - output.period  # what opening it has written is flushed at once
        unflushed, more = True, False
        while True:
            due = flushed + output.period if unflushed else math.inf
            patience = min(due, looked + LOOK_PERIOD) - time.monotonic()
            if self._comes(patience):  # after waking up late, what has come meanwhile is taken before the flush
                sent = self._next()
                if type(sent) is tuple:
                    parts, more = sent
                    output.write(parts)
                    self.written += len(parts)
                elif isinstance(sent, Note):
                    output.note(sent.name, sent.values)
                elif isinstance(sent, Discard):
                    output.discard()
                    return ""
                else:
                    output.finish(sent)
                    return ""
                unflushed = True
            else:
                more = False
            now = time.monotonic()
            waited = (now - flushed) / output.period
            if unflushed and waited >= NEARLY and (waited >= LATE or not (more or self._comes(0.0))):
                output.flush()
                flushed, unflushed = now, False
            if now >= looked + LOOK_PERIOD:
                if reason := self._must_end(output):
                    return reason
                looked = now
            if now >= reported + REPORT_PERIOD and self.written != self._reported:
                self._report(OPEN)
                reported = now

    def _must_end(self, output: Output) -> str:
        """Complete the output if it has to end early, and return the reason; otherwise report its news."""
        reason = output.must_end()
        if reason:
            output.finish(None)
        elif news := output.news():
            self._report(OPEN, remarks=news)
        return reason

    def _comes(self, patience: float) -> bool:
        """Whether something can be received within `patience` [s], be it the end of the connection."""
        return bool(self._readable.poll(1e3 * max(patience, 0.0)))

    def _next(self) -> Any:
        """Receive an item; None if the connection has ended."""
        try:
            return self._connection.recv()
        except (EOFError, OSError):
            return None

    def _report(self, state: str, reason: str = "", remarks: tuple[str, ...] = ()) -> None:
        self._reported = self.written
        with suppress(OSError):  # nobody may be there any more
            self._connection.send(Report(state, self.written, self._name, reason, remarks))


def step_back(niceness: int) -> None:
    """Give way to the node's process, and end only when the node says so: ignore signals that end a process.

    `niceness` is added to the node's. At 0 a process gets its share of a busy machine, and still interrupts nobody.
    """
    # A service manager sends the first two to all processes of a node, the system the last one if the node is gone.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    if niceness:
        os.nice(niceness)


def main() -> None:
    """Work on the socket whose number the command line names first, with the niceness that it names second."""
    step_back(int(sys.argv[2]))
    sys.setswitchinterval(SWITCH_PERIOD)
    with Connection(int(sys.argv[1])) as connection:
        try:
            job = connection.recv()
        except (EOFError, OSError):
            return
        well = Child(connection).work(job)
    if not well:
        os._exit(1)  # libraries that try once more to write what could not be written would only be in the way


if __name__ == "__main__":
    main()
