"""The extras, libraries that not every command needs: how to get them. The package is in no index."""

from __future__ import annotations

import sys
from pathlib import Path

from knee_contact_ros.system.resources import share_folder


def not_installed(library: str, extra: str) -> str:
    """What there is to say of a library that is not there."""
    return f"{library} is not installed; {how_to_get(extra)}"


def how_to_get(extra: str) -> str:
    """Which command brings an extra, and where to say it."""
    source = share_folder()
    if Path(sys.prefix) == source / ".venv":
        return f"in {source}: .venv/bin/uv pip install -e '.[{extra}]'"
    return f"in the folder of the package's sources: {sys.executable} -m pip install '.[{extra}]'"
