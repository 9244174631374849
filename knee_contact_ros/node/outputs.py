"""The node's outputs: recorder and viewer, each in a process of its own, so that none of them ever delays a tick.

The node's side of an output is a queue and a thread that sends what waits. It is woken right after a tick, when the
next sample is furthest, and sends in batches so small that the interpreter is not held for long. The other side is
`output_process.py`. They communicate through a pair of sockets: the node sends a `Job`, then `Parts` of answers, notes
and at last the `Ending`; the child sends `Report`s. Each side learns from the socket that the other one has ended, for
whatever reason.
"""

from __future__ import annotations

import math
import pickle
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, TICK
from knee_contact_ros.bags.recorder import refuse
from knee_contact_ros.parameters.schema import Section
from knee_contact_ros.streams.output import DONE, ENDED, OPEN, REFUSED, Discard, Knee, Note, Report, Sink
from knee_contact_ros.streams.topics import NANOSECONDS, Answer, Ending
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import all_names
from knee_contact_ros.system.processes import Process, connected, is_stopped, reap

MB = 10**6
WORKER = "knee_contact_ros.node.output_process"

LATEST = 0.05
"""Longest time [s] that the last answers wait to be sent when no more come, unless they are gathered for longer"""
SOON = 0.125
"""Fill of a queue, from 0 to 1, from which answers are sent at once"""
BATCH = {"records": 64, "row": 512}
"""Largest number of answers sent at once, by the part that is sent; it holds the interpreter for some 0.1 ms"""
BATCH_SIZE = 4096
"""Largest mean size [B] of the answers that are sent at once; a single answer may be larger"""
ANSWER_SIZE, RECORD_SIZE = 450, 150
"""Memory [B] that an answer takes, and that each of its records takes beyond the message"""
PAUSE = 0.001
"""Time [s] in which other threads get the interpreter if more answers wait"""
START = 180.0
"""Longest time [s] that a child may take to open its output"""
PATIENCE = 3.0
"""Longest time [s] to wait for an output to be complete: with all else that a node does to end, 5 s at most"""
KILLED = 0.5
"""Longest time [s] to wait for a killed process: a disk that does not answer can keep it"""
WORTH_A_WARNING = 0.25
"""Fill of a queue, from 0 to 1, from which `/diagnostics` warns"""


class Queue(NamedTuple):
    """Size of the queue of a sink."""

    answers: int
    """Largest number of answers"""
    size: float
    """Largest memory that they take [B], approximately"""
    section: str
    """Section of the parameters `….queue` and `….queue_size` that say so"""


class Listeners(NamedTuple):
    """Functions that a sink calls with a message for the user, from its own thread."""

    failure: Callable[[str], None]
    """Takes errors: answers are left out, or the output has stopped or cannot be opened; each is reported once"""
    remark: Callable[[str], None]
    """Takes everything else that the user needs to know"""


Item = Answer | Note | Ending | Discard
"""One item of the queue of a sink"""


class SinkProcess:
    """Hands answers to a process that keeps them; `put` never waits, and no fault of that process affects the node.

    The constructor only starts the process: answers are taken at once, and whether the output could be opened is known
    later (`is_known`).
    """

    def __init__(self, sink: Sink, queue: Queue, listeners: Listeners) -> None:
        """Start the process of a sink in the background."""
        self.process: Process | None = None
        """Process of the sink; None if it has not been started yet, or could not be started"""
        self.name = sink.name
        """Name of the file; empty if there is none"""
        self.failure = ""
        """Message that says what is wrong; empty while all is well"""
        self.is_open = False
        """Whether the output is known to have been opened"""
        self.given_up = False
        """Whether the output stays incomplete because completing it took too long"""
        self._sink, self._queue, self._listeners = sink, queue, listeners
        self._part, self._batch = attrgetter(sink.part), BATCH[sink.part]
        self._waiting: deque[Item] = deque()
        self._room = queue.answers  # 0 once nothing more is taken
        self._put_size = self._sent_size = 0  # [B]; each is written by one thread
        self._refused = self._lost = 0  # answers that found no room, and that waited when the output stopped
        self._due = 0.0  # when to send next
        self._wake = threading.Event()
        self._ended = False  # the last item is in the queue
        self._reason = ""  # why it was given up
        self._last = Report("", 0)
        self._concluded, self._concluding = False, threading.Lock()
        self._known = threading.Event()  # whether it was opened
        self._thread = threading.Thread(target=self._run, name="feeder", daemon=True)
        self._thread.start()

    def put(self, answer: Answer) -> None:
        """Hand over an answer; never waits. Not to be called from two threads, nor beside `note`."""
        if self._take(answer):
            now = time.monotonic()
            if now >= self._due or self._fill() >= SOON:
                self._due = now + self._sink.gather
                self._wake.set()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand over a note, which is kept between the answers before it and those after it; never waits."""
        self.keep(Note(name, values))

    def keep(self, item: Answer | Note) -> None:
        """Hand over an answer or a note, to be sent with those that follow; never waits."""
        self._take(item)

    @property
    def dropped(self) -> int:
        """Number of answers that do not reach the output."""
        return self._refused + self._lost

    def diagnostics(self) -> dict[str, str]:
        """Values for `/diagnostics`: answers that wait, are lost and are written, and the id of the process."""
        return {
            "backlog": str(len(self._waiting)),
            "backlog [MB]": f"{self._waiting_size / MB:.1f}",
            "full [%]": f"{100.0 * self._fill():.0f}",
            "dropped": str(self.dropped),
            "written": str(self._last.written),
            "process": str(self.process.pid) if self.process else "none",
        }

    def problem(self) -> tuple[str, bool]:
        """Describe what is wrong (empty if nothing is), and say whether answers are lost because of it."""
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
        """Name of the output in messages: its kind and its file."""
        return f"{self._sink.kind} {self.name}".rstrip()

    def is_known(self) -> bool:
        """Whether it is known if the output could be opened."""
        return self._known.is_set()

    def is_over(self) -> bool:
        """Whether the output is complete or has stopped."""
        return not self._thread.is_alive()

    def wait_until_known(self) -> None:
        """Wait until the output is open or cannot be opened; then `failure` says why."""
        if not self._known.wait(START):
            self._give_up(f"its process did not start within {START:g} s")

    def end(self, ending: Ending | Discard) -> None:
        """Have the output completed, or removed if `ending` is a `Discard`, without waiting for that.

        Answers that are put afterwards are ignored.
        """
        if not self._ended:
            self._ended, self._room = True, 0
            self._waiting.append(ending)
            self._wake.set()

    def close(self, ending: Ending, patience: float = PATIENCE) -> None:
        """Have the output completed and wait for at most `patience` [s]; see `wait`."""
        self.end(ending)
        self.wait(time.monotonic() + patience)

    def wait(self, deadline: float) -> None:
        """Wait until the deadline [s, monotonic] for the output to be complete, after `end`.

        A process that is stopped at the deadline is killed. Any other one is left to complete its output by itself.
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
        text = f"{self.label} is not complete yet, and is not waited for: its process ({number}) goes on"
        if unsent:
            self._fail(f"{text}; {unsent} answers have yet to be handed to it")
        else:
            self._listeners.remark(text)

    def discard(self, patience: float = PATIENCE) -> None:
        """Have the output removed and wait for at most `patience` [s]; a process that still runs then is killed."""
        self.end(Discard())
        self._thread.join(patience)
        if self._thread.is_alive():
            self._give_up(f"its process did not end within {patience:g} s")

    def _unsent(self) -> int:
        """Number of answers that wait."""
        return sum(isinstance(item, Answer) for item in self._waiting.copy())

    def _take(self, item: Answer | Note) -> bool:
        """Add an item to the queue; False if there is no room."""
        if len(self._waiting) >= self._room or self._waiting_size >= self._queue.size:
            self._refused += not self._ended
            return False
        self._put_size += size_of(item)
        self._waiting.append(item)
        if self._concluded:  # since the room was looked at
            self._lose_waiting()
        return True

    def _lose_waiting(self) -> int:
        """Empty the queue, which nobody takes from any more; return how many answers are lost."""
        with self._concluding:
            lost = self._unsent()
            self._lost += lost
            self._waiting.clear()
            self._sent_size = self._put_size
        return lost

    @property
    def _waiting_size(self) -> int:
        """Memory that the waiting items take [B], approximately."""
        return self._put_size - self._sent_size

    def _fill(self) -> float:
        """Fill of the queue, from 0 to 1."""
        return max(len(self._waiting) / self._queue.answers, self._waiting_size / self._queue.size)

    def _too_many(self) -> str:
        """Message for a queue that was full."""
        answers, size, section = self._queue
        return (
            f"more waited than {answers} answers (parameter {section}.queue) or {size / MB:g} MB ({section}.queue_size)"
        )

    def _give_up(self, reason: str) -> None:
        """Kill the process; as a rule the thread then reports the reason."""
        self._reason = reason
        if self.process:
            self.process.kill()
        self._thread.join(KILLED)
        self._conclude(reason)  # a disk that does not answer can keep even a killed process

    def _run(self) -> None:
        """Start the process, send and listen until it is gone; runs in the thread."""
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
        """Send what waits, until an exception says that nothing more can be sent.

        Raises:
            EOFError, ConnectionError: the child is gone.
            UsageError: too many answers wait.
        """
        readable, writable = select.poll(), select.poll()
        readable.register(connection.fileno(), select.POLLIN)
        writable.register(connection.fileno(), select.POLLOUT)
        connection.send(self._sink.job)
        while True:
            self._wake.wait(max(LATEST, 2.0 * self._sink.gather) if self.is_open else LATEST)
            self._wake.clear()
            while readable.poll(0):
                self._hear(connection)
            if self.dropped and not self.failure:
                self._on_gap()
            due = len(self._waiting)  # what comes meanwhile is gathered again
            # Sending to a child that stands still might never end.
            while self._waiting and due > 0 and writable.poll(0):
                due -= self._send_batch(connection, due)
                if due > 0:
                    time.sleep(PAUSE)

    def _on_gap(self) -> None:
        """Report that answers were left out, or stop an output that must not have gaps."""
        text = f"{self._too_many()}, as its process is slow or stands still"
        if not self._sink.gaps_allowed:
            raise UsageError(text)
        self._fail(f"{self.label} has gaps: {text}")

    def _send_batch(self, connection: Connection, due: int) -> int:
        """Send the oldest answers, or the oldest item if it is none; return how many of the `due` items were sent."""
        part, waiting, size, most = self._part, self._waiting, 0, self._batch
        parts: list[Any] = []
        while waiting and len(parts) < most and size < most * BATCH_SIZE and isinstance(waiting[0], Answer):
            answer = waiting.popleft()
            size += size_of(answer)
            parts.append(part(answer))
        sent: Any = (parts, len(parts) < due)
        if not parts:
            sent = waiting.popleft()
            size = size_of(sent)
        self._sent_size += size
        connection.send_bytes(pickle.dumps(sent, pickle.HIGHEST_PROTOCOL))  # takes half the time of `send`
        return len(parts) or 1

    def _hear(self, connection: Connection) -> None:
        """Take a report; raises EOFError if there will be none."""
        self._last = connection.recv()
        self.name = self._last.name or self.name
        for remark in self._last.remarks:
            self._listeners.remark(remark)
        if self._last.state == OPEN:
            self.is_open = True
            self._known.set()

    def _trouble(self, code: int | None) -> str:
        """Say why the process ended, with this exit code; empty if it was to end."""
        if self._last.state == DONE:
            return ""
        if self._last.reason or self._reason:
            return self._last.reason or self._reason
        if code is None or code >= 0:
            return f"its process ended with code {code}"
        return f"its process was ended by {signal.Signals(-code).name}"

    def _conclude(self, trouble: str) -> None:
        """End the sending for good, and report the trouble if there is any."""
        with self._concluding:  # its own thread, and one that gives it up
            if self._concluded:
                return
            self._concluded, self._room = True, 0
        lost = self._lose_waiting()
        if trouble:
            if self.is_open and self._last.state != ENDED:
                trouble = f"{self.label} stopped: {trouble}"
            elif not self.is_open and self._last.state != REFUSED:
                trouble = f"{self.label} cannot be opened: {trouble}"
            if lost and self.given_up:
                trouble += f"; {lost} answers had not been handed to its process"
            self._fail(trouble)
        self._known.set()

    def _fail(self, failure: str) -> None:
        self.failure = failure
        self._listeners.failure(failure)


def size_of(item: Item) -> int:
    """Memory [B] that an item takes while it waits, approximately."""
    if isinstance(item, Answer):
        return ANSWER_SIZE + RECORD_SIZE * len(item.records) + item.size
    return sum(map(len, item.values.values())) + RECORD_SIZE if isinstance(item, Note) else 0


RECORDER = "recorder"
MOST_ENDING = 4
"""Largest number of recordings that are being completed at a time: each is a process"""


class Ring:
    """Last answers, and the notes between them, for a snapshot; bounded by their time and by their number."""

    def __init__(self, duration: float, most: int) -> None:
        """Keep the answers of the last `duration` [s], and at most so many of them; none if it is 0.

        Their time is that of their stamps, without the steps back of a clock that is set.
        """
        self._duration, self._most = round(duration * NANOSECONDS), most
        self._items: deque[tuple[int, Answer | Note]] = deque()
        self._now = self._last = 0

    def put(self, answer: Answer) -> None:
        """Keep an answer, and forget what is too old."""
        stamp = answer.records[-1][1]
        if stamp > self._last:
            self._now += stamp - self._last
        self._last = stamp
        items, oldest = self._items, self._now - self._duration
        items.append((self._now, answer))
        while len(items) > self._most or isinstance(items[0][1], Note) or items[0][0] <= oldest:
            items.popleft()
            if not items:
                return

    def note(self, note: Note) -> None:
        """Keep a note. Answers before other parameters are forgotten: a recording begins with one set of them."""
        if note.name == PARAMETERS_CHANGED and any(not name.startswith(("record.", TICK)) for name in note.values):
            self._items.clear()
        self._items.append((self._now, note))

    def taken(self) -> tuple[list[Answer | Note], float]:
        """What is kept, the oldest first, and the time [s] from its first answer to its last."""
        times = [at for at, item in self._items if isinstance(item, Answer)]
        return [item for _, item in self._items], (times[-1] - times[0]) / NANOSECONDS if times else 0.0


class Outputs:
    """Hands answers to the outputs: each is a process of its own, and nothing here waits except `close`."""

    def __init__(self, knee: Knee, listeners: Listeners) -> None:
        """Start all outputs that the parameters ask for.

        `listeners` are called from another thread when an output cannot be opened or stops.

        Raises:
            UsageError: an output that the parameters ask for is not possible.
        """
        self._listeners = listeners
        self.ring = Ring(knee.parameters.record.snapshot, knee.parameters.record.queue)
        """What a snapshot would hold"""
        self._sinks: dict[str, SinkProcess] = {}
        self._ending: list[SinkProcess] = []
        """Recordings that are being completed"""
        self._deadline = math.inf
        """Monotonic time [s] until which `close` waits, once all outputs were told to end"""
        described = [
            (sink_of(section, knee), queue_of(section, knee.parameters))
            for section in sections_of_outputs(type(knee.parameters))
        ]
        for sink, queue in described:  # started when all are possible
            if sink:
                self._sinks[sink.title] = SinkProcess(sink, queue, listeners)

    def wait_until_known(self) -> None:
        """Wait until all outputs are open or cannot be opened, which is reported; the node runs on without those.

        If the waiting is interrupted, all outputs are removed.
        """
        try:
            for sink in self._sinks.values():
                sink.wait_until_known()
        except BaseException:
            sinks, self._sinks = self._sinks, {}
            deadline = time.monotonic() + PATIENCE
            for sink in sinks.values():
                sink.end(Discard())
            for sink in sinks.values():
                sink.discard(max(deadline - time.monotonic(), 0.0))
            raise

    def put(self, answer: Answer) -> None:
        """Hand an answer to all outputs."""
        self.ring.put(answer)
        for sink in self._sinks.values():
            sink.put(answer)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand a note, which belongs between two answers, to all outputs."""
        self.ring.note(Note(name, values))
        for sink in self._sinks.values():
            sink.note(name, values)

    def start_recording(self, knee: Knee) -> Path:
        """Start a recording with the next answer, and return the name of its file.

        A file that cannot be opened after all is reported later.

        Raises:
            UsageError: the parameters name no file, it cannot be written, or too many files are being written already.
        """
        recording = self._sinks.get(RECORDER)
        if recording and not recording.failure:
            raise UsageError("a recording is being written already")
        if not knee.parameters.record.path:
            raise UsageError("parameter record.path names no file")
        self._sinks[RECORDER], name = self._recording(knee)
        return name

    def save_snapshot(self, items: Sequence[Answer | Note], knee: Knee) -> Path:
        """Write answers and notes that have been to a recording of their own, and return the name of its file.

        Raises:
            UsageError: as for `start_recording`.
        """
        recording, name = self._recording(knee, sum(item.size for item in items if isinstance(item, Answer)))
        for item in items:
            recording.keep(item)
        recording.end(Ending((), {}))
        self._ending.append(recording)
        return name

    def _recording(self, knee: Knee, size: int = 0) -> tuple[SinkProcess, Path]:
        """Begin a recording that will have at least this size [B]; return it and the name of its file."""
        path = Path(knee.parameters.record.path)
        self._ending = [sink for sink in self._ending if not sink.is_over()]
        if not all(sink.is_known() for sink in self._ending):
            raise UsageError(f"{self._ending[-1].name} has yet to be opened before it is completed; try again")
        if len(self._ending) >= MOST_ENDING:
            raise UsageError(f"{len(self._ending)} recordings are still being completed; try again when one is")
        refuse(path, knee.parameters.record.min_free * MB, size)
        sink, name = sink_of("record", knee), next(all_names(path))
        assert sink  # noqa: S101  (there is a path)
        queue = queue_of("record", knee.parameters)
        expected = (name,) if size else ()  # every snapshot but the first has another name than the parameter's
        job = sink.job._replace(arguments=(*sink.job.arguments, *expected))
        return SinkProcess(sink._replace(name=str(name), job=job), queue, self._listeners), name

    def stop_recording(self, ending: Ending) -> str:
        """Have the recording completed, and return the name of its file.

        Raises:
            UsageError: nothing is being recorded.
        """
        recording = self._sinks.pop(RECORDER, None)
        if recording is None:
            raise UsageError("nothing is being recorded")
        if recording.failure:
            raise UsageError(recording.failure)
        recording.end(ending)
        self._ending.append(recording)
        return recording.name

    def reports(self) -> Iterator[tuple[str, dict[str, str], str, bool]]:
        """For every output its name, its diagnostic values, what is wrong, and whether answers are lost by that."""
        for name, sink in self._sinks.items():
            yield name, sink.diagnostics(), *sink.problem()

    def end(self, ending: Ending) -> None:
        """Have all files completed, without waiting for it."""
        self._deadline = min(self._deadline, time.monotonic() + PATIENCE)
        for sink in [*self._ending, *self._sinks.values()]:
            sink.end(ending)

    def close(self, ending: Ending) -> bool:
        """Complete all files, and return whether that worked for all of them.

        Waits for at most `PATIENCE`, counted from `end` if that was called before.
        """
        self.end(ending)
        sinks, deadline = [*self._ending, *self._sinks.values()], self._deadline
        self._ending, self._sinks, self._deadline = [], {}, math.inf
        for sink in sinks:
            sink.wait(deadline)
        return not any(sink.given_up for sink in sinks)


def sections_of_outputs(schema: type[Section]) -> list[str]:
    """Names of the sections of a node's parameters that belong to an output."""
    return [name for name, field in schema.model_fields.items() if hasattr(field.annotation, "output")]


def sink_of(section: str, knee: Knee) -> Sink | None:
    """Describe the output of a section, by its module's `sink_for`; None if the parameters ask for none.

    Raises:
        UsageError: the output cannot be opened.
    """
    sink: Sink | None = import_module(getattr(knee.parameters, section).output).sink_for(knee)
    return sink


def queue_of(section: str, parameters: Section) -> Queue:
    """Size of the queue of the output of a section."""
    options = getattr(parameters, section)
    return Queue(options.queue, options.queue_size * MB, section)
