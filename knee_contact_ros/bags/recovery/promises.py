"""What an MCAP file says of itself, compared with what was found in it."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from typing import IO

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from knee_contact_ros.bags.recovery.records import BLOCK, HEAD
from knee_contact_ros.bags.recovery.scan import Scan
from knee_contact_ros.bags.recovery.segments import ChunkFacts

FOOTER_PART = struct.Struct("<BQQQ")
"""What the summary's checksum covers of the footer"""


def broken_promises(file: IO[bytes], scan: Scan) -> list[str]:
    """What does not fit, as sentences.

    A file without any of this keeps its promises. Where there are holes, they explain most of what does not fit; it is
    said all the same.
    """
    faults = []
    if scan.statistics and not _statistics_fit(scan):
        faults.append(_missing(scan))
    if scan.footer and scan.chunk_indexes and not _chunks_fit(scan):
        faults.append("the index of chunks does not fit the chunks")
    if scan.data_end and scan.data_end[1] and _checksum(file, 0, scan.data_end[0]) != scan.data_end[1]:
        faults.append("the data do not fit their checksum")
    if scan.footer and not _summary_fits(file, scan):
        faults.append("the summary does not fit its checksum or its place")
    return faults


def found_counts(scan: Scan) -> Counter[int]:
    """Messages by channel."""
    counts = Counter[int]()
    for segment in scan.segments:
        counts.update(segment.counts)
    return counts


def _statistics_fit(scan: Scan) -> bool:
    statistics, found = scan.statistics, found_counts(scan)
    assert statistics is not None  # noqa: S101
    by_channel = {channel: count for channel, count in statistics.channel_message_counts.items() if count}
    if statistics.message_count != found.total() or (by_channel and by_channel != dict(found)):
        return False
    first = min((segment.first for segment in scan.segments), default=0)
    last = max((segment.last for segment in scan.segments), default=0)
    times = (statistics.message_start_time, statistics.message_end_time)
    return not found or times == (first, last)


def _missing(scan: Scan) -> str:
    assert scan.statistics is not None  # noqa: S101
    promised, found = scan.statistics.message_count, found_counts(scan).total()
    if found < promised:
        return f"{promised - found} of {promised} messages are missing"
    return "the statistics do not fit the messages"


def _chunks_fit(scan: Scan) -> bool:
    indexes = sorted(scan.chunk_indexes, key=lambda index: index.chunk_start_offset)
    if list(map(_facts, indexes)) != sorted(scan.chunks, key=lambda chunk: chunk.offset):
        return False
    times = {segment.offset: (segment.first, segment.last) for segment in scan.segments if not segment.loose}
    for index in indexes:
        said = index.message_start_time, index.message_end_time
        if times.get(index.chunk_start_offset, said) != said:
            return False
    return True


def _facts(index: ChunkIndex) -> ChunkFacts:
    return ChunkFacts(
        index.chunk_start_offset,
        index.chunk_length,
        index.compression,
        index.compressed_size,
        index.uncompressed_size,
        index.message_index_offsets,
        index.message_index_length,
    )


def _summary_fits(file: IO[bytes], scan: Scan) -> bool:
    assert scan.footer is not None  # noqa: S101
    offset, footer = scan.footer
    if not footer.summary_start:
        return True
    behind_data = scan.data_end[0] + HEAD.size + 4 if scan.data_end else footer.summary_start
    if footer.summary_start != behind_data:
        return False
    if not footer.summary_crc:
        return True
    tail = FOOTER_PART.pack(Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
    return zlib.crc32(tail, _checksum(file, footer.summary_start, offset)) == footer.summary_crc


def _checksum(file: IO[bytes], begin: int, end: int) -> int:
    file.seek(begin)
    checksum = 0
    for position in range(begin, end, BLOCK):
        checksum = zlib.crc32(file.read(min(BLOCK, end - position)), checksum)
    return checksum
