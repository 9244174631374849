"""An open bag: an `.mcap` file, or a rosbag2 folder with MCAP or sqlite3 files, from any ROS 2 recorder.

A bag is opened once. Opening checks all of it, so that an open bag knows what is in it; damaged or missing parts are
reported (`Bag.damage`), and the rest is read.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import zstandard
from rosbags.interfaces import MessageDefinition

from ..parameters.sources import DYNAMIC_JOINT_STATES
from ..streams.columns import Column
from ..streams.gait_events import AFTER, GaitEvent
from ..streams.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    LOAD_INPUTS,
    NET_LOAD,
    types_in,
    types_of,
    typestore,
)
from ..system.errors import UsageError, join_faults, list_names
from ..system.portable import allow_open_files
from .arrival import by_arrival, in_batches_of
from .bag_file import BagFile, Batch, Channel
from .folder import (
    MCAP,
    NUMBERED,
    ZSTD_MAGIC,
    FolderContent,
    bag_digest,
    decompressed,
    file_number,
    folder_content,
    kind_of,
)
from .mcap_file import McapFile
from .mcap_records import LARGEST_RECORD
from .metadata_file import METADATA
from .names import OWN_NAMES, Names, absolute
from .sqlite_file import SqliteFile

INPUT_TYPES = types_of(INPUTS)
"""Types of the topics that drive the model, by their absolute names"""
OTHER_WAYS = {
    JOINT_STATES: f"-p knee.source:={DYNAMIC_JOINT_STATES} reads those of ros2_control",
    JOINT_REACTION_FORCE: f"knee-contact estimate-load computes it from {GROUND_REACTION_FORCE}",
    GROUND_REACTION_FORCE: f"estimate-load --params load/{NET_LOAD} takes {NET_LOAD}",
}
"""For an input that is missing in a bag, an alternative to another name"""
FIXED_TYPES = ("sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped")
"""Types whose messages are read only by their definition in ROS 2"""
MAX_MESSAGE_SIZE = 2**24
"""Largest size [B] of a message that was compressed by itself"""
ORIGIN = "origin"
"""Name of the metadata record of an imported bag, which describes its origin"""

DOUBTS = "doubts"
"""Entry of that record with what the importer doubted, a sentence a line"""
GAIT_EVENTS = "gait_events"
"""Entry of that record with heel strikes and toe-offs of the leg: stamp [ns] and kind, one a line"""
DOUBTED = "the import doubted: "
"""Beginning of such a sentence, where a bag is computed"""


class RawMessage(NamedTuple):
    """Message of a bag that is not decoded."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    data: bytes
    """CDR bytes"""


class Bag:
    """Open bag: its files, and what is in them."""

    def __init__(self, path: Path) -> None:
        """Open a bag, and check all of its files.

        Raises:
            UsageError: There is no such bag, or nothing of it can be read.
        """
        self.path = path
        self.paths = [path]
        """Paths of the files that belong to the bag, also of missing ones"""
        self.damage: list[str] = []
        """Faults of the bag, as sentences; the readable part is read nevertheless"""
        self.metadata: list[tuple[str, dict[str, str]]] = []
        """Names and contents of the metadata records in the MCAP files"""
        self.message_counts = Counter[Channel]()
        """Number of messages of each channel of all files, also of those without messages"""
        self.is_compressed_by_message = False
        """Whether messages are compressed one by one"""
        self.files: list[BagFile] = []
        """Open files, in the order of recording"""
        try:
            is_there = path.exists()
        except OSError:  # the name is too long
            is_there = False
        if not is_there:
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        with ExitStack() as opened:
            try:
                if path.is_dir():
                    self._open_folder(folder_content(path), opened)
                else:
                    self._open_file(path, opened)
                    self.damage += self.files[0].faults
            except OSError as error:
                raise UsageError(f"cannot read bag {path}: {error.strerror}") from None
            for file in self.files:
                for number, count in file.message_counts.items():
                    self.message_counts[file.channels[number]] += count
            if self.damage and not self.message_counts.total():
                raise UsageError(
                    f"cannot read bag {path}: no message of it can be read; {join_faults(self.damage)}"
                )
            self.close = opened.pop_all().close

    def _open_file(self, path: Path, opened: ExitStack) -> BagFile:
        """Open a file, whose first bytes give its kind, or else its name; `opened` closes it.

        Raises:
            UsageError: It is neither an MCAP nor a sqlite3 file, or a damaged one of these.
            OSError: It cannot be read.
        """
        file: BagFile = McapFile(path) if kind_of(path) == MCAP else SqliteFile(path)
        opened.callback(file.close)
        if isinstance(file, McapFile) and file.unread_bytes > LARGEST_RECORD:
            lost = f"{file.unread_bytes} bytes of it are no valid records"
            raise UsageError(
                f"cannot read bag {path}: {lost}; `knee-contact recover` takes the rest"
            )
        self.files.append(file)
        self.metadata += [(record.name, record.metadata) for record in file.metadata]
        return file

    def _open_folder(self, content: FolderContent, opened: ExitStack) -> None:
        """Open the files of a folder that can be used, and put them in the order of recording."""
        self.paths = [self.path / name for name in content.names]
        self.is_compressed_by_message = content.compression == "message"
        self.damage += content.faults
        allow_open_files(4 * len(self.paths))
        work = Path()
        if content.compression == "file":
            folder = tempfile.TemporaryDirectory(prefix="knee_contact_bag_")
            work = Path(opened.enter_context(folder))
        for path in self.paths:
            try:
                source = decompressed(path, work) if content.compression == "file" else path
                faults = self._open_file(source, opened).faults
            except FileNotFoundError:
                self.damage.append(f"{path.name} is missing")
                continue
            except (OSError, UsageError, zstandard.ZstdError) as error:
                faults = [str(getattr(error, "strerror", None) or error)]
            self.damage += [f"{path.name}: {fault}" for fault in faults]
        names = [file.path.name for file in self.files]
        numbered = [*filter(None, map(NUMBERED.fullmatch, names))]
        first = {*names} - {match[0] for match in numbered}
        if not first or first == {match[1] + match[3] for match in numbered}:
            # In the order of recording, whatever the clock was; our `run.mcap` comes before `run_1.mcap`.
            self.files.sort(key=lambda file: file_number(file.path.name))
        else:
            self.files.sort(
                key=lambda file: min((chunk.times for chunk in file.chunks), default=(0, 0))
            )
        expected = content.message_count
        missing = expected - sum(file.message_counts.total() for file in self.files)
        if missing > 0:
            self.damage.append(f"{missing} of {expected} messages of {METADATA} are missing")

    @property
    def topics(self) -> set[str]:
        """Absolute names of all topics."""
        return {absolute(channel.topic) for channel in self.message_counts}

    def check_content(self) -> None:
        """Refuse a bag without messages.

        Raises:
            UsageError: it has topics, and no message on any of them.
        """
        if self.message_counts and not any(self.message_counts.values()):
            raise UsageError(f"bag {self.path} is empty: nothing came while it was written")

    @property
    def is_recording(self) -> bool:
        """Whether it is a recording of a node of this package, or of `solve` or `estimate-load`."""
        return any(file.is_recording for file in self.files)

    @property
    def origin(self) -> dict[str, str]:
        """What an importer wrote about the bag's origin; empty if it is not imported."""
        return self.first_metadata(ORIGIN) or {}

    @property
    def body_weight(self) -> float | None:
        """Body weight [N] that an importer wrote into the bag; None if it names none."""
        try:
            return float(self.origin.get("body_weight", "").removesuffix("N")) or None
        except ValueError:
            return None

    @property
    def doubts(self) -> list[str]:
        """What an importer doubted, as sentences; also in what was computed from its bag."""
        doubts = self.origin.get(DOUBTS, "").splitlines()
        return [doubt if doubt.startswith(DOUBTED) else DOUBTED + doubt for doubt in doubts]

    @property
    def gait_events(self) -> list[GaitEvent]:
        """Heel strikes and toe-offs that an importer read, in order; also in what was computed from its bag."""
        events = []
        for line in self.origin.get(GAIT_EVENTS, "").splitlines():
            stamp, _, kind = line.partition(" ")
            if stamp.isdecimal() and kind in AFTER:
                events.append(GaitEvent(int(stamp), kind, f"{kind}, as imported"))
        return sorted(events)

    def first_metadata(self, name: str) -> dict[str, str] | None:
        """Return the content of the first metadata record of a name; None if there is none."""
        return next((content for own, content in self.metadata if own == name), None)

    @property
    def end(self) -> int:
        """Log time [ns] after the last message of the bag, on any topic; 0 without messages."""
        ends = (chunk.times[1] for file in self.files for chunk in file.chunks)
        return 1 + max(ends, default=-1)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the file, or of the files of the bag in a folder."""
        return bag_digest(self.path, self.paths)

    def select(
        self,
        types: Mapping[str, str] = INPUT_TYPES,
        names: Names = OWN_NAMES,
        may_be_empty: str = "",
    ) -> TopicReader:
        """Find requested topics.

        Args:
            types: Type of each requested topic, by the absolute name in the node.
            names: Absolute names in the bag of topics that have another one there.
            may_be_empty: Topic that needs no messages.

        Raises:
            UsageError: A topic is missing, empty or of another type.
        """
        try:
            requested = {
                topic: self._channels_of(
                    topic, type_name, names.get(topic, topic), topic == may_be_empty
                )
                for topic, type_name in types.items()
            }
        except UsageError as error:
            damage = f"; the bag is damaged: {join_faults(self.damage)}" if self.damage else ""
            raise UsageError(f"{error}{damage}") from None
        reader = TopicReader(self, requested)
        first = next(reader.raw_messages(), None) if self.path.is_file() else None
        if first and first.data.startswith(
            ZSTD_MAGIC
        ):  # only `metadata.yaml` in its folder says so
            raise UsageError(
                f"bag {self.path} has compressed messages: give its folder, whose metadata.yaml says so"
            )
        return reader

    def _channels_of(
        self, topic: str, type_name: str, name: str, may_be_empty: bool
    ) -> list[Channel]:
        """Return the channels of a topic, whose absolute names are `topic` in the node and `name` in the bag.

        Raises:
            UsageError: The topic is missing or empty, has another type or several, or is not encoded as CDR.
        """
        where = f"bag {self.path}: topic {name}"
        is_it = fnmatchcase if "*" in name else str.__eq__
        named = [each for each in self.message_counts if is_it(absolute(each.topic), name)]
        if not named:
            raise UsageError(
                f"bag {self.path} has no topic {name} ({type_name}); {_advice(self.topics, topic)}"
            )
        filled = [channel for channel in named if self.message_counts[channel]]
        types = sorted({channel.type for channel in filled or named})
        if len(types) > 1:
            raise UsageError(
                f"{where} has {len(types)} types, {' and '.join(types)}; it must be a {type_name}"
            )
        if types != [type_name]:
            raise UsageError(f"{where} is a {types[0]}; it must be a {type_name}")
        if not filled and not may_be_empty:
            self.check_content()
            raise UsageError(f"{where} has no messages")
        for channel in filled:
            if channel.encoding != "cdr":
                raise UsageError(
                    f"{where} is encoded as {channel.encoding or 'nothing'}; it must be cdr"
                )
            if type_name in FIXED_TYPES and (
                difference := _difference(channel.definition, type_name)
            ):
                raise UsageError(
                    f"{where}: the bag defines {type_name} differently from ROS 2: {difference}; "
                    "name the field to read, as in knee.source or load.source"
                )
        return filled

    def __str__(self) -> str:
        """Path of the bag, for sentences."""
        return str(self.path)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def opened_bag(bag: Path | Bag) -> AbstractContextManager[Bag]:
    """Open a bag that is given by its path; one that is open already stays open."""
    return nullcontext(bag) if isinstance(bag, Bag) else Bag(bag)


class TopicReader:
    """Reader of requested topics of an open bag."""

    def __init__(self, bag: Bag, requested: dict[str, list[Channel]]) -> None:
        self.bag = bag
        self.requested = requested
        """Channels of each topic, by its absolute name in the node"""

    @property
    def message_count(self) -> int:
        """Number of messages on all requested topics."""
        return sum(map(self.count_messages, self.requested))

    def count_messages(self, topic: str) -> int:
        """Return the number of messages on a requested topic."""
        return sum(self.bag.message_counts[channel] for channel in self.requested[topic])

    def channel_ids(self, topic: str) -> list[int]:
        """Return the ids of the channels that give a requested topic, in the file that has most of them."""
        wanted = {channel[:3] for channel in self.requested[topic]}
        each = (
            [
                n
                for n, count in file.message_counts.items()
                if count and file.channels[n][:3] in wanted
            ]
            for file in self.bag.files
        )
        return max(each, key=len)

    def definition_of(self, topic: str) -> MessageDefinition:
        """Return the definition of the type of a requested topic in the bag."""
        return self.requested[topic][0].definition

    def raw_messages(
        self, start: int | None = None, stop: int | None = None
    ) -> Iterator[RawMessage]:
        """Yield messages in the order of arrival (`by_arrival`), not decoded.

        Args:
            start: Smallest log time [ns]; None means no limit.
            stop: Log time [ns] before which messages must lie; None means no limit.

        Raises:
            UsageError: The bag is damaged.
        """
        names = list(self.requested)
        for batch in self._batches():
            for number, log_time, data in batch:
                if (start is None or log_time >= start) and (stop is None or log_time < stop):
                    yield RawMessage(names[number], log_time, data)

    def batches_of(self, size: int, topics: Collection[str] = ()) -> Iterator[Batch]:
        """Yield messages in the order of arrival, in batches of at most `size`; of our own recordings, in their order.

        The number of a message in a batch is the index of its topic among all requested ones.

        Args:
            size: Largest number of messages in a batch.
            topics: Topics to read, out of the requested ones; all of them if empty.

        Raises:
            UsageError: The bag is damaged.
        """
        return in_batches_of(size, self._batches(topics, of_ticks=True))

    def _batches(self, topics: Collection[str] = (), of_ticks: bool = False) -> Iterator[Batch]:
        wanted = {
            channel: index
            for index, (topic, channels) in enumerate(self.requested.items())
            for channel in channels
            if topic in topics or not topics
        }
        numbers = [
            {n: wanted[channel] for n, channel in file.channels.items() if channel in wanted}
            for file in self.bag.files
        ]
        try:
            for batch in by_arrival(self.bag.files, numbers, of_ticks):
                if self.bag.is_compressed_by_message:
                    messages = [_decompressed_message(data) for data in batch.messages]
                    yield replace(batch, messages=Column.of(messages))
                else:
                    yield batch
        except Exception as error:  # whatever a broken file provokes in the reader
            raise damaged(self.bag.path, error) from None


def damaged(path: Path, error: Exception) -> UsageError:
    """Return the error that reading a bag caused another error."""
    return UsageError(f"bag {path} is damaged: {' '.join(str(error).split())}")


@lru_cache(maxsize=16)
def _difference(definition: MessageDefinition, type_name: str) -> str:
    """Return the first difference between a type's definitions in a bag and in ROS 2; empty without one."""
    known = typestore().fielddefs
    with suppress(Exception):  # whatever a text that is no definition provokes
        types = types_in(definition, type_name)
        for name in types.keys() & known.keys():
            for theirs, own in zip_longest(types[name][1], known[name][1]):
                if theirs != own:
                    there, expected = (field[0] if field else "nothing" for field in (theirs, own))
                    return f"{name} has {there} where {expected} should be"
    return ""


def _advice(topics: Iterable[str], topic: str) -> str:
    """Return the topics of a bag that lacks an input, and how to read another one instead."""
    own = topic.removeprefix("/")
    sentences = [f"its topics: {list_names(sorted(topics)) or 'none'}"]
    if own in (*INPUTS, *LOAD_INPUTS):
        sentences.append(f"--remap {own}:=TOPIC or --namespace NAME reads another one")
    if own in OTHER_WAYS:
        sentences.append(OTHER_WAYS[own])
    return "; ".join(sentences)


def _decompressed_message(data: bytes) -> bytes:
    """Decompress a message that was compressed by itself.

    Raises:
        ValueError: It is too large according to its frame.
        zstandard.ZstdError: It cannot be decompressed.
    """
    size = zstandard.frame_content_size(data)
    if size > MAX_MESSAGE_SIZE:
        raise ValueError(
            f"a message claims to have {size} bytes; at most {MAX_MESSAGE_SIZE} are read"
        )
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=MAX_MESSAGE_SIZE)
