"""Libraries of the extra `notebook`, which need not be installed."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import not_installed


def library(name: str) -> Any:
    """Import a library of the extra.

    Raises:
        UsageError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise UsageError(not_installed(name.partition(".")[0], "notebook")) from None
