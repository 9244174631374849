"""What `metadata.yaml` of a rosbag2 folder says of its files, version 9."""

from __future__ import annotations

import io
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML

from knee_contact_ros.messages.ros_types import typestore
from knee_contact_ros.system.output_files import partial_name, sync_folder, write_new
from knee_contact_ros.system.yaml_file import LARGEST_METADATA, BadYamlError, read_yaml

METADATA = "metadata.yaml"
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
"""What the node and `replay` offer."""


class FileFacts(NamedTuple):
    """What there is to know of a file."""

    name: str
    first: int
    """Smallest stamp [ns]"""
    last: int
    """Largest stamp [ns]"""
    counts: Counter[str]
    """Messages by topic"""

    def times(self) -> dict[str, Any]:
        """As metadata has it."""
        return {
            "starting_time": {"nanoseconds_since_epoch": self.first},
            "duration": {"nanoseconds": self.last - self.first},
            "message_count": self.counts.total(),
        }


def information(files: Sequence[FileFacts], types: Mapping[str, str]) -> dict[str, Any]:
    """The content of `metadata.yaml` for a bag of these files; `types` gives the message type of every topic."""
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
    """The content of `metadata.yaml` for these files, with what there is to say of every topic."""
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
    """By which a file is known again."""

    number: int
    size: int
    """[B]"""
    changed: int
    """[ns]"""


def prepare_metadata(
    folder: Path, content: dict[str, Any], ours: Identity | None = None
) -> Callable[[], Identity | None]:
    """Write what is to stand in `metadata.yaml` beside a bag's files, and return what makes it stand there.

    `content` is as `information` gives it. There is a whole `metadata.yaml` at every moment; one of another bag is left
    alone. What makes it stand there returns what it is known by, None if another bag's does; given as `ours` to the
    next call, it need not be read then, which takes as long as to write it.

    Raises:
        OSError: it cannot be written; an earlier one is left as it was.
    """
    metadata = folder / METADATA
    partial = partial_name(metadata.with_name(f"{METADATA}.{os.getpid()}"))  # others may write one at the same moment
    first = content["relative_file_paths"][0]
    if _is_of_another_bag(metadata, first, ours):
        return lambda: None
    write_new(partial, to_yaml({"rosbag2_bagfile_information": content}).encode())
    return lambda: _put(partial, metadata, first, ours)


def _put(partial: Path, metadata: Path, first_name: str, ours: Identity | None) -> Identity | None:
    """Give a file its name for good, unless another bag's has it meanwhile."""
    if _is_of_another_bag(metadata, first_name, ours):
        partial.unlink()
        return None
    partial.replace(metadata)
    sync_folder(metadata.parent)
    return _identity(metadata)


def to_yaml(content: Any) -> str:
    """YAML text in the order of the content."""
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.representer.ignore_aliases = lambda _: True
    yaml.width = 1000
    text = io.StringIO()
    yaml.dump(content, text)
    return text.getvalue()


def _identity(path: Path) -> Identity | None:
    """None: there is nothing of that name."""
    try:
        found = path.lstat()
    except FileNotFoundError:
        return None
    return Identity(found.st_ino, found.st_size, found.st_mtime_ns)


def _is_of_another_bag(metadata: Path, first_name: str, ours: Identity | None) -> bool:
    """Whether something is there that does not say, in a way that can be read, that it belongs to ours."""
    found = _identity(metadata)
    if found is None or found == ours:
        return False
    try:
        content = read_yaml(metadata, LARGEST_METADATA)
        return bool(content["rosbag2_bagfile_information"]["relative_file_paths"][0] != first_name)
    except (OSError, BadYamlError, KeyError, IndexError, TypeError):
        return True
