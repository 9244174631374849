"""How to install the extras, libraries that not every command needs. The package is in no package index."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import share_folder


def require(extra: str, *libraries: str) -> None:
    """Check that libraries of an extra are installed; none is imported.

    Raises:
        UsageError: one is missing.
    """
    for library in libraries:
        if find_spec(library) is None:
            raise UsageError(not_installed(library, extra))


def not_installed(library: str, extra: str) -> str:
    """Message for a missing library of an extra."""
    return f"{library} is not installed; {how_to_get(extra)}"


def how_to_get(extra: str) -> str:
    """Command that installs an extra, and the folder in which to run it."""
    source = share_folder()
    if Path(sys.prefix) == source / ".venv":
        return f"in {source}: .venv/bin/uv pip install -e '.[{extra}]'"
    return f"in the folder of the package's sources: {sys.executable} -m pip install '.[{extra}]'"
