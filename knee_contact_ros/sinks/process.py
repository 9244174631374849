"""A sink in a process of its own, as the node sees it: encoding, compression, disk and Rerun never hold up a tick.

The node's side is a queue and a thread that sends what waits. It is woken right after a tick, when the next sample is
furthest, and sends in batches so small that the interpreter is not held for long. The child's side is
`worker.py`. They talk through a pair of sockets: a `Job`, then `Parts` of answers, notes and at last the `Ending` one
way, `Report`s the other way. The end of the one is told to the other by the socket, whatever it dies of.
"""

from __future__ import annotations

import pickle
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from operator import attrgetter
from typing import Any, NamedTuple

from knee_contact_ros.messages.answer import Answer, Ending
from knee_contact_ros.sinks.protocol import DONE, ENDED, OPEN, REFUSED, Discard, Note, Report, Sink
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import Process, connected, is_stopped, reap

MB = 10**6
WORKER = "knee_contact_ros.sinks.worker"

LATEST = 0.05
"""How long [s] the last answers wait to be sent when no more come, unless they are gathered for longer"""
SOON = 0.125
"""Share of a queue from which on answers are gathered no longer"""
BATCH = {"records": 64, "row": 512}
"""Answers of which these are sent at once at most: so long the interpreter is held, some 0.1 ms."""
BATCH_SIZE = 4096
"""[B] for each of these, likewise, unless one answer is larger"""
ANSWER_SIZE, RECORD_SIZE = 450, 150
"""[B] of memory that an answer takes, and each of its records beyond the message"""
PAUSE = 0.001
"""Time [s] for others to have the interpreter if more wait"""
START = 180.0
"""How long [s] a child may take to open its output"""
PATIENCE = 3.0
"""How long [s] to wait for an output to be complete: with all else that a node does to end, 5 s at most"""
KILLED = 0.5
"""How long [s] to wait for one that was killed: a disk that does not answer can keep it"""
WORTH_A_WARNING = 0.25
"""Share of a queue from which on it is told that it fills"""


class Queue(NamedTuple):
    """What may wait for a sink."""

    answers: int
    size: float
    """[B] of memory, about"""
    section: str
    """Of the parameters `….queue` and `….queue_size`"""


class Listeners(NamedTuple):
    """Who is told, from a thread of a sink."""

    failure: Callable[[str], None]
    """Of answers that are left out, and of an output that has stopped or cannot be opened; once each"""
    remark: Callable[[str], None]
    """Of what else the user shall know"""


Item = Answer | Note | Ending | Discard
"""What waits for a sink"""


class SinkProcess:
    """Hands answers to a process that keeps them; `put` never waits, and nothing that happens there is felt here.

    The construction only begins: answers are taken at once, and whether the output could be opened is known later.
    """

    def __init__(self, sink: Sink, queue: Queue, tell: Listeners) -> None:
        """Begin."""
        self.process: Process | None = None
        """None: not started yet, or it could not be"""
        self.name = sink.name
        """Of the file"""
        self.failure = ""
        """What is wrong; empty while all is well"""
        self.given_up = False
        """Whether the output is not, and will not be, complete because that took too long"""
        self._sink, self._queue, self._part = sink, queue, attrgetter(sink.part)
        self._to_tell = tell
        self._waiting: deque[Item] = deque()
        self._room, self._room_size, _ = queue
        self._many, self._much = SOON * queue.answers, SOON * queue.size
        self._put_size = self._sent_size = 0  # [B] by one thread each
        self._sent = self._goal = 0  # items, and how many shall be in this go
        self._refused = self._lost = 0  # answers that found no room, and that waited when the output stopped
        self._gather, self._batch = sink.gather, BATCH[sink.part]
        self._due = 0.0  # when to send next
        self._wake = threading.Event()
        self._ended = False  # nothing more shall be sent
        self._reason = ""  # why it was given up
        self._last = Report("", 0)
        self._concluded, self._concluding = False, threading.Lock()
        self._opened = False
        self._known = threading.Event()  # whether it was opened
        self._thread = threading.Thread(target=self._run, name="feeder", daemon=True)
        self._thread.start()

    def put(self, answer: Answer) -> None:
        """Hand over an answer; never waits. Not to be called from two threads, nor beside `note`."""
        if self._take(answer):
            now = time.monotonic()
            if now >= self._due or len(self._waiting) >= self._many or self._put_size - self._sent_size >= self._much:
                self._due = now + self._gather
                self._wake.set()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand over a note, which is kept between the answers before it and those after it; never waits."""
        self._take(Note(name, values))

    @property
    def dropped(self) -> int:
        """Answers that the output does not get."""
        return self._refused + self._lost

    def diagnostics(self) -> dict[str, str]:
        """Answers that wait to be sent, that are lost, and that were written at the child's last report; its id."""
        return {
            "backlog": str(len(self._waiting)),
            "backlog [MB]": f"{self._waiting_size() / MB:.1f}",
            "full [%]": f"{100.0 * self._fill():.0f}",
            "dropped": str(self.dropped),
            "written": str(self._last.written),
            "process": str(self.process.pid) if self.process else "none",
        }

    def problem(self) -> tuple[str, bool]:
        """What is wrong, empty if nothing is, and whether something is lost by it."""
        fill = self._fill()
        if self.failure:
            return self.failure, True
        if self.dropped:
            return f"{self.label}: {self._too_many()}", True
        if fill < WORTH_A_WARNING:
            return "", False
        waiting = f"{len(self._waiting)} answers wait, {100.0 * fill:.0f} % of what may"
        return f"{self.label} is behind: {waiting}, as its process is slow or stands still", False

    @property
    def label(self) -> str:
        """The output in messages."""
        return f"{self._sink.kind} {self.name}".rstrip()

    def is_known(self) -> bool:
        """Whether it is known if the output could be opened."""
        return self._known.is_set()

    @property
    def is_open(self) -> bool:
        """Whether the output could be opened; False: not, or that is not known yet."""
        return self._opened

    def is_over(self) -> bool:
        """Whether nothing more comes of it: the output is complete, or has stopped."""
        return not self._thread.is_alive()

    def wait_until_known(self) -> None:
        """Wait until the output is open, or cannot be; `failure` says why not."""
        if not self._known.wait(START):
            self._give_up(f"its process did not start within {START:g} s")

    def end(self, ending: Ending) -> None:
        """Have the output completed, without waiting for it; what is put afterwards goes nowhere."""
        self._send_last(ending)

    def close(self, ending: Ending, patience: float = PATIENCE) -> None:
        """Have the output completed and wait for it, so long [s] at most; see `wait`."""
        self.end(ending)
        self.wait(time.monotonic() + patience)

    def wait(self, deadline: float) -> None:
        """Wait for an output that was told to end, until the deadline [s, monotonic].

        A process that was stopped is killed then. Any other one is left to complete its output by itself.
        """
        self._thread.join(max(deadline - time.monotonic(), 0.0))
        if not self._thread.is_alive():
            return
        unsent = self._unsent()
        self.given_up = bool(unsent)
        if self.process and is_stopped(self.process.pid):
            self.given_up = True
            self._give_up("its process stood still when it was to end")
            return
        number = self.process.pid if self.process else "none yet"
        said = f"{self.label} is not complete yet, and is not waited for: its process ({number}) goes on"
        if unsent:
            self._tell(f"{said}; {unsent} answers have yet to be handed to it")
        else:
            self._to_tell.remark(said)

    def begin_discarding(self) -> None:
        """Have no output left behind, without waiting for it."""
        self._send_last(Discard())

    def discard(self, patience: float = PATIENCE) -> None:
        """Give up: leave no output behind, if the process ends so soon [s]; then it is killed."""
        self.begin_discarding()
        self._thread.join(patience)
        if self._thread.is_alive():
            self._give_up(f"its process did not end within {patience:g} s")

    def _unsent(self) -> int:
        """Answers that wait."""
        return sum(isinstance(item, Answer) for item in self._waiting.copy())

    def _take(self, item: Answer | Note) -> bool:
        """Have it wait; False if there is no room."""
        if len(self._waiting) >= self._room or self._put_size - self._sent_size >= self._room_size:
            self._refused += not self._ended
            return False
        self._put_size += size_of(item)
        self._waiting.append(item)
        if self._concluded:  # since it was asked whether there is room
            self._lose_waiting()
        return True

    def _lose_waiting(self) -> int:
        """Nobody comes for what waits; answers that are lost by that."""
        with self._concluding:
            lost = self._unsent()
            self._lost += lost
            self._waiting.clear()
            self._sent_size = self._put_size
        return lost

    def _waiting_size(self) -> int:
        return self._put_size - self._sent_size

    def _fill(self) -> float:
        """How full the queue is, from 0 to 1."""
        queue = self._queue
        return max(len(self._waiting) / queue.answers, self._waiting_size() / queue.size)

    def _too_many(self) -> str:
        """What is wrong if the queue was full."""
        answers, size, section = self._queue
        return (
            f"more waited than {answers} answers (parameter {section}.queue) or {size / MB:g} MB ({section}.queue_size)"
        )

    def _send_last(self, item: Ending | Discard) -> None:
        if not self._ended:
            self._ended, self._room = True, 0
            self._waiting.append(item)
            self._wake.set()

    def _give_up(self, reason: str) -> None:
        """Kill the process; as a rule the thread then says why."""
        self._reason = reason
        if self.process:
            self.process.kill()
        self._thread.join(KILLED)
        self._conclude(reason)  # a disk that does not answer can keep even a killed process

    def _run(self) -> None:
        """The thread: start the process, send and listen until it is gone."""
        trouble = ""
        try:
            connection, self.process = connected(WORKER, str(self._sink.niceness))
        except OSError as error:
            self._conclude(f"no process can be started: {error.strerror}")
            return
        try:
            self._feed(connection)
        except (EOFError, ConnectionError):  # the child has closed its end; what it said before is still to be heard
            with suppress(EOFError, OSError):
                while True:
                    self._hear(connection)
        except UsageError as error:
            trouble = str(error)
        except Exception as error:  # whatever it is, the node must compute on
            trouble = f"{type(error).__name__}: {error}"
        connection.close()
        reap(self.process)
        self._conclude(trouble or self._trouble(self.process.returncode))

    def _feed(self, connection: Connection) -> None:
        """Send what waits.

        Raises:
            EOFError, ConnectionError: the child is gone.
            UsageError: too many wait.
        """
        readable, writable = select.poll(), select.poll()
        readable.register(connection.fileno(), select.POLLIN)
        writable.register(connection.fileno(), select.POLLOUT)
        connection.send(self._sink.job)
        while True:
            self._wake.wait(max(LATEST, 2.0 * self._gather) if self._opened else LATEST)
            self._wake.clear()
            while readable.poll(0):
                self._hear(connection)
            if self.dropped and not self.failure:
                self._on_gap()
            self._goal = self._sent + len(self._waiting)  # what comes meanwhile is gathered again
            # Sending to a child that stands still might never end.
            while self._waiting and self._sent < self._goal and writable.poll(0):
                self._send_batch(connection)
                if self._sent < self._goal:
                    time.sleep(PAUSE)

    def _on_gap(self) -> None:
        words = f"{self._too_many()}, as its process is slow or stands still"
        if not self._sink.gaps_allowed:
            raise UsageError(words)
        self._tell(f"{self.label} has gaps: {words}")

    def _send_batch(self, connection: Connection) -> None:
        """Send what waits longest: answers, or something else."""
        part, waiting, size, most = self._part, self._waiting, 0, self._batch
        parts: list[Any] = []
        while waiting and len(parts) < most and size < most * BATCH_SIZE and isinstance(waiting[0], Answer):
            answer = waiting.popleft()
            size += size_of(answer)
            parts.append(part(answer))
        self._sent += len(parts) or 1
        sent: Any = (parts, self._sent < self._goal)
        if not parts:
            sent = waiting.popleft()
            size = size_of(sent)
        self._sent_size += size
        connection.send_bytes(pickle.dumps(sent, pickle.HIGHEST_PROTOCOL))  # half as dear as `send`

    def _hear(self, connection: Connection) -> None:
        """Take a report; raises EOFError if there will be none."""
        self._last = connection.recv()
        self.name = self._last.name or self.name
        for remark in self._last.remarks:
            self._to_tell.remark(remark)
        if self._last.state == OPEN:
            self._opened = True
            self._known.set()

    def _trouble(self, code: int | None) -> str:
        """Why the process ended, with this code; empty if it was to."""
        if self._last.state == DONE:
            return ""
        if self._last.reason or self._reason:
            return self._last.reason or self._reason
        if code is None or code >= 0:
            return f"its process ended with code {code}"
        return f"its process was ended by {signal.Signals(-code).name}"

    def _conclude(self, trouble: str) -> None:
        """Nothing more is sent."""
        with self._concluding:  # its own thread, and one that gives it up
            if self._concluded:
                return
            self._concluded, self._room = True, 0
        lost = self._lose_waiting()
        if trouble:
            if self._opened and self._last.state != ENDED:
                trouble = f"{self.label} stopped: {trouble}"
            elif not self._opened and self._last.state != REFUSED:
                trouble = f"{self.label} cannot be opened: {trouble}"
            if lost and self.given_up:
                trouble += f"; {lost} answers had not been handed to its process"
            self._tell(trouble)
        self._known.set()

    def _tell(self, failure: str) -> None:
        self.failure = failure
        self._to_tell.failure(failure)


def size_of(item: Item) -> int:
    """[B] of memory that something takes while it waits, about."""
    if isinstance(item, Answer):
        return ANSWER_SIZE + RECORD_SIZE * len(item.records) + item.size
    return sum(map(len, item.values.values())) + RECORD_SIZE if isinstance(item, Note) else 0
