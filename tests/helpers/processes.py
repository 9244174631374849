"""Whether processes of others have ended."""

from __future__ import annotations

import psutil

NO_BYTECODE = {"PYTHONDONTWRITEBYTECODE": "1"}
"""Environment of a Python that may write no large file: it would leave modules' bytecode cut off for all after it"""


def has_ended(process: psutil.Process) -> bool:
    """Whether it works no more; one whose parent is gone is a zombie until the system takes note."""
    try:
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
