"""`metadata.yaml` of a recovered file, in which nothing is known but what its channels say; rosbag2 version 9."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from knee_contact_ros.record import _is_of_another_bag, _yaml
from knee_contact_ros.salvage.folder_metadata import METADATA
from knee_contact_ros.salvage.mcap_file import McapFile

ROSBAG2 = "rosbag2"
"""Name of the metadata record in which rosbag2 keeps the same"""


def rosbag2_record(name: str, found: McapFile) -> dict[str, str]:
    """The content of rosbag2's metadata record, for a file called `name`."""
    return {"serialized_metadata": _yaml(information(name, found))}


def write_metadata(output: Path, found: McapFile) -> None:
    """Write `metadata.yaml` beside a recovered file, unless that is another bag's."""
    metadata = output.with_name(METADATA)
    if not (metadata.exists() and _is_of_another_bag(metadata, output.name)):
        content = {"rosbag2_bagfile_information": information(output.name, found)}
        metadata.write_text(_yaml(content), encoding="utf-8")


def information(name: str, found: McapFile) -> dict[str, Any]:
    """Content of `metadata.yaml`."""
    first, last = found.times or (0, 0)
    times = {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": last - first},
        "message_count": found.counts.total(),
    }
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **times,
        "topics_with_message_count": _topics(found),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name],
        "files": [{"path": name, **times}],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def _topics(found: McapFile) -> list[dict[str, Any]]:
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
        return YAML(typ="safe", pure=True).load(text) or []
    except YAMLError:
        return []
