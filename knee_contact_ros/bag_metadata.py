"""What `metadata.yaml` of a rosbag2 folder says of its files, version 9."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from knee_contact_ros.messages import typestore
from knee_contact_ros.outputs import partial_name

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
    """Of a bag that consists of these files; `types` gives the message type of every topic."""
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
    """The same with what there is to say of every topic."""
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


def prepare_metadata(folder: Path, content: dict[str, Any]) -> Callable[[], object]:
    """Write what is to stand in `metadata.yaml` beside a bag's files, and return what makes it stand there.

    `content` is as `information` gives it. There is a whole `metadata.yaml` at every moment; one of another bag is left
    alone.

    Raises:
        OSError: it cannot be written; an earlier one is left as it was.
    """
    metadata = folder / METADATA
    if metadata.exists() and _is_of_another_bag(metadata, content["relative_file_paths"][0]):
        return lambda: None
    partial = partial_name(metadata)
    try:
        partial.write_text(to_yaml({"rosbag2_bagfile_information": content}), encoding="utf-8")
    except OSError:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    return lambda: partial.replace(metadata)


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


def _is_of_another_bag(metadata: Path, first_name: str) -> bool:
    try:
        content = YAML(typ="safe", pure=True).load(metadata.read_text(encoding="utf-8"))
        return bool(content["rosbag2_bagfile_information"]["relative_file_paths"][0] != first_name)
    except (YAMLError, KeyError, IndexError, TypeError):
        return True
