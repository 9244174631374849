"""The node's outputs: recorder and viewer, and the recordings that are begun and completed while it runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

from knee_contact_ros.answer import Answer, Ending
from knee_contact_ros.apart import SinkProcess, Tell
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.drawing import Serving, drawing_of
from knee_contact_ros.errors import UsageError
from knee_contact_ros.messages import NANOSECONDS
from knee_contact_ros.outputs import refuse_existing
from knee_contact_ros.parameters import Parameters, Record
from knee_contact_ros.record import MB, Limits, Settings
from knee_contact_ros.sinks import recorder, viewer
from knee_contact_ros.topics import KNEE_CONTACT, knee_name

RECORDER, VIEWER = "recorder", "viewer"


class Outputs:
    """Takes answers off the tick path: every output is a process of its own, and nothing here waits but `close`."""

    def __init__(
        self,
        parameters: Parameters,
        model: KneeModel,
        provenance: Mapping[str, str],
        names: Mapping[str, str],
        tell: Tell,
    ) -> None:
        """Open all outputs that the parameters ask for; if one cannot be opened, none is left behind.

        `names` gives the absolute name under which each topic is recorded; `tell` says who is told, from another
        thread, of an output that stops.

        Raises:
            UsageError: one cannot be opened.
        """
        self._names = names
        self.provenance = provenance
        """What recordings that begin from now on say of themselves"""
        self._recording = recording_settings(parameters.record)
        self._tell = tell
        self._sinks: dict[str, SinkProcess] = {}
        self._ending: dict[Path, SinkProcess] = {}
        """Recordings that are being completed"""
        self._path = Path(parameters.record.path)
        with ExitStack() as undo:
            if parameters.record.path:
                self._sinks[RECORDER] = self._recorder(Path(parameters.record.path), awaited=True)
                undo.callback(self._sinks[RECORDER].discard)
            if parameters.rerun.mode != "off":
                self._sinks[VIEWER] = _viewer(parameters, model, knee_name(names[KNEE_CONTACT]), tell)
                undo.callback(self._sinks[VIEWER].discard)
            for sink in self._sinks.values():
                sink.wait_until_open()
            undo.pop_all()

    def put(self, answer: Answer) -> None:
        """Hand over an answer."""
        for sink in self._sinks.values():
            sink.put(answer)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Hand over something that is worth a remark between two answers."""
        for sink in self._sinks.values():
            sink.note(name, values)

    def start_recording(self, path: str) -> None:
        """Record from the next answer on. That the file cannot be opened after all is told later.

        Raises:
            UsageError: there is no name, something of that name, or a recording already.
        """
        recording = self._sinks.get(RECORDER)
        if recording and not recording.failure:
            raise UsageError("a recording is being written already")
        if not path:
            raise UsageError("parameter record.path names no file")
        self._ending = {name: sink for name, sink in self._ending.items() if not sink.is_over()}
        if Path(path) in self._ending:
            raise UsageError(f"{path} is still being completed")
        refuse_existing(Path(path))
        self._path = Path(path)
        self._sinks[RECORDER] = self._recorder(self._path)

    def stop_recording(self, ending: Ending) -> Path:
        """Have the recording completed, and return its name.

        Raises:
            UsageError: there is none.
        """
        recording = self._sinks.pop(RECORDER, None)
        if recording is None:
            raise UsageError("nothing is being recorded")
        recording.end(ending)
        self._ending[self._path] = recording
        return self._path

    def said(self) -> Iterator[tuple[str, dict[str, str], str]]:
        """Of every output its name, what it says of itself, and what is wrong with it."""
        for name, sink in self._sinks.items():
            yield name, sink.diagnostics(), sink.failure

    def close(self, ending: Ending) -> None:
        """Complete all files."""
        sinks = [*self._ending.values(), *self._sinks.values()]
        self._ending, self._sinks = {}, {}
        for sink in sinks:
            sink.end(ending)
        for sink in sinks:
            sink.close(ending)

    def _recorder(self, path: Path, awaited: bool = False) -> SinkProcess:
        return recorder(path, self.provenance, self._names, self._recording, self._tell, awaited)


def _viewer(parameters: Parameters, model: KneeModel, knee: str, tell: Tell) -> SinkProcess:
    rerun = parameters.rerun
    knees = tuple(name.strip() for name in rerun.knees.split(",")) if rerun.knees else ()
    if knees and (knee not in knees or "" in knees):
        raise UsageError(
            f"parameter rerun.knees: {rerun.knees!r} is not allowed; this knee, {knee}, must be one of them"
        )
    path = Path(rerun.path) if rerun.mode == "file" else None
    serving = Serving(rerun.port, rerun.mode == "spawn", knees)
    return viewer(path, serving, drawing_of(model, knee, parameters.body_weight), tell, awaited=True)


def recording_settings(record: Record) -> Settings:
    """How to record, from the parameters `record.*`."""
    limits = Limits(record.max_size * MB or math.inf, record.max_duration * NANOSECONDS or math.inf)
    return Settings(record.flush_period, limits, record.min_free * MB)
