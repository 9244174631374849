"""A sink in a process of its own, as the node sees it: encoding, compression, disk and Rerun never hold up a tick.

The node's side is a queue and a thread that sends what waits. It is woken right after a tick, when the next sample is
furthest, and sends in batches so small that the interpreter is not held for long. The child's side is
`apart_child.py`. They talk through a pair of sockets: a `Job`, then lists of rows, notes and at last the `Ending` one
way, `Report`s the other way. The end of the one is told to the other by the socket, whatever it dies of.
"""

from __future__ import annotations

import os
import pickle
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.answer import Answer, Ending
from knee_contact_ros.errors import UsageError

CHILD = "knee_contact_ros.apart_child"
PERIOD = 0.01
"""How long [s] answers are gathered while more come"""
LATEST = 0.05
"""How long [s] the last answers wait to be sent when no more come"""
BATCH = 64
"""Answers that are sent at once at most: so long the interpreter is held, some 0.1 ms."""
PAUSE = 0.001
"""Time [s] for others to have the interpreter if more wait"""
START = 180.0
"""How long [s] a child may take to open its output"""
LAST_WORDS = 5.0
"""How long [s] a child may take to end once its socket is closed"""

OPEN, REFUSED, FAILED, ENDED, DONE = "open", "refused", "failed", "ended", "done"
"""States of a child: its output is open, could not be opened, stopped, is complete sooner than it was to be, is
complete"""


class Job(NamedTuple):
    """What a child is for."""

    module: str
    """It has a function `open_output` that gives an `apart_child.Output`"""
    arguments: tuple[Any, ...]
    """Of that function"""


class Note(NamedTuple):
    """Something to be told between two answers."""

    name: str
    values: dict[str, str]


class Discard(NamedTuple):
    """The output shall vanish."""


class Report(NamedTuple):
    """What a child says of itself."""

    state: str
    written: int
    """Answers"""
    reason: str = ""
    """Why it refused, failed or ended"""
    remarks: tuple[str, ...] = ()
    """What else the user shall know"""


class Handling(NamedTuple):
    """How a sink's answers are handled in the node."""

    row: Callable[[Answer], tuple[Any, ...]]
    """What is sent of an answer; plain tuples, numbers, texts and bytes are quick to send"""
    most: int
    """Answers that may wait"""
    gaps_allowed: bool
    """Whether the answers beyond are dropped and counted; otherwise the sink has failed then"""
    patience: float
    """How long [s] nothing may move, once it shall end, until it is ended by force"""


class Tell(NamedTuple):
    """Who is told, from a thread of a sink."""

    failure: Callable[[str], None]
    """Of answers that are left out, and of an output that has stopped or cannot be opened; once each"""
    remark: Callable[[str], None]
    """Of what else the user shall know"""


class SinkProcess:
    """Hands answers to a process that keeps them; `put` never waits, and nothing that happens there is felt here.

    The construction only begins: answers are taken at once, and whether the output could be opened is known later.
    """

    def __init__(self, label: str, job: Job, handling: Handling, tell: Tell, awaited: bool) -> None:
        """Begin.

        `label` names the output in messages. That it cannot be opened is not told if that is `awaited`: then
        `wait_until_open` says so.
        """
        self.process: subprocess.Popen[bytes] | None = None
        """None: not started yet, or it could not be"""
        self.failure = ""
        """What is wrong; empty while all is well"""
        self.dropped = 0
        """Answers that the output does not get"""
        self._label, self._job, self._handling = label, job, handling
        self._to_tell, self._awaited = tell, awaited
        self._waiting: deque[Answer | Note | Ending | Discard] = deque()
        self._room = handling.most
        self._due = 0.0  # when to send next
        self._wake = threading.Event()
        self._ended = False  # nothing more shall be sent
        self._given_up = ""
        self._last = Report("", 0)
        self._moved = 0  # counts signs of life
        self._concluded = False
        self._opened = False
        self._known = threading.Event()  # whether it was opened
        self._thread = threading.Thread(target=self._run, name="feeder", daemon=True)
        self._thread.start()

    def put(self, answer: Answer) -> None:
        """Hand over an answer; never waits. Not to be called from two threads."""
        if len(self._waiting) < self._room:
            self._waiting.append(answer)
            now = time.monotonic()
            if now >= self._due:
                self._due = now + PERIOD
                self._wake.set()
        elif not self._ended:
            self.dropped += 1

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand over a note, which is kept between the answers before it and those after it; never waits."""
        if self._room:
            self._waiting.append(Note(name, values))

    def diagnostics(self) -> dict[str, str]:
        """Answers that wait to be sent, that are lost, and that were written at the child's last report; its id."""
        return {
            "backlog": str(len(self._waiting)),
            "dropped": str(self.dropped),
            "written": str(self._last.written),
            "process": str(self.process.pid) if self.process else "none",
        }

    def is_open(self) -> bool:
        """Whether the output is open; False: that is not known yet.

        Raises:
            UsageError: it could not be opened.
        """
        if self._known.is_set() and not self._opened:
            raise UsageError(self.failure)
        return self._opened

    def is_over(self) -> bool:
        """Whether nothing more comes of it: the output is complete, or has stopped."""
        return not self._thread.is_alive()

    def wait_until_open(self) -> None:
        """Wait until the output is open.

        Raises:
            UsageError: it could not be opened.
        """
        if not self._known.wait(START):
            self._give_up(f"its process did not start within {START:g} s")
        self.is_open()

    def end(self, ending: Ending) -> None:
        """Have the output completed, without waiting for it; what is put afterwards goes nowhere."""
        self._send_last(ending)

    def close(self, ending: Ending) -> None:
        """Have the output completed and wait for it; a process in which nothing moves any more is killed."""
        self.end(ending)
        self._wait()

    def discard(self) -> None:
        """Give up: leave no output behind."""
        self._send_last(Discard())
        self._wait()

    def _send_last(self, item: Ending | Discard) -> None:
        if not self._ended:
            self._ended, self._room = True, 0
            self._waiting.append(item)
            self._wake.set()

    def _wait(self) -> None:
        """Wait for the process to end; it may have to start first."""
        since, moved = time.monotonic(), self._moved
        while self._thread.is_alive():
            self._thread.join(0.05)
            if moved != self._moved:
                since, moved = time.monotonic(), self._moved
            patience = self._handling.patience if self._opened else START
            if time.monotonic() - since > patience:
                self._give_up(f"nothing moved for {patience:g} s when it was to be completed")
                return

    def _give_up(self, reason: str) -> None:
        """Kill the process; as a rule the thread then says why."""
        self._given_up = reason
        if self.process:
            self.process.kill()
        self._thread.join(LAST_WORDS)
        self._conclude(reason)  # a disk that does not answer can keep even a killed process

    def _run(self) -> None:
        """The thread: start the process, send and listen until it is gone."""
        trouble = ""
        try:
            connection, self.process = start_child()
        except OSError as error:
            self._conclude(f"no process can be started: {error.strerror}")
            return
        try:
            self._feed(connection)
        except (EOFError, ConnectionError):  # the child has closed its end; what it said before is still to be heard
            with suppress(EOFError, OSError):
                while True:
                    self._hear(connection)
        except Exception as error:  # whatever it is, the node must compute on
            trouble = f"{type(error).__name__}: {error}"
        connection.close()
        reap(self.process)
        self._conclude(trouble or self._trouble(self.process.returncode))

    def _feed(self, connection: Connection) -> None:
        """Send what waits.

        Raises:
            EOFError, ConnectionError: the child is gone.
            OverflowError: too many wait.
        """
        readable, writable = select.poll(), select.poll()
        readable.register(connection.fileno(), select.POLLIN)
        writable.register(connection.fileno(), select.POLLOUT)
        connection.send(self._job)
        while True:
            self._wake.wait(LATEST)
            self._wake.clear()
            while readable.poll(0):
                self._hear(connection)
            if self.dropped and not self.failure:
                self._on_gap()
            while self._waiting and writable.poll(0):  # sending to a child that stands still might never end
                self._send_batch(connection)
                if self._waiting:
                    time.sleep(PAUSE)

    def _on_gap(self) -> None:
        words = f"more than {self._handling.most} answers waited"
        if not self._handling.gaps_allowed:
            raise OverflowError(words)
        self._tell(f"{self._label} has gaps: {words}, as its process is slow or stands still")

    def _send_batch(self, connection: Connection) -> None:
        row, waiting = self._handling.row, self._waiting
        items = [waiting.popleft() for _ in range(min(len(waiting), BATCH))]
        batch = [row(item) if isinstance(item, Answer) else item for item in items]
        connection.send_bytes(pickle.dumps(batch, pickle.HIGHEST_PROTOCOL))  # half as dear as `send`
        self._moved += 1

    def _hear(self, connection: Connection) -> None:
        """Take a report; raises EOFError if there will be none."""
        self._last = connection.recv()
        self._moved += 1
        for remark in self._last.remarks:
            self._to_tell.remark(remark)
        if self._last.state == OPEN:
            self._opened = True
            self._known.set()

    def _trouble(self, code: int | None) -> str:
        """Why the process ended, with this code; empty if it was to."""
        if self._last.state == DONE:
            return ""
        if self._last.reason or self._given_up:
            return self._last.reason or self._given_up
        if code is None or code >= 0:
            return f"its process ended with code {code}"
        return f"its process was ended by {signal.Signals(-code).name}"

    def _conclude(self, trouble: str) -> None:
        """Nothing more is sent."""
        if self._concluded:
            return
        self._concluded, self._room = True, 0
        self.dropped += sum(isinstance(item, Answer) for item in self._waiting)
        self._waiting.clear()
        if trouble:
            if self._opened and self._last.state != ENDED:
                trouble = f"{self._label} stopped: {trouble}"
            elif not self._opened and self._last.state != REFUSED:
                trouble = f"{self._label} cannot be opened: {trouble}"
            self._tell(trouble, quiet=self._awaited and not self._opened)
        self._known.set()

    def _tell(self, failure: str, quiet: bool = False) -> None:
        self.failure = failure
        if not quiet:
            self._to_tell.failure(failure)


def start_child() -> tuple[Connection, subprocess.Popen[bytes]]:
    """Start a process, and give our end of the sockets between us.

    It has a session of its own, so that Ctrl-C in a terminal does not reach it: the node says when it shall end. It
    imports from where this process does, and not from the working folder: a file there may have a library's name.

    Raises:
        OSError: no process can be started.
    """
    path = os.pathsep.join(str(Path(folder).absolute()) for folder in sys.path)
    ours, theirs = socket.socketpair()
    with ours, theirs:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", CHILD, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
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
