"""`metadata.yaml` of a rosbag2 folder: what it says, and whether the files hold it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos

from knee_contact_ros.system.yaml_file import LARGEST_METADATA, BadYamlError, parse_yaml, read_yaml

METADATA = "metadata.yaml"


class Declared(NamedTuple):
    """A topic as a file or `metadata.yaml` declares it."""

    topic: str
    type: str
    encoding: str
    qos: Any
    """As rosbag2 writes it: YAML or, from version 9 on, what YAML gives"""
    digest: str = ""
    """Hash of the type, if there is one"""
    definition: str = ""
    """Of the message, in the language of `.msg` files; empty if there is none"""


class FolderMetadata(NamedTuple):
    """What counts of `metadata.yaml`."""

    files: list[str]
    """Names"""
    compressed: str
    """How the whole is compressed: `file`, `message` or empty"""
    topics: dict[str, tuple[Declared, int]]
    """By name, with the number of messages"""


def read_metadata(folder: Path) -> tuple[FolderMetadata | None, list[str]]:
    """What `metadata.yaml` says, None if it is of no use, and what is wrong with it."""
    try:
        content = read_yaml(folder / METADATA, LARGEST_METADATA)
        return _understood(content["rosbag2_bagfile_information"]), []
    except FileNotFoundError:
        return None, [f"{METADATA} is missing"]
    except (OSError, BadYamlError, LookupError, TypeError, ValueError, AttributeError):
        return None, [f"{METADATA} cannot be read"]


def _understood(content: dict[str, Any]) -> FolderMetadata:
    topics = {}
    for entry in content["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        declared = Declared(
            str(topic["name"]),
            str(topic["type"]),
            str(topic["serialization_format"]),
            topic.get("offered_qos_profiles", []),
            str(topic.get("type_description_hash", "")),
        )
        topics[declared.topic] = declared, int(entry["message_count"])
    compressed = str(content.get("compression_mode") or "").lower()
    files = list(dict.fromkeys(Path(name).name for name in content["relative_file_paths"]))
    return FolderMetadata(files, "" if compressed == "none" else compressed, topics)


def contradictions(
    said: Mapping[str, tuple[Declared, int]], files: Iterable[tuple[Mapping[int, Declared], Counter[int]]]
) -> list[str]:
    """Where `metadata.yaml` does not fit the topics and the numbers of messages in the files."""
    counts, faults = Counter[str](), []
    for declarations, in_file in files:
        for number, declared in declarations.items():
            counts[declared.topic] += in_file[number]
            if declared.topic in said and not _same(said[declared.topic][0], declared):
                faults.append(f"{METADATA} declares {declared.topic} in another way than the file")
    for topic in sorted({*said, *(topic for topic, count in counts.items() if count)}):
        promised = said[topic][1] if topic in said else 0
        if counts[topic] < promised:
            faults.append(f"{promised - counts[topic]} of {promised} messages are missing on {topic}")
        elif counts[topic] > promised:
            faults.append(f"{METADATA} knows of {promised} messages on {topic} and not of {counts[topic]}")
    return faults


def _same(one: Declared, other: Declared) -> bool:
    """Whether two declarations are the same for a reader: rosbags takes messages only where they are."""
    if (one.type, one.encoding) != (other.type, other.encoding):
        return False
    if one.digest and other.digest and one.digest != other.digest:
        return False
    try:
        return _qos(one.qos) == _qos(other.qos)
    except Exception:  # whatever broken text provokes in the parser
        return False


def _qos(text: Any) -> list[Qos]:
    return parse_qos(parse_yaml(text) or [] if isinstance(text, str) else text)
