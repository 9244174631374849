"""Write MCAP as a ROS 2 recorder does: CDR messages, `ros2msg` schemas, QoS and type hashes, `metadata.yaml` beside.

The bytes are those of the message's content and nothing else (ROS's own serialiser leaves uninitialised padding), so
the same messages give the same file.
"""

from __future__ import annotations

import io
import os
from collections import Counter
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.writer import CompressionType, Writer
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from knee_contact_ros.messages import typestore
from knee_contact_ros.outputs import claim

LIBRARY = "knee_contact_ros"
REFUSED_SAMPLES = "refused_samples"
"""Name of the metadata record that counts refused samples by reason."""
CHUNK_SIZE = 64 * 1024
"""[B] Small chunks: closing one stalls the writer 2-4 ms at most, and little is lost in a crash."""
FOREVER = {"sec": 9223372036, "nsec": 854775807}
OFFERED_QOS = [
    {
        "history": "keep_last",
        "depth": 100,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": FOREVER,
        "lifespan": FOREVER,
        "liveliness": "automatic",
        "liveliness_lease_duration": FOREVER,
        "avoid_ros_namespace_conventions": False,
    }
]
"""What the node and `replay` offer; rosbag2 metadata version 9."""


class BagWriter:
    """An MCAP file that appears under its final name when it is complete.

    Until `close` the file carries the suffix `.partial`.
    """

    def __init__(
        self, path: Path, compression: CompressionType = CompressionType.ZSTD, overwrite: bool = False
    ) -> None:
        """Open `path` for writing; with `overwrite`, a file of that name is replaced when the new one is complete.

        Raises:
            UsageError: see `claim`.
        """
        self.path = path
        self.partial = claim(path, overwrite)
        self.counts: Counter[str] = Counter()
        self._first = self._last = 0
        self._types: dict[str, str] = {}  # topic to message type
        self._schemas: dict[str, int] = {}  # message type to schema id
        self.channels: dict[str, int] = {}
        """Topic to channel id"""
        self._file = self.partial.open("wb")
        self.writer = Writer(self._file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True)
        self.writer.start(profile="ros2", library=LIBRARY)

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic (absolute name) and its message type; the order of declaration is that in the file."""
        if topic in self.channels:
            return
        if type_name not in self._schemas:
            text = typestore().generate_msgdef(type_name, ros_version=2)[0].encode()
            self._schemas[type_name] = self.writer.register_schema(name=type_name, encoding="ros2msg", data=text)
        self.channels[topic] = self.writer.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schemas[type_name],
            metadata={
                "offered_qos_profiles": _yaml(OFFERED_QOS),
                "topic_type_hash": typestore().hash_rihs01(type_name),
            },
        )
        self._types[topic] = type_name
        self.counts[topic] = 0

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Write a message's CDR bytes under its stamp [ns], which is log time and publish time alike."""
        self.writer.add_message(self.channels[topic], stamp, data, stamp, self.counts[topic])
        self.count(topic, 1, stamp, stamp)

    def count(self, topic: str, number: int, first: int, last: int) -> None:
        """Take messages into account that were written, with their first and last stamp [ns]."""
        if not self.counts.total():
            self._first, self._last = first, last
        self._first, self._last = min(self._first, first), max(self._last, last)
        self.counts[topic] += number

    def flush(self) -> None:
        """Hand all that was written to the operating system."""
        self.writer.flush()  # type: ignore[no-untyped-call]

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.writer.add_metadata(name, values)

    def close(self) -> None:
        """Complete the file, give it its name, and write `metadata.yaml` beside it unless that is another bag's."""
        information = self._information()
        self.writer.add_metadata("rosbag2", {"serialized_metadata": _yaml(information)})
        self.writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.partial.replace(self.path)
        metadata = self.path.with_name("metadata.yaml")
        if not (metadata.exists() and _is_of_another_bag(metadata, self.path.name)):
            metadata.write_text(_yaml({"rosbag2_bagfile_information": information}), encoding="utf-8")

    def discard(self) -> None:
        """Give up: leave nothing behind."""
        with suppress(OSError):  # a full disk also refuses what is still in the file's buffer
            self._file.close()
        self.partial.unlink(missing_ok=True)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.close()
        finally:
            if self.partial.exists():
                self.discard()

    def _information(self) -> dict[str, Any]:
        """Content of `metadata.yaml`, version 9."""
        times = {
            "starting_time": {"nanoseconds_since_epoch": self._first},
            "duration": {"nanoseconds": self._last - self._first},
            "message_count": self.counts.total(),
        }
        return {
            "version": 9,
            "storage_identifier": "mcap",
            **times,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic,
                        "type": self._types[topic],
                        "serialization_format": "cdr",
                        "offered_qos_profiles": OFFERED_QOS,
                        "type_description_hash": typestore().hash_rihs01(self._types[topic]),
                    },
                    "message_count": count,
                }
                for topic, count in self.counts.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self.path.name],
            "files": [{"path": self.path.name, **times}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }


def _is_of_another_bag(metadata: Path, name: str) -> bool:
    try:
        content = YAML(typ="safe", pure=True).load(metadata.read_text(encoding="utf-8"))
        return bool(content["rosbag2_bagfile_information"]["relative_file_paths"] != [name])
    except (YAMLError, KeyError, TypeError):
        return True


def _yaml(content: Any) -> str:
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.representer.ignore_aliases = lambda _: True
    yaml.width = 1000
    text = io.StringIO()
    yaml.dump(content, text)
    return text.getvalue()
