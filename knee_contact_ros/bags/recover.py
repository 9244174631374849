"""`knee-contact recover`: all that can be read of an MCAP file into a new, whole one."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from knee_contact_ros.bags.bag_files import in_a_line, open_file
from knee_contact_ros.bags.chunked_mcap import CHUNK_SIZE
from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.mcap_writer import LIBRARY
from knee_contact_ros.bags.metadata import METADATA, FileFacts, prepare_metadata, to_yaml, with_topics
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import is_being_written, rename_new
from knee_contact_ros.system.yaml_file import BadYamlError, parse_yaml

ROSBAG2 = "rosbag2"
"""Name of the metadata record in which rosbag2 keeps what its `metadata.yaml` says"""
MOST_TOPICS = 2000
"""That others read of a `metadata.yaml`"""
RECOVERED = "recovered"
"""Name of the metadata record that says from what a file was recovered"""
SUFFIX = ".recovering"
"""Of the output until it is complete; `.partial` may be the input's"""
COMPRESSIONS = {None: CompressionType.ZSTD, "": CompressionType.NONE, "lz4": CompressionType.LZ4}
"""By their names in a chunk; None: no chunks"""
MOST_FAULTS = 1000
"""That are written into the metadata record"""


class TopicCount(NamedTuple):
    """What was recovered of a topic."""

    topic: str
    type: str
    messages: int
    missing: int | None
    """None if nothing says how many there were"""


class Recovery(NamedTuple):
    """What was recovered."""

    topics: list[TopicCount]
    times: tuple[int, int] | None
    """First and last log time [ns]"""
    size: int
    """Of the input [B]"""
    unread: int
    """Bytes that are of no use"""
    faults: list[str]
    """What is wrong with the input, as sentences"""


def recover(
    source: Path,
    output: Path,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    overwrite: bool = False,
) -> Recovery:
    """Write all that can be read of `source` to `output`; `advance` hears of it.

    The bytes of the messages, their times and sequence numbers, schemas, channels, metadata and attachments stay as
    they are; the order in the file too. `source` is only read. With `overwrite`, an existing output is replaced once
    the new one is complete.

    Raises:
        UsageError: the output cannot be used, or no message can be read. `output` is then as it was.
        OSError: reading or writing failed; likewise.
    """
    _check(source, output, overwrite)
    found = _opened(source, lambda done, total: advance(done, 2 * total))
    try:
        if not found.counts.total():
            what = "no MCAP file" if not found.streams else "an MCAP file of which no message can be read"
            raise UsageError(f"{source} is {what}: {in_a_line(found.faults) or 'it has none'}")
        result = Recovery(_topics(found), found.times, found.size, found.unread, found.faults)
        partial = _claim(output)
        try:
            _write(partial, output.name, found, lambda done: advance(found.size + done, 2 * found.size))
            describe = _prepared(output, found)
            _put(partial, output, overwrite)
        finally:
            partial.unlink(missing_ok=True)
        describe()
        return result
    finally:
        found.close()


def _check(source: Path, output: Path, overwrite: bool) -> None:
    if not source.is_file():
        what = "is a folder: give the .mcap file in it" if source.is_dir() else "is not there: give an MCAP file"
        raise UsageError(f"{source} {what}")
    if is_being_written(source):
        raise UsageError(f"{source} is being written: it is not cut off; stop the recording first")
    if output.exists() and output.samefile(source):
        raise UsageError(f"{output} is the input: it is never touched; choose another name")
    if output.is_dir() or (os.path.lexists(output) and not overwrite):
        raise UsageError(f"{output} exists already; choose another name, or --overwrite")


def _opened(source: Path, advance: Callable[[int, int], None]) -> McapFile:
    try:
        found = open_file(source, advance)
    except OSError as error:
        raise UsageError(f"cannot read {source}: {error.strerror}") from None
    if isinstance(found, McapFile):
        return found
    found.close()
    raise UsageError(f"{source} is a sqlite3 file; recover makes MCAP files whole")


def _claim(output: Path) -> Path:
    partial = output.with_name(output.name + SUFFIX)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        partial.open("xb").close()
    except FileExistsError:
        raise UsageError(f"{partial} exists: another recovery is running, or was cut off; move it away first") from None
    except OSError as error:
        raise UsageError(f"cannot write {output}: {error.strerror}") from None
    return partial


def _topics(found: McapFile) -> list[TopicCount]:
    promised, counts, types = Counter[str](), Counter[str](), {}
    for number, stream in sorted(found.streams.items()):
        counts[stream.channel.topic] += found.counts[number]
        promised[stream.channel.topic] += (found.promised or {}).get(number, 0)
        types[stream.channel.topic] = stream.schema.name if stream.schema else ""
    return [
        TopicCount(topic, name, counts[topic], max(promised[topic] - counts[topic], 0) if found.promised else None)
        for topic, name in types.items()
    ]


def _write(partial: Path, name: str, found: McapFile, advance: Callable[[int], None]) -> None:
    compression = COMPRESSIONS.get(found.compression, CompressionType.ZSTD)
    with partial.open("wb") as file:
        writer = Writer(file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True)
        writer.start(profile=found.profile, library=LIBRARY)
        channels = _declare(writer, found)
        for offset, entry in found.in_file_order():
            if isinstance(entry, Metadata):
                if entry.name != ROSBAG2:  # it tells how many messages there are: a new one will
                    writer.add_metadata(entry.name, entry.metadata)
            elif isinstance(entry, Attachment):
                kind = entry.create_time, entry.log_time, entry.name, entry.media_type
                writer.add_attachment(*kind, entry.data)
            else:
                channel = channels[entry.channel]
                writer.add_message(channel, entry.log_time, entry.data, entry.publish_time, entry.sequence)
            advance(offset)
        writer.add_metadata(RECOVERED, _origin(found))
        if _is_described(found):
            writer.add_metadata(ROSBAG2, {"serialized_metadata": to_yaml(_information(name, found))})
        writer.finish()  # type: ignore[no-untyped-call]
        file.flush()
        os.fsync(file.fileno())


def _put(partial: Path, output: Path, overwrite: bool) -> None:
    if overwrite:
        partial.replace(output)
        return
    try:
        rename_new(partial, output)
    except FileExistsError:
        raise UsageError(f"{output} has appeared meanwhile, and is left as it is; choose another name") from None


def _prepared(output: Path, found: McapFile) -> Callable[[], object]:
    """What puts `metadata.yaml` beside, written while nothing is in its place yet."""
    described = _is_described(found) and _is_alone(output)
    return prepare_metadata(output.parent, _information(output.name, found)) if described else lambda: None


def _is_described(found: McapFile) -> bool:
    """Whether ROS 2 has a `metadata.yaml` of it: for its own profile, and for so many topics that others read it."""
    return found.profile == "ros2" and len(found.streams) <= MOST_TOPICS


def _is_alone(output: Path) -> bool:
    """Whether the output's folder is a bag's: with something else in it, it is somebody's working folder."""
    return all(path.name == METADATA or path.name.startswith(output.name) for path in output.parent.iterdir())


def _declare(writer: Writer, found: McapFile) -> dict[int, int]:
    """Declare schemas and channels; the channels' new numbers by their old ones."""
    schemas, channels = {0: 0}, {}
    for number, (channel, schema) in sorted(found.streams.items()):
        if schema and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        channels[number] = writer.register_channel(
            channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
        )
    return channels


def _origin(found: McapFile) -> dict[str, str]:
    return {
        "source": found.path.name,
        "source_bytes": str(found.size),
        "unread_bytes": str(found.unread),
        "messages": str(found.counts.total()),
        "faults": "\n".join(found.faults[:MOST_FAULTS]),
    }


def _information(name: str, found: McapFile) -> dict[str, Any]:
    """Content of `metadata.yaml` of a file of which nothing is known but what its channels say; version 9."""
    return with_topics([FileFacts(name, *(found.times or (0, 0)), _by_topic(found))], _rosbag2_topics(found))


def _by_topic(found: McapFile) -> Counter[str]:
    counts = Counter[str]()
    for number, (channel, _) in found.streams.items():
        counts[channel.topic] += found.counts[number]
    return counts


def _rosbag2_topics(found: McapFile) -> list[dict[str, Any]]:
    topics: dict[str, dict[str, Any]] = {}
    for number, (channel, schema) in sorted(found.streams.items()):
        metadata = {
            "name": channel.topic,
            "type": schema.name if schema else "",
            "serialization_format": channel.message_encoding,
            "offered_qos_profiles": _qos(channel.metadata.get("offered_qos_profiles", "")),
            "type_description_hash": channel.metadata.get("topic_type_hash", ""),
        }
        entry = topics.setdefault(channel.topic, {"topic_metadata": metadata, "message_count": 0})
        entry["message_count"] += found.counts[number]
    return list(topics.values())


def _qos(text: str) -> Any:
    """Quality of service as version 9 has it; empty if it is none."""
    try:
        return parse_yaml(text) or []
    except BadYamlError:
        return []
