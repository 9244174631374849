"""Reading of a bag: an `.mcap` file, or a rosbag2 folder with MCAP or sqlite3 files, from any ROS 2 recorder.

Topics may have other names in a bag than in the node. Damaged or missing parts are reported (`BagReader.damage`), and
the rest is read. Files of a folder are found even if its `metadata.yaml` is missing or wrong.
"""

from __future__ import annotations

import os
import re
import sqlite3
import tempfile
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import pairwise, zip_longest
from pathlib import Path
from resource import RLIMIT_NOFILE, getrlimit, setrlimit
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np
import zstandard
from rosbags.interfaces import MessageDefinition

from knee_contact_ros.bags.columns import Batch, Connection, File, Segment, blocks, by_arrival
from knee_contact_ros.bags.mcap_file import (
    ALLOWED_SIZE,
    BLOCK,
    MOST_GROWTH,
    McapFile,
    definition_of,
)
from knee_contact_ros.bags.recorder import MAGIC, METADATA
from knee_contact_ros.model.types import Rows
from knee_contact_ros.parameters.sources import DYNAMIC_JOINT_STATES
from knee_contact_ros.streams.columns import Column, decode_answers
from knee_contact_ros.streams.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    LOAD_INPUTS,
    MESSAGE_TYPES,
    NO_DEFINITION,
    deserialize,
    types_in,
    typestore,
)
from knee_contact_ros.system.errors import UsageError, join_faults, list_names
from knee_contact_ros.system.files import (
    MAX_METADATA_SIZE,
    BadYamlError,
    is_file,
    open_regular,
    read_yaml,
    split_rule,
)
from knee_contact_ros.system.progress import OnProgress, no_progress

Names = Mapping[str, str]
"""Absolute names of topics in a bag, by their absolute names in the node"""
OWN_NAMES: Names = MappingProxyType({})
"""Names for a bag in which each topic has its name in the node"""
NAMESPACE = ""
"""Key in `Names` of the namespace of relative names"""
INPUT_TYPES = {f"/{topic}": MESSAGE_TYPES[topic] for topic in INPUTS}
"""Types of the topics that drive the model, by their absolute names"""
OTHER_WAYS = {
    JOINT_STATES: f"-p knee.source:={DYNAMIC_JOINT_STATES} reads those of ros2_control",
    JOINT_REACTION_FORCE: f"knee-contact estimate-load computes it from {GROUND_REACTION_FORCE}",
}
"""For an input that is missing in a bag, an alternative to another name"""
MCAP, SQLITE, ZSTD = ".mcap", ".db3", b"\x28\xb5\x2f\xfd"
"""Suffixes of the files of a bag; first bytes of zstd data, which no CDR message begins with"""
MAGICS = {MCAP: MAGIC, SQLITE: b"SQLite format 3\x00"}
"""First bytes of the files of a bag"""
FIXED_TYPES = ("sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped")
"""Types whose messages are read only by their definition in ROS 2"""
PACKED = (ZSTD, b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"PK\x03\x04", b"\x04\x22\x4d\x18")
"""First bytes of files that are compressed as a whole: zstd, gzip, bzip2, xz, zip and lz4"""
FOREIGN = {
    b"#ROSBAG V": "is a bag of ROS 1: convert it, for example with `rosbags-convert --src FILE --dst FOLDER`",
    b"version https://git-lfs": "is a pointer of Git LFS and not the file itself: fetch it with `git lfs pull`",
    **dict.fromkeys(PACKED, "is compressed: give the folder of the bag, or unpack the file first"),
}
"""Kinds of files that are not bags, by their first bytes"""
NUMBERED = re.compile(r"(.+)_(\d+)(\.mcap|\.db3)")
"""Name of a numbered file in a rosbag2 folder: stem, number and suffix"""
LARGEST_MESSAGE = 2**24
"""Largest size [B] of a message that was compressed by itself"""
AT_ONCE = 1024
"""Number of rows of a sqlite3 file that are read at a time"""
DECODED = 8192
"""Largest number of answers that are decoded at a time"""
ROWS = "FROM messages WHERE typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob'"
"""Rows of a sqlite3 file that are messages"""
DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"


class BagMessage(NamedTuple):
    """Decoded message of a bag."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    message: Any
    """Message as `rosbags` deserializes it"""


class RawMessage(NamedTuple):
    """Message of a bag that is not decoded."""

    topic: str
    """Absolute name of the topic in the node"""
    log_time: int
    """Log time [ns]"""
    data: bytes
    """CDR bytes"""


class BagReader:
    """Open bag that contains all requested topics."""

    def __init__(
        self, path: Path, types: Mapping[str, str] = INPUT_TYPES, names: Names = OWN_NAMES
    ) -> None:
        """Open a bag and find the requested topics in it.

        Args:
            path: Bag.
            types: Type of each requested topic, by the absolute name in the node.
            names: Absolute names in the bag of topics that have another one there.

        Raises:
            UsageError: There is no such bag, it cannot be read, or a topic is missing, empty or of another type.
        """
        self.path = path
        self.damage: list[str]
        """Faults of the bag, as sentences; the readable part is read nevertheless"""
        if not path.exists():
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        with ExitStack() as opened:
            try:
                self._files, self.damage, self._packed = _opened_files(path, opened)
            except OSError as error:
                raise UsageError(f"cannot read bag {path}: {error.strerror}") from None
            self.connections = Counter[Connection]()
            """Number of messages of each connection of all files, also of those without messages"""
            for file in self._files:
                for number, count in file.counts.items():
                    self.connections[file.connections[number]] += count
            if self.damage and not self.connections.total():
                raise UsageError(
                    f"cannot read bag {path}: no message of it can be read; {join_faults(self.damage)}"
                )
            try:
                self.requested = {
                    topic: self._found(topic, type_name, names.get(topic, topic))
                    for topic, type_name in types.items()
                }
                """Connections of each requested topic"""
            except UsageError as error:
                damage = f"; the bag is damaged: {join_faults(self.damage)}" if self.damage else ""
                raise UsageError(f"{error}{damage}") from None
            first = next(self.raw_messages(), None) if path.is_file() else None
            if first and first.data.startswith(ZSTD):  # only `metadata.yaml` in its folder says so
                raise UsageError(
                    f"bag {path} has compressed messages: give its folder, whose metadata.yaml says so"
                )
            self.close = opened.pop_all().close

    @property
    def count(self) -> int:
        """Number of messages on the requested topics."""
        return sum(map(self.count_of, self.requested))

    def count_of(self, topic: str) -> int:
        """Number of messages on a requested topic."""
        return sum(self.connections[connection] for connection in self.requested[topic])

    def channels(self, topic: str) -> list[int]:
        """Numbers of the channels that give a requested topic, in the file that has most of them."""
        wanted = {connection[:3] for connection in self.requested[topic]}
        each = (
            [n for n, count in f.counts.items() if count and f.connections[n][:3] in wanted]
            for f in self._files
        )
        return max(each, key=len)

    @property
    def end(self) -> int:
        """Log time [ns] after the last message of the bag, on any topic; 0 without messages."""
        return 1 + max(
            (segment.times[1] for file in self._files for segment in file.segments), default=-1
        )

    def raw_messages(
        self, start: int | None = None, stop: int | None = None
    ) -> Iterator[RawMessage]:
        """Messages in the order of arrival (`by_arrival`), not decoded.

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

    def blocks(self, topics: Collection[str] = (), *, most: int) -> Iterator[Batch]:
        """Messages in the order of arrival, in blocks of at most `most` messages.

        The number of a message in a block is the index of its topic among all requested ones.

        Args:
            topics: Topics to read, out of the requested ones; all of them if empty.
            most: Largest number of messages in a block.

        Raises:
            UsageError: The bag is damaged.
        """
        return blocks(self._batches(topics), most)

    def definition(self, topic: str) -> MessageDefinition:
        """Definition of the type of a requested topic in the bag."""
        return self.requested[topic][0].definition

    def _found(self, topic: str, type_name: str, name: str) -> list[Connection]:
        """Connections of a topic, whose absolute names are `topic` in the node and `name` in the bag.

        Recorders with several publishers, and merged files, may have several.

        Raises:
            UsageError: The topic is missing or empty, has another type or several, or is not encoded as CDR.
        """
        is_it = fnmatchcase if "*" in name else str.__eq__
        of_name = [
            connection
            for connection in self.connections
            if is_it(absolute(connection.topic), name)
        ]
        if not of_name:
            raise UsageError(
                f"bag {self.path} has no topic {name} ({type_name}); {_advice(self.connections, topic)}"
            )
        filled = [connection for connection in of_name if self.connections[connection]]
        types = sorted({connection.type for connection in filled or of_name})
        if types != [type_name]:
            fault = (
                f"is a {types[0]}"
                if len(types) == 1
                else f"has {len(types)} types, {' and '.join(types)}"
            )
            raise UsageError(f"bag {self.path}: topic {name} {fault}; it must be a {type_name}")
        if not filled:
            raise UsageError(f"bag {self.path}: topic {name} has no messages")
        for encoding in (
            connection.encoding for connection in filled if connection.encoding != "cdr"
        ):
            raise UsageError(
                f"bag {self.path}: topic {name} is encoded as {encoding or 'nothing'}; it must be cdr"
            )
        for connection in filled if type_name in FIXED_TYPES else ():
            if difference := _difference(connection.definition, type_name):
                raise UsageError(
                    f"bag {self.path}: topic {name}: the bag defines {type_name} differently from ROS 2: "
                    f"{difference}; name the field to read, as in knee.source or load.source"
                )
        return filled

    def _batches(self, topics: Collection[str] = ()) -> Iterator[Batch]:
        wanted = {
            each: index
            for index, (topic, found) in enumerate(self.requested.items())
            for each in found
            if topic in topics or not topics
        }
        numbers = [
            {n: wanted[each] for n, each in f.connections.items() if each in wanted}
            for f in self._files
        ]
        try:
            for batch in by_arrival(self._files, numbers):
                yield (
                    replace(batch, messages=Column.of([*map(_unpacked, batch.messages)]))
                    if self._packed
                    else batch
                )
        except Exception as error:  # whatever a broken file provokes in the reader
            raise UsageError(
                f"bag {self.path} is damaged: {' '.join(str(error).split())}"
            ) from None

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def read_bag(path: Path, types: Mapping[str, str]) -> list[BagMessage]:
    """All messages of the topics with these types, decoded by the definitions in this package; for short bags.

    Raises:
        UsageError: The bag cannot be read, or a message cannot be decoded.
    """
    with BagReader(path, types) as bag:
        try:
            return [
                BagMessage(topic, time, deserialize(data, topic[1:]))
                for topic, time, data in bag.raw_messages()
            ]
        except Exception as error:  # whatever broken bytes provoke in the decoder
            raise UsageError(f"bag {path} is damaged: {' '.join(str(error).split())}") from None


def answer_topics(path: Path) -> list[str]:
    """Absolute names of the topics with answers in a bag, in alphabetical order.

    Raises:
        UsageError: There is no such bag, or nothing of it can be read.
    """
    with BagReader(path, {}) as bag:
        filled = [connection for connection, count in bag.connections.items() if count]
    return sorted(
        {absolute(each.topic) for each in filled if each.type == MESSAGE_TYPES[KNEE_CONTACT]}
    )


def answer_blocks(
    path: Path, topic: str = f"/{KNEE_CONTACT}", advance: OnProgress = no_progress
) -> Iterator[Rows]:
    """Answers of a recording in blocks, in the order of log time.

    Args:
        path: Recording.
        topic: Absolute name of the topic.
        advance: Function that is called after each block with the numbers of answers read so far and in all.

    Raises:
        UsageError: There is no such recording or topic, it is damaged, or a message cannot be decoded.
    """
    with BagReader(path, {topic: MESSAGE_TYPES[KNEE_CONTACT]}) as reader:
        if reader.damage:
            raise UsageError(
                f"{path} is damaged ({join_faults(reader.damage)}): repair it with knee-contact recover"
            )
        first, *others = {connection.definition for connection in reader.requested[topic]}
        if others:
            raise UsageError(
                f"{path}: {topic} has several definitions of its messages: give its recordings one by one"
            )
        done = 0
        for block in reader.blocks(most=DECODED):
            try:
                answers = decode_answers(block.messages, first)
            except Exception as error:  # whatever broken bytes and definitions provoke
                raise UsageError(
                    f"{path}: an answer cannot be decoded: {' '.join(str(error).split())}"
                ) from None
            yield answers
            done += len(answers)
            advance(done, reader.count)


def read_answers(path: Path, topic: str = f"/{KNEE_CONTACT}") -> Rows:
    """All answers of a recording in one array; see `answer_blocks`."""
    return np.concatenate(list(answer_blocks(path, topic)))


def absolute(name: str, namespace: str = "") -> str:
    """Absolute name of a topic in a namespace; some recorders omit the first slash of an absolute name."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")


def names_in_bag(
    remaps: Iterable[str] = (), namespace: str = "", inputs: Sequence[str] = INPUTS
) -> Names:
    """Names in a bag according to the options `--remap FROM:=TO` and `--namespace`.

    Args:
        remaps: Rules `FROM:=TO`; FROM is the name of an input in the node, TO its name in the bag.
        namespace: Namespace of relative names in the bag.
        inputs: Relative names of the inputs in the node.

    Raises:
        UsageError: A rule is malformed, its FROM is not an input or is repeated, or two inputs get the same name.
    """
    if namespace and not namespace.strip("/"):
        raise UsageError(f"--namespace {namespace!r}: it must be a name, such as left")
    names = {f"/{topic}": absolute(topic, namespace) for topic in (*inputs, DYNAMIC_JOINT_STATES)}
    if namespace:
        names[NAMESPACE] = namespace
    remapped = set()
    for rule in remaps:
        source, target = split_rule(rule, "--remap")
        topic, allowed = absolute(source), " or ".join(inputs)
        if topic not in names:
            raise UsageError(
                f"--remap {rule!r}: FROM must be {allowed}, the input; TO is its name in the bag"
            )
        if topic in remapped:
            raise UsageError(f"--remap {rule!r}: {source} is remapped twice")
        remapped.add(topic)
        names[topic] = absolute(target, namespace)
    if len(set(names.values())) < len(names):
        raise UsageError(f"--remap: two inputs cannot both be {names[topic]}")
    return names


@lru_cache(maxsize=16)
def _difference(definition: MessageDefinition, type_name: str) -> str:
    """First difference between a type's definition in a bag and in ROS 2; empty if there is none, or no definition."""
    known = typestore().fielddefs
    with suppress(Exception):  # whatever a text that is no definition provokes
        types = types_in(definition, type_name)
        for name in types.keys() & known.keys():
            for theirs, own in zip_longest(types[name][1], known[name][1]):
                if theirs != own:
                    there, expected = (field[0] if field else "nothing" for field in (theirs, own))
                    return f"{name} has {there} where {expected} should be"
    return ""


def _advice(connections: Iterable[Connection], topic: str) -> str:
    """Topics of a bag that lacks an input, and how to read another one instead."""
    own, names = (
        topic.removeprefix("/"),
        sorted({absolute(connection.topic) for connection in connections}),
    )
    ways = (
        [f"--remap {own}:=TOPIC or --namespace NAME reads another one"]
        if own in (*INPUTS, *LOAD_INPUTS)
        else []
    )
    ways += [OTHER_WAYS[own]] if own in OTHER_WAYS else []
    return "; ".join([f"its topics: {list_names(names) or 'none'}", *ways])


def _unpacked(data: bytes) -> bytes:
    """Message that was compressed by itself, decompressed.

    Raises:
        ValueError: It is too large according to its frame.
        zstandard.ZstdError: It cannot be decompressed.
    """
    size = zstandard.frame_content_size(data)
    if size > LARGEST_MESSAGE:
        raise ValueError(
            f"a message claims to have {size} bytes; at most {LARGEST_MESSAGE} are read"
        )
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=LARGEST_MESSAGE)


class Contents(NamedTuple):
    """Files of a bag, by its `metadata.yaml` or else by their names."""

    names: list[str]
    """Names of the files"""
    faults: list[str]
    """Faults of the folder, as sentences"""
    compression: str = ""
    """Compression mode: `file`, `message` or empty"""
    messages: int = 0
    """Number of messages"""


def contents_of(folder: Path) -> Contents:
    """Files of the bag in a folder.

    Without a usable `metadata.yaml` these are the only file, or the numbered ones of one name.

    Raises:
        UsageError: It is unclear which files belong to the bag, or there are none.
    """
    contents = Contents([], [])
    try:
        content = read_yaml(folder / METADATA, MAX_METADATA_SIZE)["rosbag2_bagfile_information"]
        names = list(dict.fromkeys(Path(name).name for name in content["relative_file_paths"]))
        mode = str(content.get("compression_mode") or "").lower().replace("none", "")
        contents = Contents(names, [], mode, int(content.get("message_count") or 0))
    except FileNotFoundError:
        contents.faults.append(f"{METADATA} is missing")
    except (
        OSError,
        BadYamlError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
    ):
        contents.faults.append(f"{METADATA} cannot be read")
    if any(is_file(folder / name) for name in contents.names):
        return contents
    names = sorted(path.name for path in folder.iterdir() if path.suffix in MAGICS)
    if not names:
        raise UsageError(
            f"{folder} is not a rosbag2 folder: it has no usable {METADATA}, and no files"
        )
    numbered = [match for match in map(NUMBERED.fullmatch, names) if match]
    if len(names) > 1 and (
        len(numbered) < len(names) or len({match[1] + match[3] for match in numbered}) > 1
    ):
        raise UsageError(
            f"{folder} has more than one recording, and no usable {METADATA} that names one; "
            f"give one of these files: {list_names(names)}"
        )
    faults = [*contents.faults, *(f"{name} is missing" for name in contents.names)]
    mode = contents.compression.replace("file", "")  # somebody has unpacked these
    return Contents(sorted(names, key=_number), faults, mode, contents.messages)


def files_of(bag: Path) -> list[Path]:
    """Paths of the files of a bag: the bag itself if it is a file, or those in its folder that belong to it.

    Raises:
        UsageError: It is not clear which files belong to the bag.
    """
    return [bag / name for name in contents_of(bag).names] if bag.is_dir() else [bag]


def _opened_files(path: Path, opened: ExitStack) -> tuple[list[File], list[str], bool]:
    """Open all files of a bag; `opened` closes them.

    Returns:
        The files, the faults of the bag, and whether its messages are compressed one by one.

    Raises:
        UsageError: It is not clear which files belong to the bag, or the only file cannot be used.
        OSError: The only file cannot be read.
    """
    if not path.is_dir():
        file = _opened_file(path, opened)
        return [file], list(file.faults), False
    soft, hard = getrlimit(RLIMIT_NOFILE)  # the usual one is 1024
    if 2 * sum(1 for _ in path.iterdir()) > soft // 2 and soft != hard:
        setrlimit(RLIMIT_NOFILE, (hard, hard))
    contents, files, unpacked = contents_of(path), list[File](), Path()
    faults = contents.faults
    if contents.compression == "file":
        unpacked = Path(
            opened.enter_context(tempfile.TemporaryDirectory(prefix="knee_contact_bag_"))
        )
    for name in contents.names:
        try:
            source = (
                _decompressed(path / name, unpacked)
                if contents.compression == "file"
                else path / name
            )
            files.append(_opened_file(source, opened))
            faults += [f"{name}: {fault}" for fault in files[-1].faults]
        except FileNotFoundError:
            faults.append(f"{name} is missing")
        except (OSError, UsageError, zstandard.ZstdError) as error:
            faults.append(f"{name}: {getattr(error, 'strerror', None) or error}")
    if all(
        NUMBERED.fullmatch(file.path.name) for file in files
    ):  # in the order of recording, whatever the clock was
        files.sort(key=lambda file: _number(file.path.name))
    else:
        files.sort(
            key=lambda file: min((segment.times for segment in file.segments), default=(0, 0))
        )
    missing = contents.messages - sum(file.counts.total() for file in files)
    faults += [f"{missing} of {contents.messages} messages of {METADATA} are missing"] * (
        missing > 0
    )
    return files, faults, contents.compression == "message"


def _opened_file(path: Path, opened: ExitStack) -> File:
    """Open a file; its first bytes give its kind, or else its name; see `kind_of`."""
    file: File = McapFile(path) if kind_of(path) == MCAP else SqliteFile(path)
    opened.callback(file.close)
    return file


def kind_of(path: Path) -> str:
    """Kind of a file of a bag, `MCAP` or `SQLITE`, by its first bytes or else its name.

    Raises:
        UsageError: It is neither of the two.
        OSError: It cannot be read.
    """
    with open_regular(path) as file:
        begin = file.read(max(map(len, FOREIGN)))
    if words := next(
        (words for foreign, words in FOREIGN.items() if begin.startswith(foreign)), ""
    ):
        raise UsageError(f"cannot read bag {path}: it {words}")
    kinds = [suffix for suffix in path.suffixes if suffix in MAGICS]
    kinds += [kind for kind, magic in MAGICS.items() if begin.startswith(magic)]
    if not kinds:
        raise UsageError(f"cannot read bag {path}: it is neither an MCAP nor a sqlite3 file")
    return kinds[-1]


def _decompressed(packed: Path, folder: Path) -> Path:
    """Unpack a file that rosbag2 has compressed as a whole into `folder`; path of the unpacked file.

    Raises:
        OSError: The file is missing, or grows too much.
        zstandard.ZstdError: It cannot be decompressed.
    """
    path, most = (
        folder / packed.name.removesuffix(".zstd"),
        max(MOST_GROWTH * packed.stat().st_size, ALLOWED_SIZE),
    )
    with open_regular(packed) as file, path.open("wb") as unpacked:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while data := reader.read(BLOCK):
            unpacked.write(data)
            if unpacked.tell() > most:
                raise OSError(f"it holds more than {MOST_GROWTH} times its size")
    return path


def _number(name: str) -> int:
    """Number of a numbered name; 0 for another name."""
    match = NUMBERED.fullmatch(name)
    return int(match[2]) if match else 0


def others_beside(bag: Path) -> list[str]:
    """Sentence that the folder of a bag has other recordings, which are not read; an empty list if it has none."""
    if not bag.is_dir():
        return []
    read = {path.name.removesuffix(".zstd") for path in files_of(bag)}
    others = sorted(
        path.name for path in bag.iterdir() if path.suffix in MAGICS and path.name not in read
    )
    if not others:
        return []
    return [
        f"{bag}: only {list_names(sorted(read))} is read; to read {list_names(others)}, give it as a file"
    ]


class SqliteFile(File):
    """Messages of a sqlite3 file of a rosbag2 recording, and its faults; the format has no checksums."""

    def __init__(self, path: Path) -> None:
        """Open the file and check all of it.

        Raises:
            UsageError: The file is damaged, or not a bag.
        """
        super().__init__(path)
        log = path.with_name(f"{path.name}-wal")
        if log.exists() and log.stat().st_size:
            self.faults.append(
                f"{log.name} holds messages that were never merged: open the bag once with sqlite3"
            )
        address = f"file:{quote(os.fsencode(path.absolute()))}?mode=ro&immutable=1"
        self._database = sqlite3.connect(address, uri=True)
        self.close = self._database.close
        try:
            self._read()
        except (sqlite3.Error, ValueError, TypeError, OverflowError) as error:
            self.close()
            reason = " ".join(str(error).split())[:120]
            advice = (
                "; ".join(self.faults)
                or "try to get its messages into another one with sqlite3's own `.recover`"
            )
            raise UsageError(
                f"{path} is not a sqlite3 bag, or it is damaged ({reason}): {advice}"
            ) from None

    def read(self, segment: Segment, numbers: Mapping[int, int]) -> Batch:
        """Messages of a segment; see `File.read`."""
        query = f"SELECT topic_id, timestamp, data {ROWS} AND id BETWEEN ? AND ? ORDER BY id"
        rows = self._database.execute(query, (segment.begin, segment.end))
        selected = [(numbers[topic], time, data) for topic, time, data in rows if topic in numbers]
        topics, times, messages = zip(*selected, strict=True) if selected else ((), (), ())
        log_times = np.array(times, np.int64 if min(times, default=0) < 0 else np.uint64)
        return Batch(np.array(topics, np.intp), log_times, Column.of(messages))

    def _read(self) -> None:
        """Check the file, and read its topics, definitions and numbers of messages."""

        def one(question: str) -> Any:
            return self._database.execute(question).fetchone()[0]

        query = self._database.execute
        if (integrity := one("PRAGMA integrity_check(1)")) != "ok":
            raise ValueError(integrity)
        if one("PRAGMA page_count") * one("PRAGMA page_size") > self.path.stat().st_size:
            raise ValueError(
                "it is cut off"
            )  # sqlite takes what is missing of the last page for zeros
        kinds = dict(query("SELECT name, type FROM sqlite_master").fetchall())
        if any(
            kinds.get(name, "table") != "table"
            for name in ("topics", "messages", "message_definitions")
        ):
            raise ValueError(
                "its messages or topics cannot be read as a table"
            )  # a view may take forever to read
        found = query(DEFINITIONS) if "message_definitions" in kinds else ()
        definitions = {
            str(name): definition_of(str(encoding), str(text).encode())
            for name, encoding, text in found
        }
        rows, last = query(f"SELECT id, topic_id, timestamp {ROWS} ORDER BY id"), 0
        while part := rows.fetchmany(AT_ONCE):
            ids, topics, times = zip(*part, strict=True)
            span = min(times), max(times)
            self.segments.append(
                Segment(ids[0], ids[-1], ids[0], 0, times=span, counts=Counter(topics))
            )
            self.goes_back |= any(later < earlier for earlier, later in pairwise((last, *times)))
            last = times[-1]
        for number, *texts in query("SELECT id, name, type, serialization_format FROM topics"):
            topic, kind, encoding = map(str, texts)
            definition = definitions.get(kind, NO_DEFINITION)
            self.connections[int(number)] = Connection(topic, kind, encoding, definition)
        every, usable = one("SELECT count(*) FROM messages"), self.note_undeclared()
        self.faults += [f"{every - usable} rows are no messages"] * (every > usable)
