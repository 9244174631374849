"""The node's outputs: recorder and viewer, and the recordings that are begun and completed while it runs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from knee_contact_ros.bags.answer_recorder import refuse
from knee_contact_ros.bags.writer import MB, Limits, Settings
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.messages.answer import Answer, Ending
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.messages.topics import KNEE_CONTACT, knee_name
from knee_contact_ros.parameters.schema import Parameters, Record
from knee_contact_ros.sinks.kinds import recorder, viewer
from knee_contact_ros.sinks.process import PATIENCE, Listeners, Queue, SinkProcess
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import all_names, refuse_impossible
from knee_contact_ros.view.outlines import Serving, drawing_of

RECORDER, VIEWER = "recorder", "viewer"
MOST_ENDING = 4
"""Recordings that may be in the course of being completed: each is a process"""


class Outputs:
    """Takes answers off the tick path: every output is a process of its own, and nothing here waits but `close`."""

    def __init__(
        self,
        parameters: Parameters,
        model: KneeModel,
        provenance: Mapping[str, str],
        names: Mapping[str, str],
        tell: Listeners,
    ) -> None:
        """Begin all outputs that the parameters ask for; `wait_until_open` then says whether they are open.

        `names` gives the absolute name under which each topic is recorded; `tell` says who is told, from another
        thread, of an output that stops.

        Raises:
            UsageError: one cannot be opened.
        """
        self._names = names
        self.provenance = provenance
        """What recordings that begin from now on say of themselves"""
        self._recording = recording_settings(parameters.record)
        self._queue = Queue(parameters.record.queue, parameters.record.queue_size * MB)
        self._tell = tell
        self._sinks: dict[str, SinkProcess] = {}
        self._ending: list[SinkProcess] = []
        """Recordings that are being completed"""
        if parameters.record.path:
            refuse(Path(parameters.record.path), self._recording)
        if parameters.rerun.mode != "off":
            self._sinks[VIEWER] = _viewer(parameters, model, knee_name(names[KNEE_CONTACT]), tell)
        if parameters.record.path:
            self._sinks[RECORDER] = self._recorder(Path(parameters.record.path), awaited=True)

    def wait_until_open(self) -> None:
        """Wait until all outputs are open; if one cannot be, or the waiting is broken off, none is left behind.

        Raises:
            UsageError: one cannot be opened.
        """
        try:
            for sink in self._sinks.values():
                sink.wait_until_open()
        except BaseException:
            sinks, self._sinks = self._sinks, {}
            deadline = time.monotonic() + PATIENCE
            for sink in sinks.values():
                sink.begin_discarding()
            for sink in sinks.values():
                sink.discard(max(deadline - time.monotonic(), 0.0))
            raise

    def put(self, answer: Answer) -> None:
        """Hand over an answer."""
        for sink in self._sinks.values():
            sink.put(answer)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand over something that is worth a remark between two answers."""
        for sink in self._sinks.values():
            sink.note(name, values)

    def start_recording(self, path: str) -> Path:
        """Record from the next answer on, under the name that is returned.

        That the file cannot be opened after all is told later.

        Raises:
            UsageError: there is no name, it cannot be written, or too much is being written already.
        """
        recording = self._sinks.get(RECORDER)
        if recording and not recording.failure:
            raise UsageError("a recording is being written already")
        if not path:
            raise UsageError("parameter record.path names no file")
        self._ending = [sink for sink in self._ending if not sink.is_over()]
        if not all(sink.is_known() for sink in self._ending):
            raise UsageError(f"{self._ending[-1].name} has yet to be opened before it is completed; try again")
        if len(self._ending) >= MOST_ENDING:
            raise UsageError(f"{len(self._ending)} recordings are still being completed; try again when one is")
        refuse(Path(path), self._recording)
        name = next(all_names(Path(path)))
        self._sinks[RECORDER] = self._recorder(Path(path), name=name)
        return name

    def stop_recording(self, ending: Ending) -> str:
        """Have the recording completed, and return its name.

        Raises:
            UsageError: there is none.
        """
        recording = self._sinks.pop(RECORDER, None)
        if recording is None:
            raise UsageError("nothing is being recorded")
        if recording.failure:
            raise UsageError(recording.failure)
        recording.end(ending)
        self._ending.append(recording)
        return recording.name

    def said(self) -> Iterator[tuple[str, dict[str, str], str, bool]]:
        """For every output its name, what it says of itself, what is wrong, and whether something is lost by that."""
        for name, sink in self._sinks.items():
            yield name, sink.diagnostics(), *sink.problem()

    def close(self, ending: Ending) -> bool:
        """Complete all files, for so long as `sinks.process.PATIENCE` says; whether none had to be given up."""
        deadline = time.monotonic() + PATIENCE
        sinks = [*self._ending, *self._sinks.values()]
        self._ending, self._sinks = [], {}
        for sink in sinks:
            sink.end(ending)
        for sink in sinks:
            sink.wait(deadline)
        return not any(sink.given_up for sink in sinks)

    def _recorder(self, path: Path, awaited: bool = False, name: Path | None = None) -> SinkProcess:
        return recorder(path, self.provenance, self._names, self._recording, self._queue, self._tell, awaited, name)


def _viewer(parameters: Parameters, model: KneeModel, knee: str, tell: Listeners) -> SinkProcess:
    rerun = parameters.rerun
    knees = tuple(name.strip() for name in rerun.knees.split(",")) if rerun.knees else ()
    if knees and (knee not in knees or "" in knees):
        raise UsageError(
            f"parameter rerun.knees: {rerun.knees!r} is not allowed; this knee, {knee}, must be one of them"
        )
    path = Path(rerun.path) if rerun.mode == "file" else None
    if path:
        refuse_impossible(path)
    serving = Serving(rerun.port, rerun.mode == "spawn", knees)
    queue = Queue(rerun.queue, rerun.queue_size * MB)
    return viewer(path, serving, drawing_of(model, knee, parameters.body_weight), queue, tell, awaited=True)


def recording_settings(record: Record) -> Settings:
    """How to record, from the parameters `record.*`."""
    limits = Limits(record.max_size * MB or math.inf, record.max_duration * NANOSECONDS or math.inf)
    return Settings(record.flush_period, limits, record.min_free * MB, record.sync_period)
