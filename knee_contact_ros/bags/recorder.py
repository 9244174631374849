"""Recordings: the files of one, the answers in them, and the recorder of a node.

`BagWriter` writes the files of a recording, and `AnswerWriter` answers with their inputs. `Recorder` does this in its
own process for a node; the process loads only this module, which needs no NumPy.

For each tick a recording contains its inputs, then its outputs. That order depends only on stamps, so a live recording
and an offline one have the same messages in the same order. Equal messages give equal files, because padding bytes are
zero (the serialiser of ROS leaves them uninitialised).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from shutil import disk_usage
from threading import Event, Thread
from typing import NamedTuple

from mcap.records import Statistics

from ..streams.output import PROVENANCE, RecordedKnee, Sink
from ..streams.topics import MESSAGE_TYPES, NANOSECONDS, RECORDED, Ending, Record
from ..system import output_files
from ..system.errors import UsageError
from .mcap_writer import McapWriter
from .metadata_file import information, put_metadata

REFUSED_SAMPLES = "refused_samples"
"""Name of the metadata record with the number of refused samples by reason"""
CONTINUED = "continued"
"""Name of the metadata record with the first file of the recording that a file continues"""
INTERRUPTION = "interrupted"
"""Name of the metadata record with the reason why the node did not complete the recording"""
NODE_GONE = "the node ended or gave the recording up before it was closed"
LONGEST_GATHERING = 0.03
"""Longest time [s] for which answers are gathered in the node; killing the node loses them"""
ABSOLUTE_NAMES = {topic: f"/{topic}" for topic in RECORDED}
"""Absolute name under which each topic is recorded if nothing else is given"""
MB = 10**6
"""Bytes in a megabyte"""


class FileLimits(NamedTuple):
    """FileLimits of a file, beyond which a recording continues in a new one."""

    size: float = math.inf
    """Size [B] at which a file is full"""
    duration: float = math.inf
    """Duration [ns] below which the stamps in a file must stay"""


NO_LIMITS = FileLimits()


class RecorderSettings(NamedTuple):
    """RecorderSettings of a node's recorder."""

    flush_period: float
    """Time [s] between two flushes: a crash loses as much"""
    limits: FileLimits = NO_LIMITS
    """FileLimits of each file"""
    min_free: float = 0.0
    """Space [B] that must stay free on the disk"""
    sync_period: float = 0.0
    """Time [s] between two syncs to the disk: a power failure loses as much; 0 means no syncs"""


class BagWriter:
    """Recording that is being written, in files that get their final names when they are complete.

    Until then a file has the suffix `.partial`. With limits there are several files: `split_if_due`, called between
    messages that may be separated, begins the next one. A thread completes the full file while writing continues.
    """

    def __init__(
        self,
        path: Path,
        overwrite: bool = False,
        limits: FileLimits = NO_LIMITS,
        next_free_name: bool = False,
        alone: bool = False,
        compressed: bool = True,
    ) -> None:
        """Open the first file for writing.

        Args:
            path: Name of the first file.
            overwrite: Whether a file of that name is replaced when the new one is complete.
            limits: FileLimits of each file.
            next_free_name: Whether to use the next free name, numbered like later files, if `path` is taken.
            alone: Whether to write no `metadata.yaml`, so that the folder does not become a rosbag2 folder.
            compressed: Whether chunks are compressed (zstd).

        Raises:
            UsageError: The file cannot be written; see `claim`.
        """
        self.path = path
        """Path of the first file"""
        if next_free_name:
            self._names = output_files.free_names(path)
            self.path, file = output_files.claim_first(self._names)
        else:
            self._names = output_files.later_names(path)
            file = output_files.claim(path, overwrite)
        self._limits = limits
        self._alone = alone
        self._compressed = compressed
        self.remarks: list[str] = []
        """Messages for the user"""
        self._complete: list[tuple[str, Statistics]] = []
        self._completing: list[tuple[McapWriter, Future[None]]] = []
        self._thread = ThreadPoolExecutor(1, "completing")  # which begins with its first task
        self.file = McapWriter(self.path, file, compressed, overwrite, {})
        """File that is being written"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        if topic not in self.file.channels:
            self.file.add_topic(topic, type_name)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.file.add_metadata(name, values)

    def write_message(self, topic: str, stamp: int, data: bytes) -> None:
        """Write a message's CDR bytes; log time and publish time are its stamp [ns]."""
        self.file.write_records([(topic, stamp, data)], {topic: topic})

    def split_if_due(self, stamp: int) -> None:
        """Continue in a new file if the present one is full, or would span too much time with this stamp [ns].

        Raises:
            UsageError: The new file cannot be opened; the present one is unchanged.
        """
        statistics = self.file.statistics
        limits = self._limits
        if limits == NO_LIMITS or not statistics.message_count:
            return
        span = max(statistics.message_end_time, stamp) - min(statistics.message_start_time, stamp)
        if span < limits.duration and self.file.written_bytes < limits.size:
            return
        self.file.flush()
        earlier = {topic: self.file.next_sequence(topic) for topic in self.file.channels}
        path, file = output_files.claim_first(self._names)
        following = McapWriter(path, file, self._compressed, overwrite=False, earlier=earlier)
        for topic in self.file.topics:
            following.add_topic(topic["name"], topic["type"])
        following.add_metadata(CONTINUED, {"first": self.path.name})
        full = self.file
        self.file = following
        self._completing.append((full, self._thread.submit(self._complete_file, full)))

    def flush(self) -> None:
        """Hand all written data to the operating system."""
        self.file.flush()
        self._check_completed(wait=False)

    def sync(self) -> None:
        """Sync all flushed data to the disk; may be called by another thread.

        Raises:
            OSError: The sync has failed.
        """
        for file, _ in self._completing.copy():
            file.sync()
        self.file.sync()

    def close(self) -> None:
        """Complete the recording and its `metadata.yaml`, unless it is alone or there is one of another bag."""
        self._check_completed(wait=True)
        self._complete_file(self.file)
        self._thread.shutdown()

    def discard(self) -> None:
        """Remove the unfinished files."""
        self._thread.shutdown()
        for file in (*(file for file, _ in self._completing), self.file):
            file.discard()

    def _complete_file(self, file: McapWriter) -> None:
        """Complete a file, give it its name, and list it in `metadata.yaml`."""
        file.complete()
        intended = file.path
        file.take_final_name()
        self._complete.append((file.path.name, file.statistics))
        if file.path != intended:
            self.remarks.append(
                f"something took the name {intended} meanwhile: the recording is {file.path}"
            )
            if self.path == intended:
                self.path = file.path
        if not self._alone:
            put_metadata(self.path.parent, information(self._complete, self.file.topics))

    def _check_completed(self, wait: bool) -> None:
        """Forget full files that the thread has completed; `wait` for all of them or not.

        Raises:
            OSError: A file could not be completed.
        """
        while self._completing and (wait or self._completing[0][1].done()):
            self._completing.pop(0)[1].result()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        with ExitStack() as failed:
            failed.callback(self.discard)
            if kind is None:
                self.close()
                failed.pop_all()


class AnswerWriter:
    """Writer of answers, with their inputs and outputs, into a bag."""

    def __init__(
        self,
        bag: BagWriter,
        provenance: Mapping[str, str],
        names: Mapping[str, str] = ABSOLUTE_NAMES,
        provenance_name: str = PROVENANCE,
    ) -> None:
        """Declare the topics in a new bag and write the provenance.

        Args:
            bag: Bag to write to.
            provenance: Content of the metadata record that describes how the answers are computed.
            names: Absolute name under which each topic is recorded.
            provenance_name: Name of the metadata record of the provenance.
        """
        self.bag = bag
        self._names = names
        for topic, name in names.items():
            bag.add_topic(name, MESSAGE_TYPES[topic])
        bag.add_metadata(provenance_name, dict(provenance))

    def write_answer(self, answer: Sequence[Record]) -> None:
        """Write the inputs and outputs of one answer, the outputs last; they are never split over two files."""
        self.bag.split_if_due(answer[-1][1])
        self.bag.file.write_records(answer, self._names)

    def write_answers(self, answers: Iterable[Sequence[Record]]) -> None:
        """Write many answers: without flushes between them, the same bytes as one by one."""
        for answer in answers:
            self.write_answer(answer)

    def write_note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after the answers so far."""
        self.bag.flush()  # messages wait for the end of their chunk, metadata does not
        self.bag.add_metadata(name, values)

    def write_ending(self, ending: Ending) -> None:
        """Write the remaining inputs, which led to no answer, and the numbers of refused samples by reason."""
        self.bag.file.write_records(ending.inputs, self._names)
        counts = {"total": sum(ending.refused.values())} | ending.refused
        self.bag.add_metadata(
            REFUSED_SAMPLES, {reason: str(count) for reason, count in counts.items()}
        )


class Recorder:
    """Recording that is written in the process of a sink (see `streams/output.py`)."""

    def __init__(self, writer: AnswerWriter, settings: RecorderSettings) -> None:
        """Begin to sync if the settings ask for it."""
        self.name = str(writer.bag.path)
        self.period = settings.flush_period
        self.write = writer.write_answers
        self.note = writer.write_note
        self._writer = writer
        self._bag = writer.bag
        self._min_free = settings.min_free
        self._interruption = NODE_GONE
        self._sync_error: OSError | None = None
        self._done = Event()
        if settings.sync_period:
            period = (settings.sync_period,)
            Thread(target=self._sync_periodically, args=period, name="sync", daemon=True).start()

    def flush(self) -> None:
        """Hand all written data to the operating system.

        Raises:
            OSError: Writing has failed, or the last sync to the disk has.
        """
        if self._sync_error:
            raise self._sync_error
        self._bag.flush()

    def news(self) -> tuple[str, ...]:
        """Return the remarks that are new since the last call.

        Raises:
            OSError: The file has been removed.
            UsageError: The recording was completed early, as the disk is nearly full.
        """
        shortage = ""
        if not self._done.is_set():
            shortage = space_shortage(self._bag.file.free_space(), self._min_free)
        if shortage:
            self._interruption = shortage
            self.finish(None)
            raise UsageError(
                f"recording {self._bag.path} has ended, complete up to here: {shortage}"
            )
        news = tuple(self._bag.remarks)
        self._bag.remarks = []
        return news

    def finish(self, ending: Ending | None) -> None:
        """Complete the file; without an `ending`, a metadata record gives the reason of the interruption."""
        if ending is None:
            self._bag.add_metadata(INTERRUPTION, {"reason": self._interruption})
        else:
            self._writer.write_ending(ending)
        self._done.set()
        self._bag.close()
        self.name = str(self._bag.path)

    def _sync_periodically(self, period: float) -> None:
        """Sync in a thread of its own, because writing must not wait for a slow disk."""
        try:
            while not self._done.wait(period):
                self._bag.sync()
        except OSError as error:
            self._sync_error = error


def space_shortage(free: float, least: float, size: float = 0.0) -> str:
    """Return a message about too little free disk space [B]; empty if `least` is left after a file of a size [B]."""
    if free >= least + size:
        return ""
    needed = f"{size / MB:.1f} MB are needed, " if size else ""
    return f"{free / MB:.1f} MB are free on its disk, {needed}and parameter record.min_free keeps {least / MB:g} MB"


def check_recordable(path: Path, min_free: float, size: float = 0.0) -> None:
    """Refuse a path that cannot be written, or whose disk has no room for a file; nothing is created.

    Beside the file's size [B], if it is known, `min_free` [B] must be free.

    Raises:
        UsageError: The path cannot be written (see `check_writable`), or the disk is nearly full.
    """
    output_files.check_writable(path)
    folder = next(folder for folder in path.absolute().parents if folder.exists())
    if shortage := space_shortage(disk_usage(folder).free, min_free, size):
        raise UsageError(f"cannot write {path}: {shortage}")


def sink_for(knee: RecordedKnee) -> Sink | None:
    """Describe the recorder of a knee as a sink, which writes MCAP; return None if the parameters name no file."""
    record = knee.parameters.record
    if not record.path:
        return None
    size = record.max_size * MB or math.inf
    duration = record.max_duration * NANOSECONDS or math.inf
    settings = RecorderSettings(
        record.flush_period, FileLimits(size, duration), record.min_free * MB, record.sync_period
    )
    arguments = (
        Path(record.path),
        dict(knee.provenance),
        dict(knee.names),
        settings,
        knee.provenance_name,
    )
    gather = min(record.flush_period, LONGEST_GATHERING)
    return Sink(
        "recorder",
        "recording",
        record.path,
        __name__,
        arguments,
        "records",
        gaps_allowed=False,
        gather=gather,
    )


def open_output(
    path: Path,
    provenance: Mapping[str, str],
    names: Mapping[str, str],
    settings: RecorderSettings,
    provenance_name: str = PROVENANCE,
) -> Recorder:
    """Open a recording in the process of a sink, under the first of its possible names that is free.

    Its remarks report another name than `path`, and interrupted recordings in the same folder.

    Raises:
        UsageError: The recording cannot be written; see `check_recordable` and `BagWriter`.
    """
    check_recordable(path, settings.min_free)
    bag = BagWriter(path, limits=settings.limits, next_free_name=True)
    if bag.path != path:
        bag.remarks.append(f"{path} is there already: this recording is {bag.path}")
    unfinished = output_files.unfinished_files(path.parent, ".mcap")
    bag.remarks += map(output_files.cut_off_message, unfinished)
    return Recorder(AnswerWriter(bag, provenance, names, provenance_name), settings)
