"""`metadata.yaml` of a rosbag2 folder: what counts of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.system.yaml_file import LARGEST_METADATA, BadYamlError, read_yaml

METADATA = "metadata.yaml"


class FolderMetadata(NamedTuple):
    """What counts of `metadata.yaml`."""

    files: list[str]
    """Names"""
    compressed: str
    """How the whole is compressed: `file`, `message` or empty"""
    counts: dict[str, int]
    """Messages by topic"""


def read_metadata(folder: Path) -> tuple[FolderMetadata | None, list[str]]:
    """What `metadata.yaml` says, None if it is of no use, and what is wrong with it."""
    try:
        content = read_yaml(folder / METADATA, LARGEST_METADATA)
        return _understood(content["rosbag2_bagfile_information"]), []
    except FileNotFoundError:
        return None, [f"{METADATA} is missing"]
    except (OSError, BadYamlError, LookupError, TypeError, ValueError, AttributeError, OverflowError):
        return None, [f"{METADATA} cannot be read"]


def _understood(content: dict[str, Any]) -> FolderMetadata:
    topics = content["topics_with_message_count"]
    counts = {str(entry["topic_metadata"]["name"]): int(entry["message_count"]) for entry in topics}
    compressed = str(content.get("compression_mode") or "").lower()
    files = list(dict.fromkeys(Path(name).name for name in content["relative_file_paths"]))
    return FolderMetadata(files, "" if compressed == "none" else compressed, counts)
