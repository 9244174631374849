"""`knee-contact recover`: the readable content of a damaged MCAP file in a new, whole file."""

import os
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from ..system.errors import UsageError, join_faults
from ..system.output_files import check_not_input, is_being_written, rename_new
from ..system.progress import OnProgress, no_progress
from .folder import MCAP, kind_of
from .mcap_file import DamagedError, McapFile
from .mcap_writer import CHUNK_SIZE, LIBRARY, ROSBAG2

RECOVERED = "recovered"
"""Name of the metadata record that describes the file from which another one was recovered"""
SUFFIX = ".recovering"
"""Suffix of the output until it is complete, after the number of the process; the input may end in `.partial`"""
COMPRESSIONS = {"": CompressionType.NONE, "lz4": CompressionType.LZ4}
"""Compression of the output by the name of that in the input; zstd for others, and without chunks"""
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
    times: tuple[int, int]
    """Smallest and largest log time [ns]"""
    size: int
    """Size [B] of the input"""
    unread_bytes: int
    """Number of bytes of the input that could not be used"""
    faults: list[str]
    """Faults of the input, as sentences"""


def recover(
    source: Path,
    output: Path,
    advance: OnProgress = no_progress,
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
    # Reading is the first half of the work, and writing the second one.
    with closing(
        _opened(source, output, overwrite, lambda done, total: advance(done, 2 * total))
    ) as file:
        if not file.message_counts.total():
            kind = (
                "an MCAP file of which no message can be read" if file.declared else "no MCAP file"
            )
            raise UsageError(f"{source} is {kind}: {join_faults(file.faults) or 'it has none'}")
        topics = _topics(file)
        spans = [chunk.times for chunk in file.chunks]
        times = min(first for first, _ in spans), max(last for _, last in spans)
        partial = output.with_name(f"{output.name}.{os.getpid()}{SUFFIX}")
        try:
            output.parent.mkdir(parents=True, exist_ok=True)
            partial.open("xb").close()
        except OSError as error:
            raise UsageError(f"cannot write {output}: {error.strerror}") from None
        try:
            _write(partial, file, lambda done: advance(file.size + done, 2 * file.size))
            if overwrite:
                partial.replace(output)
            else:
                rename_new(partial, output)
        except DamagedError as fault:  # no longer what was checked
            raise UsageError(f"{source} was changed while it was read: a chunk {fault}") from None
        except FileExistsError:
            raise UsageError(
                f"{output} appeared in the meantime and was not changed; choose another name"
            ) from None
        finally:
            partial.unlink(missing_ok=True)
    return Recovery(topics, times, file.size, file.unread_bytes, file.faults)


def _opened(source: Path, output: Path, overwrite: bool, advance: OnProgress) -> McapFile:
    """Open the file, unless it cannot be recovered or the output must not be written."""
    if not source.is_file():
        reason = (
            "is a folder: give the .mcap file in it"
            if source.is_dir()
            else "is not there: give an MCAP file"
        )
        raise UsageError(f"{source} {reason}")
    if is_being_written(source):
        raise UsageError(f"{source} is being written: it is not cut off; stop the recording first")
    check_not_input(output, [source])
    if output.is_dir() or (os.path.lexists(output) and not overwrite):
        raise UsageError(f"{output} exists already; choose another name, or --overwrite")
    try:
        if kind_of(source) != MCAP:
            raise UsageError(f"{source} is a sqlite3 file; recover repairs MCAP files only")
        return McapFile(source, advance)
    except OSError as error:
        raise UsageError(f"cannot read {source}: {error.strerror}") from None


def _topics(file: McapFile) -> list[TopicCount]:
    """Return the numbers of messages by topic, in the order of the channels."""
    expected = Counter[str]()
    counts = Counter[str]()
    types = dict[str, str]()
    own = file.message_counts
    for channel_id, (channel, schema) in sorted(file.declared.items()):
        topic = channel.topic
        types[topic] = schema.name
        counts[topic] += own[channel_id]
        if file.statistics:
            expected[topic] += file.statistics.channel_message_counts.get(channel_id, 0)
    return [
        TopicCount(
            topic,
            name,
            counts[topic],
            max(expected[topic] - counts[topic], 0) if file.statistics else None,
        )
        for topic, name in types.items()
    ]


def _write(partial: Path, file: McapFile, advance: Callable[[int], object]) -> None:
    """Write the readable content of a file to `partial`."""
    named = (chunk.compression for chunk in file.chunks if chunk.compression is not None)
    compression = COMPRESSIONS.get(next(named, "zstd"), CompressionType.ZSTD)
    with partial.open("wb") as output:
        writer = Writer(
            output, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True
        )
        writer.start(profile=file.profile, library=file.library or LIBRARY)
        schemas = {0: 0}
        channels = {}
        for channel_id, (channel, schema) in sorted(file.declared.items()):
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            channels[channel_id] = writer.register_channel(
                channel.topic,
                channel.message_encoding,
                schemas[channel.schema_id],
                channel.metadata,
            )
        for offset, entry in file.in_file_order():
            if isinstance(entry, Attachment):
                writer.add_attachment(
                    entry.create_time, entry.log_time, entry.name, entry.media_type, entry.data
                )
            elif not isinstance(entry, Metadata):
                writer.add_message(
                    channels[entry.channel_id],
                    entry.log_time,
                    entry.data,
                    entry.publish_time,
                    entry.sequence,
                )
            elif entry.name != ROSBAG2:  # it has other numbers of messages
                writer.add_metadata(entry.name, entry.metadata)
            advance(offset)
        origin = {
            "source": file.path.name,
            "source_bytes": str(file.size),
            "unread_bytes": str(file.unread_bytes),
            "messages": str(file.message_counts.total()),
            "faults": "\n".join(file.faults[:MOST_FAULTS]),
        }
        writer.add_metadata(RECOVERED, origin)
        writer.finish()  # type: ignore[no-untyped-call]
        output.flush()
        os.fsync(output.fileno())
