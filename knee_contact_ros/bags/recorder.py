"""Writing of recordings as a ROS 2 recorder does: MCAP files with CDR messages, and their `metadata.yaml`.

`BagFile` writes one MCAP file, `BagWriter` the files of a recording, and `AnswerWriter` answers with their inputs.
`Recorder` does this in its own process for a node; the process loads only this module, which needs no NumPy.

For each tick a recording contains its inputs, then its outputs. That order depends only on stamps, so a live recording
and an offline one have the same messages in the same order. Equal messages give equal files, because padding bytes are
zero (the serialiser of ROS leaves them uninitialised).
"""

from __future__ import annotations

import errno
import io
import math
import os
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path
from shutil import disk_usage
from struct import Struct
from threading import Event, Lock, Thread
from typing import IO, Any, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Statistics
from mcap.writer import CompressionType, Writer
from ruamel.yaml import YAML

from knee_contact_ros.streams.output import PROVENANCE, RecordedKnee, Sink
from knee_contact_ros.streams.topics import (
    MESSAGE_TYPES,
    NANOSECONDS,
    RECORDED,
    ROBOT_DESCRIPTION,
    Ending,
    Record,
    definition,
    typestore,
)
from knee_contact_ros.system import output_files
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import MAX_METADATA_SIZE, open_regular
from knee_contact_ros.system.output_files import partial_name, sync_folder

MAGIC = b"\x89MCAP0\r\n"
"""Magic bytes at the beginning and at the end of an MCAP file"""
HEAD = Struct("<BQ")
"""Head of a record: opcode, and length [B] of the content, which follows"""
MESSAGE = Struct("<HIQQ")
"""Beginning of a message record's content, before the data: channel, sequence number, log time and publish time [ns]"""
MESSAGE_HEAD = Struct("<BQHIQQ")
"""`HEAD` and `MESSAGE` together"""
INDEX = Struct("<HI")
"""Beginning of a message index record's content: channel, and length [B] of the entries, which follow"""
ENTRY = Struct("<QQ")
"""Entry of a message index: log time [ns] of a message, and offset [B] of its record in the uncompressed chunk"""
MESSAGE_OPCODE = int(Opcode.MESSAGE)
CHUNK_SIZE = 64 * 1024
"""Size [B] of the records beyond which a chunk ends: a small chunk ends in 2-4 ms, and a crash loses little"""
LIBRARY = "knee_contact_ros"
"""Name of the writing library in the header of a file"""
ROSBAG2, REFUSED_SAMPLES, CONTINUED, INTERRUPTED = (
    "rosbag2",
    "refused_samples",
    "continued",
    "interrupted",
)
"""Names of metadata records: the `metadata.yaml` of the file, the number of refused samples by reason, the first file
of the recording that a file continues, the reason why the node did not complete the recording"""
METADATA = "metadata.yaml"
"""Name of the file that makes a folder a bag"""
NODE_GONE = "the node ended or gave the recording up before it was closed"
GATHER = 0.03
"""Longest time [s] for which answers are gathered in the node; killing the node loses them"""
ABSOLUTE_NAMES = {topic: f"/{topic}" for topic in RECORDED}
"""Absolute name under which each topic is recorded if nothing else is given"""
MB = 10**6
"""Bytes in a megabyte"""
FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""Infinite duration of a QoS profile"""
OFFERED_QOS = [
    {
        "history": "keep_last",
        "depth": 100,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": FOREVER,
        "lifespan": FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
]
"""QoS profiles that the node and `replay` offer"""


class Limits(NamedTuple):
    """Limits of a file, beyond which a recording continues in a new one."""

    size: float = math.inf
    """Size [B] at which a file is full"""
    duration: float = math.inf
    """Duration [ns] below which the stamps in a file must stay"""


NO_LIMITS = Limits()


class Settings(NamedTuple):
    """Settings of a node's recorder."""

    flush_period: float
    """Time [s] between two flushes: a crash loses as much"""
    limits: Limits = NO_LIMITS
    """Limits of each file"""
    min_free: float = 0.0
    """Space [B] that must stay free on the disk"""
    sync_period: float = 0.0
    """Time [s] between two syncs to the disk: a power failure loses as much; 0 means no syncs"""


class Index(NamedTuple):
    """Message index of a channel in a chunk, with packed entries: `mcap`'s own is slow."""

    channel: int
    """Number of the channel"""
    entries: array[int]
    """Log time [ns] and place [B] in the chunk of each message, one after the other"""

    def write(self, stream: RecordBuilder) -> None:
        """Write the record, as `mcap.records.MessageIndex` does."""
        size = self.entries.itemsize * len(self.entries)
        stream.write(
            HEAD.pack(Opcode.MESSAGE_INDEX, INDEX.size + size) + INDEX.pack(self.channel, size)
        )
        stream.write(self.entries.tobytes())


class BagFile(Writer):
    """MCAP file that takes one message or thousands at a time.

    It gets its final name when it is complete; until then it is a locked `.partial` file. `mcap` writes all of it
    except message records and their index, for which its `add_message` would take three times as long. For these this
    class uses the current chunk and the statistics inside `mcap` 1.6.
    """

    _Writer__statistics: Statistics
    _Writer__chunk_builder: Any

    def __init__(
        self,
        path: Path,
        file: IO[bytes],
        compressed: bool,
        overwrite: bool,
        earlier: Mapping[str, int],
    ) -> None:
        """Open a file for writing.

        Args:
            path: Final name.
            file: File that `claim` has opened for this name.
            compressed: Whether chunks are compressed (zstd).
            overwrite: Whether the complete file replaces one that has the final name.
            earlier: Number of messages of each topic in earlier files of the recording: sequence numbers continue.
        """
        self.path, self.partial, self._overwrite, self._earlier = (
            path,
            partial_name(path),
            overwrite,
            earlier,
        )
        self.channels: dict[str, int] = {}
        """Channel number of each topic"""
        self.topics: list[dict[str, Any]] = []
        """Entries of the topics in `metadata.yaml`"""
        self._schemas: dict[str, int] = {}  # number of each schema by its name
        self._closing, self._file = Lock(), file
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        super().__init__(
            self._file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True
        )
        self.start("ros2", LIBRARY)
        self._chunk = self._Writer__chunk_builder
        self.statistics = self._Writer__statistics
        """Statistics of the records so far; log times [ns] are 0 without messages"""

    @property
    def size(self) -> int:
        """Number of bytes written, without the chunk that is being filled."""
        return self._file.tell()

    @property
    def place(self) -> int:
        """Number of bytes in the chunk that is being filled."""
        return int(self._chunk.count)

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        type_hash = typestore().hash_rihs01(type_name)
        entry = {"name": topic, "type": type_name, "serialization_format": "cdr"}
        self.topics.append(
            entry | {"offered_qos_profiles": qos_of(type_name), "type_description_hash": type_hash}
        )
        if type_name not in self._schemas:
            self._schemas[type_name] = self.register_schema(
                type_name, "ros2msg", definition(type_name)
            )
        metadata = {"offered_qos_profiles": offered_qos(type_name), "topic_type_hash": type_hash}
        self.channels[topic] = self.register_channel(
            topic, "cdr", self._schemas[type_name], metadata
        )

    def next_number(self, topic: str) -> int:
        """Sequence number of the next message of a topic: its number of messages in this file and earlier ones."""
        return self._earlier.get(topic, 0) + self.statistics.channel_message_counts.get(
            self.channels[topic], 0
        )

    def write_all(self, messages: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages under the absolute names of their topics; log time and publish time are their stamps [ns]."""
        counts, write, place = (
            self.statistics.channel_message_counts,
            self._chunk.record_writer.write,
            self.place,
        )
        for topic, stamp, data in messages:
            name = names[topic]
            channel = self.channels[name]
            number = self._earlier.get(name, 0) + counts[channel]
            entries = self._entries_of(channel, 1, stamp, stamp)
            entries.append(stamp)
            entries.append(place)
            write(
                MESSAGE_HEAD.pack(
                    MESSAGE_OPCODE, MESSAGE.size + len(data), channel, number, stamp, stamp
                )
                + data
            )
            place += MESSAGE_HEAD.size + len(data)
            if place > CHUNK_SIZE:
                self.flush()
                place = 0

    def append(
        self, data: memoryview, entries: Mapping[int, bytes], first: int, last: int
    ) -> None:
        """Add message records to the chunk that is being filled, and end it if it is full then.

        Args:
            data: Concatenated records, of which none but the last one goes beyond `CHUNK_SIZE`.
            entries: Packed message index entries (`ENTRY`) of each channel that has any, in the order of their first
                messages.
            first: Smallest log time [ns] of the messages.
            last: Largest log time [ns] of the messages.
        """
        for channel, piece in entries.items():
            self._entries_of(channel, len(piece) // ENTRY.size, first, last).frombytes(piece)
        self._chunk.record_writer.write(data)
        if self.place > CHUNK_SIZE:
            self.flush()

    def flush(self) -> None:
        """End the chunk that is being filled, and hand all written data to the operating system."""
        super().flush()  # type: ignore[no-untyped-call]

    def _entries_of(self, channel: int, count: int, first: int, last: int) -> array[int]:
        """Entries of a channel's index in the chunk, after `count` messages between two log times [ns] were counted."""
        statistics, chunk = self.statistics, self._chunk
        if first < statistics.message_start_time or not statistics.message_count:
            statistics.message_start_time = first
        if last > statistics.message_end_time:  # noqa: PLR1730  (`max` takes three times as long)
            statistics.message_end_time = last
        if first < chunk.message_start_time or not chunk.num_messages:
            chunk.message_start_time = first
        if last > chunk.message_end_time:  # noqa: PLR1730
            chunk.message_end_time = last
        statistics.message_count += count
        statistics.channel_message_counts[channel] += count
        chunk.num_messages += count
        index = chunk.message_indices.get(channel)
        if not index:
            index = chunk.message_indices[channel] = Index(channel, array("Q"))
        entries: array[int] = index.entries
        return entries

    def sync(self) -> None:
        """Sync all flushed data, and the name of the file, to the disk; may be called by another thread.

        Raises:
            OSError: The sync has failed.
        """
        with self._closing:
            if not self._file.closed:
                os.fdatasync(self._file.fileno())
                sync_folder(self.path.parent)

    def free_space(self) -> int:
        """Free space [B] on the disk of the file.

        Raises:
            OSError: The file has been removed.
        """
        self._check_presence()
        disk = os.fstatvfs(self._file.fileno())
        return disk.f_bavail * disk.f_frsize

    def complete(self) -> None:
        """Write the metadata of rosbag2 and the end of the file, and sync it to the disk."""
        self.add_metadata(
            ROSBAG2,
            {
                "serialized_metadata": to_yaml(
                    information([(self.path.name, self.statistics)], self.topics)
                )
            },
        )
        self.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())

    def take_name(self) -> None:
        """Give the complete file its final name, or the next free one if it was taken meanwhile.

        Raises:
            OSError: The file cannot be renamed, or has been removed.
        """
        self._check_presence()
        self.path = output_files.take_name(self.partial, self.path, self._overwrite)
        sync_folder(self.path.parent)
        with self._closing:
            self._file.close()

    def discard(self) -> None:
        """Close the file and remove it."""
        with (
            self._closing,
            suppress(OSError),
        ):  # a full disk also refuses what is still in the file's buffer
            self._file.close()
        self.partial.unlink(missing_ok=True)

    def _check_presence(self) -> None:
        """Check that the open file still has its name.

        Raises:
            OSError: The file has been removed or replaced.
        """
        with suppress(FileNotFoundError, NotADirectoryError):
            if os.path.samestat(self.partial.lstat(), os.fstat(self._file.fileno())):
                return
        raise OSError(errno.ENOENT, "its file or folder was removed while it was written")


class BagWriter:
    """Recording that is being written, in files that get their final names when they are complete.

    Until then a file has the suffix `.partial`. With limits there are several files: `split_if_due`, called between
    messages that may be separated, begins the next one. A thread completes the full file while writing continues.
    """

    def __init__(
        self,
        path: Path,
        overwrite: bool = False,
        limits: Limits = NO_LIMITS,
        next_free_name: bool = False,
        alone: bool = False,
        compressed: bool = True,
    ) -> None:
        """Open the first file for writing.

        Args:
            path: Name of the first file.
            overwrite: Whether a file of that name is replaced when the new one is complete.
            limits: Limits of each file.
            next_free_name: Whether to use the next free name, numbered like later files, if `path` is taken.
            alone: Whether to write no `metadata.yaml`, so that the folder does not become a rosbag2 folder.
            compressed: Whether chunks are compressed (zstd).

        Raises:
            UsageError: The file cannot be written; see `claim`.
        """
        self._limits, self._alone, self._compressed = limits, alone, compressed
        self._names = (
            output_files.free_names(path) if next_free_name else output_files.later_names(path)
        )
        claimed = (
            output_files.claim_first(self._names)
            if next_free_name
            else (path, output_files.claim(path, overwrite))
        )
        self.path, file = claimed
        """Path of the first file"""
        self.remarks: list[str] = []
        """Messages for the user"""
        self._complete: list[tuple[str, Statistics]] = []
        self._completing: list[tuple[BagFile, Future[None]]] = []
        self._thread = ThreadPoolExecutor(1, "completing")  # which begins with its first task
        self.file = BagFile(self.path, file, compressed, overwrite, {})
        """File that is being written"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        if topic not in self.file.channels:
            self.file.add_topic(topic, type_name)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.file.add_metadata(name, values)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Write a message's CDR bytes; log time and publish time are its stamp [ns]."""
        self.file.write_all([(topic, stamp, data)], {topic: topic})

    def split_if_due(self, stamp: int) -> None:
        """Continue in a new file if the present one is full, or would span too much time with this stamp [ns].

        Raises:
            UsageError: The new file cannot be opened; the present one is unchanged.
        """
        statistics, limits = self.file.statistics, self._limits
        if limits == NO_LIMITS or not statistics.message_count:
            return
        span = max(statistics.message_end_time, stamp) - min(statistics.message_start_time, stamp)
        if span < limits.duration and self.file.size < limits.size:
            return
        self.file.flush()
        earlier = {topic: self.file.next_number(topic) for topic in self.file.channels}
        following = BagFile(
            *output_files.claim_first(self._names),
            self._compressed,
            overwrite=False,
            earlier=earlier,
        )
        for topic in self.file.topics:
            following.add_topic(topic["name"], topic["type"])
        following.add_metadata(CONTINUED, {"first": self.path.name})
        full, self.file = self.file, following
        self._completing.append((full, self._thread.submit(self._complete_file, full)))

    def flush(self) -> None:
        """Hand all written data to the operating system."""
        self.file.flush()
        self._settle(wait=False)

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
        self._settle(wait=True)
        self._complete_file(self.file)
        self._thread.shutdown()

    def discard(self) -> None:
        """Remove the unfinished files."""
        self._thread.shutdown()
        for file in (*(file for file, _ in self._completing), self.file):
            file.discard()

    def _complete_file(self, file: BagFile) -> None:
        """Complete a file, give it its name, and list it in `metadata.yaml`."""
        file.complete()
        intended = file.path
        file.take_name()
        self._complete.append((file.path.name, file.statistics))
        if file.path != intended:
            self.remarks.append(
                f"something took the name {intended} meanwhile: the recording is {file.path}"
            )
            self.path = file.path if self.path == intended else self.path
        if not self._alone:
            put_metadata(self.path.parent, information(self._complete, self.file.topics))

    def _settle(self, wait: bool) -> None:
        """Take the results of the thread for completed files; `wait` for all full files or not.

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
        told_as: str = PROVENANCE,
    ) -> None:
        """Declare the topics in a new bag and write the provenance.

        Args:
            bag: Bag to write to.
            provenance: Content of the metadata record that describes how the answers are computed.
            names: Absolute name under which each topic is recorded.
            told_as: Name of the metadata record of the provenance.
        """
        self.bag, self._names = bag, names
        for topic, name in names.items():
            bag.add_topic(name, MESSAGE_TYPES[topic])
        bag.add_metadata(told_as, dict(provenance))

    def write(self, answer: Sequence[Record]) -> None:
        """Write the inputs and outputs of one answer, the outputs last; they are never split over two files."""
        self.bag.split_if_due(answer[-1][1])
        self.bag.file.write_all(answer, self._names)

    def write_all(self, answers: Iterable[Sequence[Record]]) -> None:
        """Write many answers: without flushes between them, the same bytes as one by one."""
        for answer in answers:
            self.write(answer)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after the answers so far."""
        self.bag.flush()  # messages wait for the end of their chunk, metadata does not
        self.bag.add_metadata(name, values)

    def finish(self, ending: Ending) -> None:
        """Write the remaining inputs, which led to no answer, and the numbers of refused samples by reason."""
        self.bag.file.write_all(ending.inputs, self._names)
        counts = {"total": sum(ending.refused.values())} | ending.refused
        self.bag.add_metadata(
            REFUSED_SAMPLES, {reason: str(count) for reason, count in counts.items()}
        )


class Recorder:
    """Recording that is written in the process of a sink (`protocol.Output`)."""

    def __init__(self, writer: AnswerWriter, settings: Settings) -> None:
        """Begin to sync if the settings ask for it."""
        self.name, self.period = str(writer.bag.path), settings.flush_period
        self.write, self.note = writer.write_all, writer.note
        self._writer, self._bag = writer, writer.bag
        self._min_free, self._interruption = settings.min_free, NODE_GONE
        self._sync_error: OSError | None = None
        self._done = Event()
        if settings.sync_period:
            Thread(
                target=self._sync, args=(settings.sync_period,), name="sync", daemon=True
            ).start()

    def flush(self) -> None:
        """Hand all written data to the operating system.

        Raises:
            OSError: Writing has failed, or the last sync to the disk has.
        """
        if self._sync_error:
            raise self._sync_error
        self._bag.flush()

    def news(self) -> tuple[str, ...]:
        """Remarks that are new since the last call.

        Raises:
            OSError: The file has been removed.
            UsageError: The recording was completed early, as the disk is nearly full.
        """
        if not self._done.is_set() and (
            shortage := space_shortage(self._bag.file.free_space(), self._min_free)
        ):
            self._interruption = shortage
            self.finish(None)
            raise UsageError(
                f"recording {self._bag.path} has ended, complete up to here: {shortage}"
            )
        news, self._bag.remarks = tuple(self._bag.remarks), []
        return news

    def finish(self, ending: Ending | None) -> None:
        """Complete the file; without an `ending`, a metadata record gives the reason of the interruption."""
        if ending is None:
            self._bag.add_metadata(INTERRUPTED, {"reason": self._interruption})
        else:
            self._writer.finish(ending)
        self._done.set()
        self._bag.close()
        self.name = str(self._bag.path)

    def _sync(self, period: float) -> None:
        """Sync in a thread of its own, because writing must not wait for a slow disk."""
        try:
            while not self._done.wait(period):
                self._bag.sync()
        except OSError as error:
            self._sync_error = error


def space_shortage(free: float, least: float, size: float = 0.0) -> str:
    """Message about too little free disk space [B]; empty if at least `least` is left after a file of a size [B]."""
    if free >= least + size:
        return ""
    needed = f"{size / MB:.1f} MB are needed, " if size else ""
    return f"{free / MB:.1f} MB are free on its disk, {needed}and parameter record.min_free keeps {least / MB:g} MB"


def refuse(path: Path, min_free: float, size: float = 0.0) -> None:
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
    """Description of the recorder of a knee as a sink, which writes MCAP; None if the parameters name no file."""
    record = knee.parameters.record
    if not record.path:
        return None
    limits = Limits(
        record.max_size * MB or math.inf, record.max_duration * NANOSECONDS or math.inf
    )
    settings = Settings(record.flush_period, limits, record.min_free * MB, record.sync_period)
    arguments = Path(record.path), dict(knee.provenance), dict(knee.names), settings, knee.told_as
    gather = min(record.flush_period, GATHER)
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
    settings: Settings,
    told_as: str = PROVENANCE,
) -> Recorder:
    """Open a recording in the process of a sink, under the first of its possible names that is free.

    Its remarks report another name than `path`, and interrupted recordings in the same folder.

    Raises:
        UsageError: The recording cannot be written; see `refuse` and `BagWriter`.
    """
    refuse(path, settings.min_free)
    bag = BagWriter(path, limits=settings.limits, next_free_name=True)
    if bag.path != path:
        bag.remarks.append(f"{path} is there already: this recording is {bag.path}")
    bag.remarks += map(
        output_files.cut_off_message, output_files.unfinished_files(path.parent, ".mcap")
    )
    return Recorder(AnswerWriter(bag, provenance, names, told_as), settings)


def information(
    files: Sequence[tuple[str, Statistics]], topics: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Content of `metadata.yaml` for a bag of these files, by name, with the entries of its topics in their order."""

    def times(files: Iterable[Statistics]) -> dict[str, Any]:
        filled = [file for file in files if file.message_count]
        first = min((file.message_start_time for file in filled), default=0)
        last = max((file.message_end_time for file in filled), default=0)
        return {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": sum(file.message_count for file in filled),
        }

    each = [statistics for _, statistics in files]
    total = sum((Counter(file.channel_message_counts) for file in each), Counter[int]())
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **times(each),
        "topics_with_message_count": [
            {"topic_metadata": topic, "message_count": total[number]}
            for number, topic in enumerate(topics, start=1)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name for name, _ in files],
        "files": [{"path": name, **times([file])} for name, file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def put_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Write `metadata.yaml` with the content that `information` returns; another bag's is left alone.

    Raises:
        OSError: The file cannot be written; an earlier one is unchanged.
    """
    metadata, first = (
        folder / METADATA,
        to_yaml({"": {"relative_file_paths": content["relative_file_paths"][:1]}}),
    )
    try:
        with open_regular(metadata) as file:  # not parsed, which takes as long as writing it
            is_ours = first.encode().partition(b"\n")[2] in file.read(MAX_METADATA_SIZE)
    except OSError:
        is_ours = not os.path.lexists(metadata)
    if not is_ours:
        return
    partial = partial_name(
        metadata.with_name(f"{METADATA}.{os.getpid()}")
    )  # others may write one meanwhile
    output_files.write_new(partial, to_yaml({"rosbag2_bagfile_information": content}).encode())
    partial.replace(metadata)
    sync_folder(folder)


def to_yaml(content: Any) -> str:
    """Content as YAML text, with the keys in the given order."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.representer.ignore_aliases = lambda _: True
    yaml.width = 1000
    text = io.StringIO()
    yaml.dump(content, text)
    return text.getvalue()


def qos_of(type_name: str) -> list[dict[str, Any]]:
    """Offered QoS profiles of a topic by its type; late subscribers also get the description of the leg."""
    is_description = type_name == MESSAGE_TYPES[ROBOT_DESCRIPTION]
    return (
        [OFFERED_QOS[0] | {"depth": 1, "durability": "transient_local"}]
        if is_description
        else OFFERED_QOS
    )


@cache
def offered_qos(type_name: str) -> str:
    """Offered QoS profiles of a topic as YAML text, for the metadata of channels."""
    return to_yaml(qos_of(type_name))
