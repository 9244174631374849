"""How those records of an MCAP file lie in bytes of which there are too many for the `mcap` library's classes."""

from __future__ import annotations

from struct import Struct

MAGIC = b"\x89MCAP0\r\n"
"""At the beginning and at the end of a file"""
HEAD = Struct("<BQ")
"""Of any record: opcode, and length of the content behind it [B]"""
MESSAGE = Struct("<HIQQ")
"""In a message's content before its data: channel, sequence number, log time and publish time [ns]"""
MESSAGE_HEAD = Struct("<BQHIQQ")
"""Both of them"""
CHUNK_HEAD = Struct("<QQQII")
"""First and last log time [ns], size [B] of the records, their checksum, length [B] of the compression's name"""
INDEX = Struct("<HI")
"""In a message index's content before its entries: channel, and length of the entries [B]"""
ENTRY = Struct("<QQ")
"""Of a message index: log time [ns] of a message, and where in the chunk [B] its record begins"""
