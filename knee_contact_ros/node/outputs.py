"""The node's outputs: recorder and viewer, each in its own process, so that none of them ever delays a tick.

The node's side of an output is a queue and a thread that sends waiting items. The other side is `output_process.py`.
They communicate through a pair of sockets: the node sends module and arguments, then lists of parts of answers, notes,
and finally the `Ending`; the process sends `Report`s. The socket also shows each side when the other one has ended.
"""

import marshal
import math
import pickle
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from ..bags.provenance import PARAMETERS_CHANGED
from ..bags.recorder import MB, check_recordable
from ..streams.output import (
    ANSWERS_FLAGGED,
    ENDED,
    FAILED,
    OPEN,
    REFUSED,
    STARTING,
    TICK,
    Note,
    RecordedKnee,
    Report,
    RunState,
    Sink,
)
from ..streams.topics import NANOSECONDS, Ending, TickOutput
from ..system.errors import UsageError
from ..system.output_files import free_names
from ..system.processes import Process, reap_process, start_connected
from ..system.realtime import start_ordinary

WORKER = "knee_contact_ros.node.output_process"

LATEST = 0.05
"""Longest time [s] between two checks for reports while an output begins or ends"""
BATCH = 64
"""Largest number of answers sent at a time, which blocks the interpreter for about 0.1 ms"""
ANSWER_SIZE, RECORD_SIZE, RUN_STATE_BYTES = 450, 150, 500
"""Memory [B] that an answer takes, each of its records beyond the message, and the state of the run"""
StateGetter = Callable[[], RunState | None]
"""Function that returns the state of a run, if it is known"""
START, PATIENCE = 180.0, 3.0
"""Longest times [s] to wait until an output is open, and until it is complete, so that a node ends within 5 s"""
WARNING_FILL = 0.25
"""Fill of a queue, from 0 to 1, from which `/diagnostics` warns"""


class SinkProcess:
    """Hands answers to a process that keeps them.

    `put_item` never waits, and no fault of that process affects the node. The constructor only
    starts the process: answers are accepted immediately, and the `state` is known later.
    """

    def __init__(self, sink: Sink, log: Any) -> None:
        """Start the process of a sink in the background.

        `log`, a logger, gets an error if answers are left out or the output cannot be opened or has stopped, each once,
        and warnings about everything else that the user needs to know.
        """
        self.state = STARTING
        """One of `STARTING`, `OPEN`, `FAILED` and `ENDED`"""
        self.process: Process | None = None
        """Process of the sink; None if it has not been started yet, or could not be started"""
        self.name, self.label = sink.name, f"{sink.kind} {sink.name}".rstrip()
        """Name of the file, empty if there is none; name of the output in messages"""
        self.failure = ""
        """Message that says what is wrong; empty while all is well"""
        self._sink, self._log = sink, log
        self._waiting: deque[Any] = deque()
        self._put_size = self._sent_size = 0  # [B]; each is written by one thread
        self._refused = self._lost = (
            0  # answers that found no room, and that waited when the output stopped
        )
        self._sent = 0  # answers that were handed to the process
        self._closed = False  # the last item is in the queue
        self._send_at = 0.0  # monotonic time [s]
        self._last = Report("", 0)
        self._wake, self._known = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="feeder", daemon=True)
        self._thread.start()

    def put_item(self, item: TickOutput | Note) -> None:
        """Hand over an answer, or a note between two of them; never waits. Not to be called from two threads."""
        if self._closed:
            return
        if self.is_over() or self._fill() >= 1.0:
            self._refused += 1
            return
        self._put_size += size_of(item)
        self._waiting.append(item)
        if not len(self._waiting) % BATCH:  # many may not fit while they are gathered
            self._wake.set()

    def send_gathered(self, now: float) -> None:
        """Have the answers sent that were gathered for long enough at a monotonic time [s]; else the thread does it."""
        if self._waiting and now >= self._send_at:
            self._send_at = now + self._sink.gather
            self._wake.set()

    @property
    def dropped(self) -> int:
        """Number of answers that do not reach the output."""
        return self._refused + self._lost

    def report_state(self) -> tuple[dict[str, str], str, bool]:
        """Values for `/diagnostics`, what is wrong (empty if nothing is), and whether answers are lost by that."""
        fill, process = self._fill(), str(self.process.pid) if self.process else "none"
        values = {
            "backlog": str(len(self._waiting)),
            "full [%]": f"{100.0 * fill:.0f}",
            "dropped": str(self.dropped),
        }
        values |= {"written": str(self._last.written), "process": process}
        wrong = self.failure or (f"{self.label}: {self._too_many()}" if self.dropped else "")
        late = (
            f"{self.label} is behind: {100.0 * fill:.0f} % of its queue is full"
            if fill >= WARNING_FILL
            else ""
        )
        return values, wrong or late, bool(wrong)

    def is_over(self) -> bool:
        """Whether the output is complete or has stopped."""
        return self.state in (FAILED, ENDED)

    def wait_until_known(self) -> None:
        """Wait until the output is open or cannot be opened; then `failure` says why."""
        if not self._known.wait(START):
            self._fail(f"{self.label}: its process has not started within {START:g} s")

    def request_end(self, ending: Ending) -> None:
        """Request that the output completes, without waiting; later answers are ignored."""
        if not self._closed:
            self._closed = True
            self._waiting.append(ending)
            self._wake.set()

    def wait_until_complete(self, deadline: float) -> bool:
        """Wait until the deadline [s, monotonic] for the output to be complete, after `request_end`.

        A process that needs longer completes by itself with what it received; return False if there was more, or if
        the output has failed although it allows no gaps.
        """
        self._thread.join(max(deadline - time.monotonic(), 0.0))
        if self.is_over():
            if self.dropped:
                self._log.warning(
                    f"{self.label}: {self.dropped} answers in all were not handed to it"
                )
            return self._sink.gaps_allowed or (self.state == ENDED and not self.dropped)
        unsent, process = (
            self._unsent(),
            f"its process ({self.process.pid if self.process else 'none yet'}) goes on",
        )
        left = f"{unsent} answers have not been handed to it"
        self._fail(f"{self.label} is not complete yet, and is not waited for: {process}; {left}")
        return not unsent

    def _unsent(self) -> int:
        """Number of answers that wait."""
        return sum(isinstance(item, TickOutput) for item in self._waiting.copy())

    def _fill(self) -> float:
        """Fill of the queue: 1 when it is full."""
        size = self._put_size - self._sent_size
        return float(
            max(
                len(self._waiting) / self._sink.limits.queue,
                size / (MB * self._sink.limits.queue_size),
            )
        )

    def _too_many(self) -> str:
        """Message for a queue that was full."""
        most, section = self._sink.limits, self._sink.section
        limits = f"{most.queue} answers (parameter {section}.queue) or {most.queue_size:g} MB ({section}.queue_size)"
        return f"more waited than {limits}, as its process is slow or stands still"

    def _run(self) -> None:
        """Start the process, and hand over waiting items until it is gone; runs in the thread."""
        reason = ""
        try:
            start_ordinary()
            sink = self._sink
            connection, self.process = start_connected(
                WORKER, str(sink.niceness), str(int(sink.apart))
            )
            with connection:
                try:
                    reason = self._feed(connection)
                except (
                    EOFError,
                    ConnectionError,
                ):  # the process has ended; what it said before is still to be heard
                    with suppress(EOFError, OSError):
                        while True:
                            self._hear(connection.recv())
            code = reap_process(self.process)
            if not reason and self._last.state != ENDED:
                ended = (
                    f"was ended by {signal.Signals(-code).name}"
                    if code < 0
                    else f"ended with code {code}"
                )
                reason = self._last.reason or f"its process {ended}"
        except Exception as error:  # whatever it is, the node must compute on
            reason = f"{type(error).__name__}: {error}"
        what, self.state = (
            "stopped" if self.state == OPEN else "cannot be opened",
            FAILED if reason else ENDED,
        )
        self._lost = self._unsent() + self._sent - self._last.written
        self._sent_size = self._put_size
        self._waiting.clear()
        if reason:
            told = reason if self._last.state == REFUSED else f"{self.label} {what}: {reason}"
            most = "" if self._last.state in (FAILED, REFUSED) else "up to "
            lost = f"; {most}{self._lost} answers are not in it" if self._lost else ""
            self._fail(told + lost)
        self._known.set()

    def _feed(self, connection: Connection) -> str:
        """Send waiting items until an exception shows that the process is gone; or return the reason to stop."""
        readable, writable = select.poll(), select.poll()  # quicker than the connection's own
        readable.register(connection.fileno(), select.POLLIN)
        writable.register(connection.fileno(), select.POLLOUT)
        connection.send((self._sink.module, self._sink.arguments))
        while True:
            gathers = self.state == OPEN and not self._closed
            self._wake.wait(LATEST + self._sink.gather if gathers else LATEST)
            self._wake.clear()
            while readable.poll(0):
                self._hear(connection.recv())
            if self._refused and not self.failure:
                if not self._sink.gaps_allowed:
                    return self._too_many()
                self._fail(f"{self.label} has gaps: {self._too_many()}")
            # What comes meanwhile is gathered again; sending to a process that stands still might never end.
            due = len(self._waiting)
            while due > 0 and writable.poll(0):
                due -= self._send_batch(connection)

    def _send_batch(self, connection: Connection) -> int:
        """Send the oldest answers, or the oldest item if it is not an answer; return how many."""
        waiting, items = self._waiting, [self._waiting.popleft()]
        sent = items[0]
        if isinstance(sent, TickOutput):
            while waiting and len(items) < BATCH and isinstance(waiting[0], TickOutput):
                items.append(waiting.popleft())
            sent = [getattr(item, self._sink.part) for item in items]
            self._sent += len(items)
        self._sent_size += sum(map(size_of, items))
        connection.send_bytes(
            pickle.dumps(sent, pickle.HIGHEST_PROTOCOL)
        )  # takes half the time of `send`
        return len(items)

    def _hear(self, report: Report) -> None:
        """Take a report."""
        self._last = report
        if report.name:
            self.name, self.label = report.name, f"{self._sink.kind} {report.name}"
        for remark in report.remarks:
            self._log.warning(remark)
        if report.state == OPEN:
            self.state = OPEN
            self._known.set()

    def _fail(self, failure: str) -> None:
        self.failure = failure
        self._log.error(failure)


def size_of(item: Any) -> int:
    """Memory [B] that an item takes while it waits, approximately."""
    if isinstance(item, TickOutput):
        return ANSWER_SIZE + RECORD_SIZE * len(item.records) + item.size
    return ANSWER_SIZE


RECORDER = "recorder"
LONGEST_BLOCK = NANOSECONDS // 100
"""Longest time [ns] after which a block of the ring ends, so that a snapshot may begin there"""
MOST_IN_BLOCK = 100
"""Largest number of answers in a block, also where stamps hardly advance"""
MAX_ENDING = 4
"""Largest number of recordings being completed at a time, each a process"""


class Block(NamedTuple):
    """Answers of the ring that came behind each other, or a note."""

    begin: int
    """Time [ns] of the first one"""
    end: int
    """Time [ns] of the last one"""
    state: RunState | None
    """State of the run before the first one"""
    number: int
    """Number of answers"""
    size: int
    """Memory [B] that they take while they wait"""
    content: bytes | Note
    """The answers in the form of `marshal`, or the note"""


class Ring:
    """Last answers, and the notes between them, for a snapshot; bounded by their time, number and memory.

    They are kept in blocks of bytes: thousands of objects that live for seconds would drive all else out of the
    processor's cache.
    """

    def __init__(self, duration: float, most: int, room: float, run_state: StateGetter) -> None:
        """Keep the answers of the last `duration` [s], up to a largest number and memory [B]; none for a duration of 0.

        Their time is that of their stamps, without the steps back of a clock that was set. `run_state` is called at the
        end of each block, as a snapshot may begin there.
        """
        self._duration, self._most, self._room = round(duration * NANOSECONDS), most, room
        self._period = min(self._duration // 100, LONGEST_BLOCK)
        self._most_in_block = min(most, MOST_IN_BLOCK)
        self._run_state = run_state
        self._state: RunState | None = None
        self._blocks: deque[Block] = deque()
        self._newest: list[TickOutput] = []
        """Answers that are in no block yet"""
        self._flags: list[Note] = []
        """Note of the bits that the kept answers have from the first one on, if any"""
        self._now = self._last = self._begin = self._end_at = self._number = self._size = 0

    def put_item(self, item: TickOutput | Note) -> None:
        """Keep an item, and forget what is too old.

        Answers before a change of parameters are forgotten, since a recording begins with one set of parameters.
        """
        if not self._duration:
            return
        if isinstance(item, TickOutput):
            before, self._last = self._last, item.records[-1][1]
            self._now += max(self._last - before, 0)
            if not self._newest:
                self._begin = self._now
            self._newest.append(item)
            if self._now >= self._end_at or len(self._newest) >= self._most_in_block:
                self._end_block()
            return
        self._end_block()
        if item.name == PARAMETERS_CHANGED and any(
            not name.startswith(("record.", TICK)) for name in item.values
        ):
            notes = [one.content for one in self._blocks if isinstance(one.content, Note)]
            self._flags = [one for one in (*self._flags, *notes) if one.name == ANSWERS_FLAGGED][
                -1:
            ]
            self._blocks.clear()
            self._number = self._size = 0
        self._keep(Block(self._now, self._now, self._state, 0, ANSWER_SIZE, item))

    def _end_block(self) -> None:
        newest, self._newest = self._newest, []
        if newest:
            size = sum(map(size_of, newest)) + RUN_STATE_BYTES
            content = marshal.dumps([tuple(item) for item in newest])
            self._keep(Block(self._begin, self._now, self._state, len(newest), size, content))
        self._state, self._end_at = self._run_state(), self._now + self._period

    def _keep(self, block: Block) -> None:
        blocks = self._blocks
        blocks.append(block)
        self._number += block.number
        self._size += block.size
        oldest = self._now - self._duration
        while blocks and (
            blocks[0].end <= oldest
            or self._number > self._most
            or self._size > self._room
            or isinstance(blocks[0].content, Note)
        ):
            forgotten = blocks.popleft()
            self._number -= forgotten.number
            self._size -= forgotten.size
            if isinstance(forgotten.content, Note) and forgotten.content.name == ANSWERS_FLAGGED:
                self._flags = [forgotten.content]

    def kept_items(self) -> tuple[list[TickOutput | Note], float, RunState | None]:
        """The kept items, oldest first, the time [s] from the first answer to the last, and the state before them."""
        self._end_block()
        if not self._blocks:
            return [], 0.0, None
        items: list[TickOutput | Note] = [*self._flags]
        for block in self._blocks:
            if isinstance(block.content, Note):
                items.append(block.content)
            else:
                items += [TickOutput(*one) for one in marshal.loads(block.content)]  # noqa: S302  (our own)
        first = self._blocks[0]
        return items, (self._now - first.begin) / NANOSECONDS, first.state


class Outputs:
    """Hands answers to the outputs: each is a process of its own, and nothing here waits except `complete_files`."""

    def __init__(self, knee: RecordedKnee, log: Any, run_state: StateGetter) -> None:
        """Start all outputs that the parameters ask for.

        `log` is a logger (see `SinkProcess`); `run_state` returns the present state of the run.

        Raises:
            UsageError: an output that the parameters ask for is not possible.
        """
        self._log = log
        record = knee.parameters.record
        self.ring = Ring(record.snapshot, record.queue, record.queue_size * MB, run_state)
        """Answers that a snapshot would contain"""
        self._ending: list[SinkProcess] = []
        """Recordings that are being completed, or have failed"""
        self._deadline = math.inf
        """Monotonic time [s] until which `complete_files` waits for the outputs, after `request_end`"""
        self.sinks: dict[str, SinkProcess] = {}
        """Outputs by their titles"""
        fields = type(knee.parameters).model_fields.items()
        described = [
            sink_of(name, knee) for name, field in fields if hasattr(field.annotation, "output")
        ]
        for sink in filter(None, described):  # started when all are possible
            self.sinks[sink.title] = SinkProcess(sink, log)

    def wait_until_known(self) -> None:
        """Wait until all outputs are open or cannot be opened, which is reported; the node continues without those."""
        for sink in self.sinks.values():
            sink.wait_until_known()

    def put_item(self, item: TickOutput | Note) -> None:
        """Hand an answer, or a note between two of them, to all outputs."""
        self.ring.put_item(item)
        for sink in self.sinks.values():
            sink.put_item(item)

    def send_gathered(self) -> None:
        """Have answers sent to the outputs that have gathered for long enough; to be called right after an answer."""
        now = time.monotonic()
        for sink in self.sinks.values():
            sink.send_gathered(now)

    def start_recording(self, knee: RecordedKnee) -> Path:
        """Start a recording with the next answer, and return the name of its file.

        A file that cannot be opened after all is reported later.

        Raises:
            UsageError: the parameters name no file, it cannot be written, or too many files are being written already.
        """
        before = self.sinks.get(RECORDER)
        if before and not before.failure:
            raise UsageError("a recording is being written already")
        if not knee.parameters.record.path:
            raise UsageError("parameter record.path names no file")
        self.sinks[RECORDER] = recording = self._recording(knee)
        self._ending += [before] if before else []
        return Path(recording.name)

    def save_snapshot(
        self, items: Sequence[TickOutput | Note], ending: Ending, knee: RecordedKnee
    ) -> None:
        """Write the kept answers and notes to a separate recording.

        Raises:
            UsageError: as for `start_recording`.
        """
        recording = self._recording(
            knee, sum(item.size for item in items if isinstance(item, TickOutput))
        )
        for item in items:
            recording.put_item(item)
        recording.request_end(ending)
        self._ending.append(recording)

    def _recording(self, knee: RecordedKnee, size: int = 0) -> SinkProcess:
        """Begin a recording that will have at least this size [B]."""
        path = Path(knee.parameters.record.path)
        self._ending = [sink for sink in self._ending if sink.state != ENDED]
        if starting := [
            sink.name for sink in self._ending if sink.state == STARTING and not sink.failure
        ]:
            raise UsageError(f"{starting[0]} is not open yet; try again")
        if (number := sum(not sink.is_over() for sink in self._ending)) >= MAX_ENDING:
            raise UsageError(
                f"{number} recordings are still being completed; try again when one is complete"
            )
        check_recordable(path, knee.parameters.record.min_free * MB, size)
        sink = sink_of("record", knee)
        assert sink  # noqa: S101  (there is a path)
        return SinkProcess(sink._replace(name=str(next(free_names(path)))), self._log)

    def stop_recording(self, ending: Ending) -> str:
        """Request that the recording completes, and return the name of its file.

        Raises:
            UsageError: nothing is being recorded.
        """
        if (recording := self.sinks.pop(RECORDER, None)) is None:
            raise UsageError("nothing is being recorded")
        recording.request_end(ending)
        self._ending.append(recording)
        if recording.failure:
            raise UsageError(recording.failure)
        return recording.name

    def request_end(self, ending: Ending) -> None:
        """Request that all files complete, without waiting."""
        self._deadline = min(self._deadline, time.monotonic() + PATIENCE)
        for sink in [*self._ending, *self.sinks.values()]:
            sink.request_end(ending)

    def complete_files(self, ending: Ending) -> bool:
        """Complete all files, and return whether all answers have reached them.

        Waits for at most `PATIENCE`, counted from `request_end` if that was called before.
        """
        self.request_end(ending)
        complete = [
            sink.wait_until_complete(self._deadline)
            for sink in [*self._ending, *self.sinks.values()]
        ]
        return all(complete)


def sink_of(section: str, knee: RecordedKnee) -> Sink | None:
    """Describe the output of a section, by its module's `sink_for`; None if the parameters ask for none.

    Raises:
        UsageError: the output cannot be opened.
    """
    limits = getattr(knee.parameters, section)
    sink: Sink | None = import_module(limits.output).sink_for(knee)
    apart = knee.parameters.realtime
    return sink and sink._replace(section=section, limits=limits, apart=apart)
