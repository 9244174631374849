"""Binary layouts of the MCAP records that are too numerous for the classes of the `mcap` library."""

from __future__ import annotations

from struct import Struct

MAGIC = b"\x89MCAP0\r\n"
"""Magic bytes at the beginning and at the end of a file"""
HEAD = Struct("<BQ")
"""Head of a record: opcode, and length [B] of the content, which follows"""
MESSAGE = Struct("<HIQQ")
"""Beginning of a message record's content, before the data: channel, sequence number, log time and publish time [ns]"""
MESSAGE_HEAD = Struct("<BQHIQQ")
"""`HEAD` and `MESSAGE` together"""
CHUNK_HEAD = Struct("<QQQII")
"""Beginning of a chunk record's content: smallest and largest log time [ns], uncompressed size [B], CRC-32 of the
records, and length [B] of the name of the compression, which follows"""
INDEX = Struct("<HI")
"""Beginning of a message index record's content: channel, and length [B] of the entries, which follow"""
ENTRY = Struct("<QQ")
"""Entry of a message index: log time [ns] of a message, and offset [B] of its record in the uncompressed chunk"""
