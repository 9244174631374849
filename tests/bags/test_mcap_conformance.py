"""MCAP in every form that its specification allows: what the reference library reads, we read, and without a fault.

Files are made here from the specification's tables, as no writer makes all forms. What we write has the bytes of the
reference library's writer (`test_writer`).
"""

import struct
import zlib
from contextlib import closing
from itertools import product
from typing import NamedTuple

import lz4.frame
import pytest
import zstandard
from mcap import records as mcap
from mcap.stream_reader import StreamReader

from knee_contact_ros.bags.arrival import by_arrival
from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.recover import RECOVERED, recover
from tests.hostile.bags import MAGIC, record

COMPRESSIONS = {
    "": bytes,
    "zstd": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
}
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX, ATTACHMENT = range(1, 10)
ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, OFFSET, DATA_END = range(10, 16)


def text(value):
    return struct.pack("<I", len(value)) + value


def pairs(form, rows):
    return text(b"".join(struct.pack(form, *row) for row in rows))


def words(rows):
    return text(b"".join(text(word) for row in rows for word in row))


class Form(NamedTuple):
    """Choices that the specification leaves to a writer."""

    compression: str | None  # None: no chunks
    added: bytes  # fields at the end of every record that may be extended
    unknown: tuple[int, ...]  # opcodes of records that nobody knows yet
    message_index: bool
    repeated: bool  # schemas and channels in the summary
    statistics: str
    offsets: bool
    checksums: bool


FORMS = [
    form
    for form in map(
        Form._make,
        product(
            (None, *COMPRESSIONS),
            (b"", b"\1\2\3", bytes(40)),
            ((), (0x10, 0x7F, 0x80, 0xFF)),
            (False, True),
            (False, True),
            ("none", "all", "no channels"),
            (False, True),
            (False, True),
        ),
    )
    if not (form.compression is None and form.message_index)
    and not (form.statistics == "all" and not form.repeated)
]
A, B = (1, b"a/msg/A", b"ros2msg", b"int32 a"), (7, b"b", b"", b"")
ONE, TWO, BARE = (1, 1, b"/one", b"cdr"), (65535, 7, b"/two", b"json"), (0, 0, b"/bare", b"")
NOTE = METADATA, text(b"note") + words([(b"a", b"b"), (b"", b"\xc3\xa9")])
PAGE = ATTACHMENT, b"page"
SCHEMA_0 = SCHEMA, (0, b"none", b"none", b"none")
BODIES = {
    "nothing": [],
    "little": [PAGE, SCHEMA_0, (CHANNEL, BARE), (MESSAGE, (0, 1, 5, 5, b"bytes")), NOTE],
    "all": [
        *[(SCHEMA, A), (CHANNEL, ONE), (MESSAGE, (1, 0, 9, 8, b"x" * 50)), NOTE],
        *[(MESSAGE, (1, 1, 2**63, 0, b"")), (SCHEMA, B), (CHANNEL, TWO), PAGE],
        *[(MESSAGE, (65535, n, 7 - n, 3, bytes(n))) for n in range(5)],
        *[(SCHEMA, A), (CHANNEL, ONE), (CHANNEL, BARE), (MESSAGE, (0, 4, 0, 0, b"end"))],
    ],
}


class Builder:
    """One file of a form."""

    def __init__(self, form, body):
        self.form, self.out, self.chunk, self.index = form, bytearray(MAGIC), bytearray(), {}
        self.summary = {CHUNK_INDEX: [], ATTACHMENT_INDEX: [], METADATA_INDEX: []}
        self.add(HEADER, text(b"") + text(b"tests"))
        for kind, fields in body:
            if kind == METADATA:
                place = self.standing_alone(kind, fields)
                self.summary[METADATA_INDEX].append(struct.pack("<QQ", *place) + text(b"note"))
            elif kind == ATTACHMENT:
                self.attach(fields)
            else:
                self.declare_or_say(kind, fields)
        self.end_chunk()
        self.add(DATA_END, self.crc(self.out))
        self.end(body)

    def crc(self, data):
        return struct.pack("<I", zlib.crc32(data) if self.form.checksums else 0)

    def record(self, opcode, content):
        return record(
            opcode, content if opcode in (MESSAGE, FOOTER) else content + self.form.added
        )

    def add(self, opcode, content):
        begin = len(self.out)
        for unknown in self.form.unknown:
            self.out += (
                record(unknown, b"?") if opcode not in (HEADER, FOOTER, INDEX, DATA_END) else b""
            )
            begin = len(self.out)
        self.out += self.record(opcode, content)
        return begin, len(self.out) - begin

    def standing_alone(self, kind, fields):
        """These are not in chunks."""
        self.end_chunk()
        return self.add(kind, fields)

    def attach(self, data):
        content = struct.pack("<QQ", 3, 0) + text(b"page.txt") + text(b"text/plain")
        content += struct.pack("<Q", len(data)) + data
        place = self.standing_alone(ATTACHMENT, content + self.crc(content))
        row = struct.pack("<5Q", *place, 3, 0, len(data)) + text(b"page.txt") + text(b"text/plain")
        self.summary[ATTACHMENT_INDEX].append(row)

    def content(self, kind, fields):
        if kind == SCHEMA:
            return struct.pack("<H", fields[0]) + b"".join(map(text, fields[1:]))
        if kind == CHANNEL:
            return struct.pack("<HH", *fields[:2]) + b"".join(map(text, fields[2:])) + words([])
        return struct.pack("<HIQQ", *fields[:4]) + fields[4]

    def declare_or_say(self, kind, fields):
        content = self.content(kind, fields)
        if self.form.compression is None:
            self.add(kind, content)
            return
        self.chunk += b"".join(record(unknown, b"") for unknown in self.form.unknown)
        if kind == MESSAGE:
            self.index.setdefault(fields[0], []).append((fields[2], len(self.chunk)))
        self.chunk += self.record(kind, content)

    def end_chunk(self):
        if not self.chunk:
            return
        name, data = self.form.compression, COMPRESSIONS[self.form.compression](bytes(self.chunk))
        times = [time for own in self.index.values() for time, _ in own] or [0]
        span, size = struct.pack("<QQ", min(times), max(times)), struct.pack("<Q", len(self.chunk))
        content = span + size + self.crc(self.chunk) + text(name.encode())
        place = self.add(CHUNK, content + struct.pack("<Q", len(data)) + data)
        begin, offsets = len(self.out), []
        for channel, rows in self.index.items() if self.form.message_index else ():
            row = struct.pack("<H", channel) + pairs("<QQ", rows)
            offsets.append((channel, self.add(INDEX, row)[0]))
        content = span + struct.pack("<QQ", *place) + pairs("<HQ", offsets)
        content += struct.pack("<Q", len(self.out) - begin) + text(name.encode())
        self.summary[CHUNK_INDEX].append(content + struct.pack("<Q", len(data)) + size)
        self.chunk, self.index = bytearray(), {}

    def end(self, body):
        """Summary, summary offsets and footer."""
        begin, groups = len(self.out), []
        rows = {kind: [fields for each, fields in body if each == kind] for kind in range(1, 16)}
        own = {row[0]: sum(each[0] == row[0] for each in rows[MESSAGE]) for row in rows[CHANNEL]}
        counts = own.items() if self.form.statistics == "all" else ()
        times = [row[2] for row in rows[MESSAGE]] or [0]
        statistics = struct.pack(
            *["<QHIIIIQQ", len(rows[MESSAGE]), len({*rows[SCHEMA]} - {SCHEMA_0[1]}), len(own)],
            *[len(rows[ATTACHMENT]), len(rows[METADATA]), len(self.summary[CHUNK_INDEX])],
            *[min(times), max(times)],
        ) + pairs("<HQ", counts)
        summary = {
            kind: [self.content(kind, row) for row in dict.fromkeys(rows[kind])]
            for kind in (SCHEMA, CHANNEL)
            if self.form.repeated
        } | {STATISTICS: [statistics] if self.form.statistics != "none" else []}
        for kind, contents in (summary | self.summary).items():
            first = len(self.out)
            for content in contents:
                self.out += self.record(kind, content)
            if contents:
                groups.append(struct.pack("<BQQ", kind, first, len(self.out) - first))
        self.out += b"".join(record(unknown, b"") for unknown in self.form.unknown)
        offsets = len(self.out) if groups and self.form.offsets else 0
        for group in groups if offsets else ():
            self.out += self.record(OFFSET, group)
        footer = struct.pack("<QQ", begin if len(self.out) > begin else 0, offsets)
        checked = self.out[begin:] + b"\x02" + struct.pack("<Q", 20) + footer
        self.add(FOOTER, footer + self.crc(checked))
        self.out += MAGIC


def reference(path):
    """Messages with all that belongs to them, metadata and attachments, as `mcap` reads them."""
    schemas, channels, found = {0: ""}, {}, []
    with path.open("rb") as file:
        for each in StreamReader(file, validate_crcs=True).records:
            match each:
                case mcap.Schema() if each.id:
                    schemas[each.id] = each.name
                case mcap.Channel():
                    channels[each.id] = each.topic, schemas[each.schema_id], each.message_encoding
                case mcap.Message():
                    found.append((channels[each.channel_id], each))
                case mcap.Metadata() | mcap.Attachment():
                    found.append(("", each))
    return found


def ours(file):
    declared = {
        number: (each.topic, each.type, each.encoding) for number, each in file.channels.items()
    }
    for _, each in file.in_file_order():
        yield declared[each.channel_id] if isinstance(each, mcap.Message) else "", each


@pytest.mark.parametrize("name", BODIES)
def test_every_form_is_read_as_the_reference_library_reads_it(tmp_path, name):
    path, output, plain = tmp_path / "in.mcap", tmp_path / "out.mcap", {}
    for number, form in enumerate(FORMS):
        path.write_bytes(Builder(form, BODIES[name]).out)
        if form[1:3] == (
            b"",
            (),
        ):  # `mcap` 1.6 reads added fields wherever they are not in a chunk
            plain[form] = reference(path)
        expected = plain[form._replace(added=b"", unknown=())]
        with closing(McapFile(path)) as file:
            assert (file.faults, list(ours(file))) == ([], expected), form
            numbers = {channel: channel for channel in file.declared}
            rows = [row for batch in by_arrival([file], [numbers]) for row in batch]
        by_time = sorted(each.log_time for topic, each in expected if topic)
        assert sorted(time for _, time, _ in rows) == by_time
        if by_time and number % 7 == 0:  # of every kind some, as each is written to the disk
            recover(path, output, overwrite=True)
            assert kept(reference(output)) == kept(expected), form


def kept(rows):
    """By kind, as messages wait for the end of their chunk, without the ids, which the writer chooses."""
    own = [(topic, {**vars(each), "channel_id": 0}) for topic, each in rows]
    return sorted(
        (row for row in own if row[1].get("name") != RECOVERED), key=lambda row: not row[0]
    )
