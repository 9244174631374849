"""A bag's file or folder, opened by the library that can: MCAP files hold more than ROS messages.

rosbags refuses a file with a schema or profile that ROS does not know, whatever its other topics are. The MCAP
project's own reader takes it, at a third of the speed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader

NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
"""By the encoding of a schema"""


class McapFile:
    """An MCAP file with what is used of rosbags' `Reader`; messages of one time come in the order of the file."""

    def __init__(self, path: Path) -> None:
        """Open a file.

        Raises:
            McapError: it is no complete MCAP file.
            OSError: it cannot be read.
        """
        self._file = path.open("rb")
        try:
            self._reader = make_reader(self._file)
            summary = self._reader.get_summary()
            if summary is None or summary.statistics is None:
                raise McapError("it has no summary")
        except BaseException:
            self._file.close()
            raise
        counts = summary.statistics.channel_message_counts
        self.end_time = summary.statistics.message_end_time + 1
        self.connections = [
            Connection(
                id=channel.id,
                topic=channel.topic,
                msgtype=summary.schemas[channel.schema_id].name if channel.schema_id else "",
                msgdef=_definition(summary.schemas.get(channel.schema_id)),
                digest="",
                msgcount=counts.get(channel.id, 0),
                ext=ConnectionExtRosbag2(channel.message_encoding, []),
                owner=self,
            )
            for channel in summary.channels.values()
        ]

    def messages(
        self, connections: Collection[Connection], start: int | None, stop: int | None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Connection, log time [ns] and bytes of the messages from `start` to before `stop` [ns], by log time."""
        asked = {connection.id: connection for connection in connections}
        topics = {connection.topic for connection in connections}
        for _, channel, message in self._reader.iter_messages(topics):
            in_time = (start is None or message.log_time >= start) and (stop is None or message.log_time < stop)
            if in_time and channel.id in asked:
                yield asked[channel.id], message.log_time, message.data

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _definition(schema: Schema | None) -> MessageDefinition:
    if schema is None or schema.encoding not in FORMATS:
        return NO_DEFINITION
    return MessageDefinition(FORMATS[schema.encoding], schema.data.decode("utf-8", "replace"))


def open_reader(path: Path) -> Any:
    """A reader of a bag: rosbags' own if it takes the bag.

    Raises:
        Exception: what rosbags has against the bag, if nobody else can read it either.
    """
    reader = Reader(path)
    try:
        reader.open()
    except Exception:  # whatever it finds in there
        if path.suffix != ".mcap":
            raise
        try:
            return McapFile(path)
        except (McapError, OSError, ValueError):
            pass
        raise
    return reader
