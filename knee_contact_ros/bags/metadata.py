"""`metadata.yaml` of a rosbag2 folder: reading it, and writing its version 9."""

from __future__ import annotations

import io
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML

from knee_contact_ros.streams.topics import typestore
from knee_contact_ros.system.files import LARGEST_METADATA, BadYamlError, read_yaml
from knee_contact_ros.system.output_files import partial_name, sync_folder, write_new

METADATA = "metadata.yaml"
"""Name of the file"""
FOREVER = {"sec": 9223372036, "nsec": 854775807}
"""Infinite duration of a QoS profile"""
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
"""QoS profiles that the node and `replay` offer"""


class FolderMetadata(NamedTuple):
    """Content of a `metadata.yaml` as far as it is used."""

    files: list[str]
    """Names of the bag's files"""
    compressed: str
    """Compression mode: `file`, `message` or empty"""
    counts: dict[str, int]
    """Number of messages of each topic"""


def read_metadata(folder: Path) -> tuple[FolderMetadata | None, list[str]]:
    """Content of `metadata.yaml`, None if it is missing or unusable, and its faults as sentences."""
    try:
        content = read_yaml(folder / METADATA, LARGEST_METADATA)["rosbag2_bagfile_information"]
        topics = content["topics_with_message_count"]
        counts = {str(entry["topic_metadata"]["name"]): int(entry["message_count"]) for entry in topics}
        mode = str(content.get("compression_mode") or "").lower()
        files = list(dict.fromkeys(Path(name).name for name in content["relative_file_paths"]))
        return FolderMetadata(files, "" if mode == "none" else mode, counts), []
    except FileNotFoundError:
        return None, [f"{METADATA} is missing"]
    except (OSError, BadYamlError, LookupError, TypeError, ValueError, AttributeError, OverflowError):
        return None, [f"{METADATA} cannot be read"]


class FileFacts(NamedTuple):
    """Facts about one file of a bag, for `metadata.yaml`."""

    name: str
    """Name of the file"""
    first: int
    """Smallest log time [ns]"""
    last: int
    """Largest log time [ns]"""
    counts: Counter[str]
    """Number of messages of each topic"""

    def times(self) -> dict[str, Any]:
        """Start, duration and number of messages, under the keys of `metadata.yaml`."""
        return {
            "starting_time": {"nanoseconds_since_epoch": self.first},
            "duration": {"nanoseconds": self.last - self.first},
            "message_count": self.counts.total(),
        }


def information(files: Sequence[FileFacts], types: Mapping[str, str]) -> dict[str, Any]:
    """Content of `metadata.yaml` for a bag of these files; `types` is the message type of each topic."""
    total = sum((file.counts for file in files), Counter[str]())
    return with_topics(
        files,
        [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": OFFERED_QOS,
                    "type_description_hash": typestore().hash_rihs01(type_name),
                },
                "message_count": total[topic],
            }
            for topic, type_name in types.items()
        ],
    )


def with_topics(files: Sequence[FileFacts], topics: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Content of `metadata.yaml` for a bag of these files, with the given entries of its topics."""
    filled = [file for file in files if file.counts.total()]
    first, last = min((f.first for f in filled), default=0), max((f.last for f in filled), default=0)
    total = sum((file.counts for file in files), Counter[str]())
    return {
        "version": 9,
        "storage_identifier": "mcap",
        **FileFacts("", first, last, total).times(),
        "topics_with_message_count": list(topics),
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [{"path": file.name, **file.times()} for file in files],
        "custom_data": None,
        "ros_distro": "jazzy",
    }


class Identity(NamedTuple):
    """Properties by which an unchanged file is recognised."""

    inode: int
    """Number of the inode"""
    size: int
    """Size [B]"""
    modified: int
    """Time of the last modification [ns]"""


def prepare_metadata(
    folder: Path, content: dict[str, Any], ours: Identity | None = None
) -> Callable[[], Identity | None]:
    """Write a new `metadata.yaml` under another name, and return the function that puts it in place.

    `metadata.yaml` is whole at every moment, and that of another bag is left alone. The function returns the identity
    of the file it has put in place, or None if there is one of another bag. Given as `ours` to the next call, the
    identity saves reading the file, which takes as long as writing it.

    Args:
        folder: Folder of the bag.
        content: Content as `information` returns it.
        ours: Identity of the `metadata.yaml` that this process wrote last.

    Raises:
        OSError: The file cannot be written; an earlier one is unchanged.
    """
    metadata = folder / METADATA
    partial = partial_name(metadata.with_name(f"{METADATA}.{os.getpid()}"))  # others may write one at the same moment
    first = content["relative_file_paths"][0]
    if _is_of_another_bag(metadata, first, ours):
        return lambda: None
    write_new(partial, to_yaml({"rosbag2_bagfile_information": content}).encode())
    return lambda: _put(partial, metadata, first, ours)


def _put(partial: Path, metadata: Path, first_name: str, ours: Identity | None) -> Identity | None:
    """Rename `partial` to `metadata`, unless another bag has taken that name meanwhile."""
    if _is_of_another_bag(metadata, first_name, ours):
        partial.unlink()
        return None
    partial.replace(metadata)
    sync_folder(metadata.parent)
    return _identity(metadata)


def to_yaml(content: Any) -> str:
    """Content as YAML text, with the keys in the given order."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.representer.ignore_aliases = lambda _: True
    yaml.width = 1000
    text = io.StringIO()
    yaml.dump(content, text)
    return text.getvalue()


def _identity(path: Path) -> Identity | None:
    """Identity of a file; None if it does not exist."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return None
    return Identity(status.st_ino, status.st_size, status.st_mtime_ns)


def _is_of_another_bag(metadata: Path, first_name: str, ours: Identity | None) -> bool:
    """Whether there is a `metadata.yaml` that is unreadable, or whose first file is not `first_name`."""
    present = _identity(metadata)
    if present is None or present == ours:
        return False
    try:
        content = read_yaml(metadata, LARGEST_METADATA)
        return bool(content["rosbag2_bagfile_information"]["relative_file_paths"][0] != first_name)
    except (OSError, BadYamlError, KeyError, IndexError, TypeError):
        return True
