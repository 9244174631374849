"""`knee-contact recover`: the readable content of a damaged MCAP file in a new, whole file."""

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
from knee_contact_ros.system.files import BadYamlError, parse_yaml
from knee_contact_ros.system.output_files import is_being_written, rename_new

ROSBAG2 = "rosbag2"
"""Name of the metadata record with the content of `metadata.yaml` for rosbag2"""
MOST_TOPICS = 2000
"""Largest number of topics in a `metadata.yaml` that other readers accept"""
RECOVERED = "recovered"
"""Name of the metadata record that describes the file from which another one was recovered"""
SUFFIX = ".recovering"
"""Suffix of the output until it is complete; `.partial` may be that of the input"""
COMPRESSIONS = {None: CompressionType.ZSTD, "": CompressionType.NONE, "lz4": CompressionType.LZ4}
"""Compression of the output by the name of that in the input; None if the input has no chunks"""
MOST_FAULTS = 1000
"""Largest number of faults in the metadata record"""


class TopicCount(NamedTuple):
    """Number of recovered messages of a topic."""

    topic: str
    """Name of the topic"""
    type: str
    """Type of the messages; empty if it is unknown"""
    messages: int
    """Number of recovered messages"""
    missing: int | None
    """Number of missing messages; None if the file has no statistics"""


class Recovery(NamedTuple):
    """Result of a recovery."""

    topics: list[TopicCount]
    """Numbers of recovered messages by topic"""
    times: tuple[int, int] | None
    """Smallest and largest log time [ns]; None without messages"""
    size: int
    """Size [B] of the input"""
    unread: int
    """Number of bytes of the input that could not be used"""
    faults: list[str]
    """Faults of the input, as sentences"""


def recover(
    source: Path,
    output: Path,
    advance: Callable[[int, int], None] = lambda _done, _total: None,
    overwrite: bool = False,
) -> Recovery:
    """Write the readable content of `source` to `output`.

    Messages with their times and sequence numbers, schemas, channels, metadata and attachments are copied unchanged, in
    the order of the file.

    Args:
        source: Damaged MCAP file, which is only read.
        output: New file.
        advance: Function that is called with the progress: work done, and work in all.
        overwrite: Whether an existing output is replaced once the new one is complete.

    Raises:
        UsageError: The output cannot be written, or no message can be read; an existing output is unchanged.
        OSError: Reading or writing has failed; an existing output is unchanged.
    """
    _check(source, output, overwrite)
    file = _opened(source, lambda done, total: advance(done, 2 * total))
    try:
        if not file.counts.total():
            kind = "no MCAP file" if not file.streams else "an MCAP file of which no message can be read"
            raise UsageError(f"{source} is {kind}: {in_a_line(file.faults) or 'it has none'}")
        result = Recovery(_topics(file), file.times, file.size, file.unread, file.faults)
        partial = _claim(output)
        try:
            _write(partial, output.name, file, lambda done: advance(file.size + done, 2 * file.size))
            describe = _prepared(output, file)
            _put(partial, output, overwrite)
        finally:
            partial.unlink(missing_ok=True)
        describe()
        return result
    finally:
        file.close()


def _check(source: Path, output: Path, overwrite: bool) -> None:
    """Refuse a source that cannot be recovered, and an output that must not be written."""
    if not source.is_file():
        reason = "is a folder: give the .mcap file in it" if source.is_dir() else "is not there: give an MCAP file"
        raise UsageError(f"{source} {reason}")
    if is_being_written(source):
        raise UsageError(f"{source} is being written: it is not cut off; stop the recording first")
    if output.exists() and output.samefile(source):
        raise UsageError(f"{output} is the input: it is never touched; choose another name")
    if output.is_dir() or (os.path.lexists(output) and not overwrite):
        raise UsageError(f"{output} exists already; choose another name, or --overwrite")


def _opened(source: Path, advance: Callable[[int, int], None]) -> McapFile:
    """MCAP file, opened and checked."""
    try:
        file = open_file(source, advance)
    except OSError as error:
        raise UsageError(f"cannot read {source}: {error.strerror}") from None
    if isinstance(file, McapFile):
        return file
    file.close()
    raise UsageError(f"{source} is a sqlite3 file; recover makes MCAP files whole")


def _claim(output: Path) -> Path:
    """Create the file under the name that it has until it is complete."""
    partial = output.with_name(output.name + SUFFIX)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        partial.open("xb").close()
    except FileExistsError:
        raise UsageError(f"{partial} exists: another recovery is running, or was cut off; move it away first") from None
    except OSError as error:
        raise UsageError(f"cannot write {output}: {error.strerror}") from None
    return partial


def _topics(file: McapFile) -> list[TopicCount]:
    """Numbers of messages by topic, in the order of the channels."""
    promised, counts, types = Counter[str](), Counter[str](), {}
    for number, stream in sorted(file.streams.items()):
        counts[stream.channel.topic] += file.counts[number]
        promised[stream.channel.topic] += (file.promised or {}).get(number, 0)
        types[stream.channel.topic] = stream.schema.name if stream.schema else ""
    return [
        TopicCount(topic, name, counts[topic], max(promised[topic] - counts[topic], 0) if file.promised else None)
        for topic, name in types.items()
    ]


def _write(partial: Path, name: str, file: McapFile, advance: Callable[[int], None]) -> None:
    """Write the readable content of a file to `partial`, which will be called `name`."""
    compression = COMPRESSIONS.get(file.compression, CompressionType.ZSTD)
    with partial.open("wb") as output:
        writer = Writer(output, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True)
        writer.start(profile=file.profile, library=LIBRARY)
        channels = _declare(writer, file)
        for offset, entry in file.in_file_order():
            if isinstance(entry, Metadata):
                if entry.name != ROSBAG2:  # a new one will have the right numbers of messages
                    writer.add_metadata(entry.name, entry.metadata)
            elif isinstance(entry, Attachment):
                writer.add_attachment(entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data)
            else:
                channel = channels[entry.channel]
                writer.add_message(channel, entry.log_time, entry.data, entry.publish_time, entry.sequence)
            advance(offset)
        writer.add_metadata(RECOVERED, _origin(file))
        if _is_described(file):
            writer.add_metadata(ROSBAG2, {"serialized_metadata": to_yaml(_information(name, file))})
        writer.finish()  # type: ignore[no-untyped-call]
        output.flush()
        os.fsync(output.fileno())


def _put(partial: Path, output: Path, overwrite: bool) -> None:
    """Give the complete file its final name."""
    if overwrite:
        partial.replace(output)
        return
    try:
        rename_new(partial, output)
    except FileExistsError:
        raise UsageError(f"{output} has appeared meanwhile, and is left as it is; choose another name") from None


def _prepared(output: Path, file: McapFile) -> Callable[[], object]:
    """Prepare the `metadata.yaml` beside the output; the returned function puts it in place."""
    described = _is_described(file) and _is_alone(output)
    return prepare_metadata(output.parent, _information(output.name, file)) if described else lambda: None


def _is_described(file: McapFile) -> bool:
    """Whether the output gets a `metadata.yaml`: the profile is `ros2`, and other readers accept so many topics."""
    return file.profile == "ros2" and len(file.streams) <= MOST_TOPICS


def _is_alone(output: Path) -> bool:
    """Whether nothing else is in the output's folder, so that it is the folder of a bag and no working folder."""
    return all(path.name == METADATA or path.name.startswith(output.name) for path in output.parent.iterdir())


def _declare(writer: Writer, file: McapFile) -> dict[int, int]:
    """Declare schemas and channels, and return the new number of each channel by its old one."""
    schemas, channels = {0: 0}, {}
    for number, (channel, schema) in sorted(file.streams.items()):
        if schema and schema.id not in schemas:
            schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
        channels[number] = writer.register_channel(
            channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
        )
    return channels


def _origin(file: McapFile) -> dict[str, str]:
    """Content of the metadata record `recovered`."""
    return {
        "source": file.path.name,
        "source_bytes": str(file.size),
        "unread_bytes": str(file.unread),
        "messages": str(file.counts.total()),
        "faults": "\n".join(file.faults[:MOST_FAULTS]),
    }


def _information(name: str, file: McapFile) -> dict[str, Any]:
    """Content of `metadata.yaml` for a file, from its channels alone."""
    topics = _rosbag2_topics(file)
    counts = Counter({entry["topic_metadata"]["name"]: entry["message_count"] for entry in topics})
    return with_topics([FileFacts(name, *(file.times or (0, 0)), counts)], topics)


def _rosbag2_topics(file: McapFile) -> list[dict[str, Any]]:
    """Entries of the topics in `metadata.yaml`, in the order of the channels."""
    topics: dict[str, dict[str, Any]] = {}
    for number, (channel, schema) in sorted(file.streams.items()):
        metadata = {
            "name": channel.topic,
            "type": schema.name if schema else "",
            "serialization_format": channel.message_encoding,
            "offered_qos_profiles": _qos(channel.metadata.get("offered_qos_profiles", "")),
            "type_description_hash": channel.metadata.get("topic_type_hash", ""),
        }
        entry = topics.setdefault(channel.topic, {"topic_metadata": metadata, "message_count": 0})
        entry["message_count"] += file.counts[number]
    return list(topics.values())


def _qos(text: str) -> Any:
    """QoS profiles in the form of version 9 of `metadata.yaml`; empty if the text is no YAML."""
    try:
        return parse_yaml(text) or []
    except BadYamlError:
        return []
