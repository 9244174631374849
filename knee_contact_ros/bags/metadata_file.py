"""`metadata.yaml`, the file that makes a folder a bag of rosbag2: what our recordings have in it."""

import io
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from mcap.records import Statistics
from ruamel.yaml import YAML

from ..streams.topics import MESSAGE_TYPES, ROBOT_DESCRIPTION
from ..system import output_files
from ..system.files import MAX_METADATA_SIZE, open_regular

METADATA = "metadata.yaml"
"""Name of the file"""
INFINITE_DURATION = {"sec": 9223372036, "nsec": 854775807}
"""Infinite duration of a QoS profile"""
OFFERED_QOS = [
    {
        "history": "keep_last",
        "depth": 100,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": INFINITE_DURATION,
        "lifespan": INFINITE_DURATION,
        "liveliness": "automatic",
        "liveliness_lease_duration": INFINITE_DURATION,
        "avoid_ros_namespace_conventions": False,
    }
]
"""QoS profiles that the node and `replay` offer"""


def information(
    files: Sequence[tuple[str, Statistics]], topics: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Return the content of `metadata.yaml` for files, given by name, with the entries of their topics in order."""

    def times(files: Iterable[Statistics]) -> dict[str, Any]:
        filled = [file for file in files if file.message_count]
        first = min((file.message_start_time for file in filled), default=0)
        last = max((file.message_end_time for file in filled), default=0)
        return {
            "starting_time": {"nanoseconds_since_epoch": first},
            "duration": {"nanoseconds": last - first},
            "message_count": sum(file.message_count for file in filled),
        }

    each = [statistics for _, statistics in files]
    total = sum((Counter(file.channel_message_counts) for file in each), Counter[int]())
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **times(each),
        "topics_with_message_count": [
            {"topic_metadata": topic, "message_count": total[number]}
            for number, topic in enumerate(topics, start=1)
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [name for name, _ in files],
        "files": [{"path": name, **times([file])} for name, file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


def put_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Write `metadata.yaml` with the content that `information` returns; another bag's is left alone.

    Raises:
        OSError: The file cannot be written; an earlier one is unchanged.
    """
    metadata = folder / METADATA
    first = to_yaml({"": {"relative_file_paths": content["relative_file_paths"][:1]}})
    try:
        with open_regular(metadata) as file:  # not parsed, which takes as long as writing it
            is_ours = first.encode().partition(b"\n")[2] in file.read(MAX_METADATA_SIZE)
    except OSError:
        is_ours = not os.path.lexists(metadata)
    if not is_ours:
        return
    # Other processes may write one meanwhile.
    partial = output_files.partial_name(metadata.with_name(f"{METADATA}.{os.getpid()}"))
    output_files.write_new(partial, to_yaml({"rosbag2_bagfile_information": content}).encode())
    partial.replace(metadata)
    output_files.sync_folder(folder)


def to_yaml(content: Any) -> str:
    """Return the content as YAML text, with the keys in the given order."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.representer.ignore_aliases = lambda _: True
    yaml.width = 1000
    text = io.StringIO()
    yaml.dump(content, text)
    return text.getvalue()


def qos_of(type_name: str) -> list[dict[str, Any]]:
    """Return the offered QoS profiles of a topic by its type; late subscribers also get the description of the leg."""
    if type_name == MESSAGE_TYPES[ROBOT_DESCRIPTION]:
        return [OFFERED_QOS[0] | {"depth": 1, "durability": "transient_local"}]
    return OFFERED_QOS


@cache
def offered_qos(type_name: str) -> str:
    """Return the offered QoS profiles of a topic as YAML text, for the metadata of channels."""
    return to_yaml(qos_of(type_name))
