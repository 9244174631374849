"""`metadata.yaml` of a recovered file, in which nothing is known but what its channels say; rosbag2 version 9."""

from __future__ import annotations

from collections import Counter
from typing import Any

from knee_contact_ros.bags.metadata import FileFacts, to_yaml, with_topics
from knee_contact_ros.bags.recovery.mcap_file import McapFile
from knee_contact_ros.system.yaml_file import BadYamlError, parse_yaml

ROSBAG2 = "rosbag2"
"""Name of the metadata record in which rosbag2 keeps the same"""


def rosbag2_record(name: str, found: McapFile) -> dict[str, str]:
    """The content of rosbag2's metadata record, for a file called `name`."""
    return {"serialized_metadata": to_yaml(information(name, found))}


def information(name: str, found: McapFile) -> dict[str, Any]:
    """Content of `metadata.yaml`."""
    return with_topics([FileFacts(name, *(found.times or (0, 0)), _by_topic(found))], _topics(found))


def _by_topic(found: McapFile) -> Counter[str]:
    counts = Counter[str]()
    for number, (channel, _) in found.streams.items():
        counts[channel.topic] += found.counts[number]
    return counts


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
        return parse_yaml(text) or []
    except BadYamlError:
        return []
