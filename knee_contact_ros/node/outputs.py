"""The node's outputs: recorder and viewer, and the recordings that are begun and completed while it runs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from knee_contact_ros.bags.answer_recorder import refuse
from knee_contact_ros.parameters.schema import Section
from knee_contact_ros.sinks.process import MB, PATIENCE, Listeners, Queue, SinkProcess
from knee_contact_ros.sinks.protocol import Discard, Knee, Sink
from knee_contact_ros.streams.topics import Answer, Ending
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import all_names

RECORDER = "recorder"
MOST_ENDING = 4
"""Largest number of recordings that are being completed at a time: each is a process"""


class Outputs:
    """Hands answers to the outputs: each is a process of its own, and nothing here waits except `close`."""

    def __init__(self, knee: Knee, listeners: Listeners) -> None:
        """Start all outputs that the parameters ask for.

        `listeners` are called from another thread when an output cannot be opened or stops.

        Raises:
            UsageError: an output that the parameters ask for is not possible.
        """
        self._listeners = listeners
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
        for sink in self._sinks.values():
            sink.put(answer)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand a note, which belongs between two answers, to all outputs."""
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
        path = knee.parameters.record.path
        if not path:
            raise UsageError("parameter record.path names no file")
        self._ending = [sink for sink in self._ending if not sink.is_over()]
        if not all(sink.is_known() for sink in self._ending):
            raise UsageError(f"{self._ending[-1].name} has yet to be opened before it is completed; try again")
        if len(self._ending) >= MOST_ENDING:
            raise UsageError(f"{len(self._ending)} recordings are still being completed; try again when one is")
        refuse(Path(path), knee.parameters.record.min_free * MB)
        sink, name = sink_of("record", knee), next(all_names(Path(path)))
        assert sink  # noqa: S101  (there is a path)
        queue = queue_of("record", knee.parameters)
        self._sinks[RECORDER] = SinkProcess(sink._replace(name=str(name)), queue, self._listeners)
        return name

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

        Waits for at most `sinks.process.PATIENCE`, counted from `end` if that was called before.
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
