"""Rerun's own viewer as a process on this machine, bound to the loopback interface."""

from __future__ import annotations

import os
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from knee_contact_ros.errors import UsageError

LOCALHOST = "127.0.0.1"
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
MEMORY = "1GB"
"""What a viewer beside a node may take; older data goes first"""
LOCAL = ("--bind", LOCALHOST)
ANY_PORT = ("--port", "0")
"""Of the viewer's own server: with a port that is taken it would take the other for a viewer and send it its data"""


class Window:
    """A viewer that was started."""

    def __init__(self, process: subprocess.Popen[bytes], log: IO[bytes], still: str) -> None:
        """`log` is what it says; `still` how to see the scene without it."""
        self.process = process
        self._log, self._still = log, still
        self._told = False

    def news(self) -> tuple[str, ...]:
        """That it has ended, once."""
        code = self.process.poll()
        if code is None or self._told:
            return ()
        self._told = True
        why = ""
        if code:
            why = f" with code {code} ({last_line(self._log)})"
        return (f"the Rerun viewer has ended{why}; {self._still}",)

    def close(self) -> None:
        """End it."""
        self.process.terminate()


def address(port: int) -> str:
    """What a viewer connects to."""
    return f"rerun+http://{LOCALHOST}:{port}/proxy"


def executable() -> Path:
    """Rerun's viewer.

    Raises:
        UsageError: it is not there.
    """
    path = Path(sysconfig.get_path("purelib")) / "rerun_cli" / "rerun"
    if not path.exists():
        raise UsageError(f"Rerun's viewer is not at {path}: pip install rerun-sdk")
    return path


def refuse_blind() -> None:
    """Tell that a viewer could not be seen.

    Raises:
        UsageError: this machine has no screen.
    """
    if not any(os.environ.get(name) for name in SCREENS):
        raise UsageError("there is no screen (DISPLAY is not set): save or serve the scene instead")


def last_line(log: IO[bytes]) -> str:
    """The last that a process has said."""
    log.seek(0)
    lines = log.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else "it said nothing"


def connect_command(addresses: Sequence[str]) -> list[str]:
    """What opens a viewer that shows what is served at some addresses."""
    return [str(executable()), *LOCAL, *ANY_PORT, "--memory-limit", MEMORY, *addresses]


def open_window(address: str) -> Window:
    """Start a viewer that shows what is served at an address; it stays when this process ends.

    Raises:
        UsageError: there is none on this machine, or no screen.
    """
    refuse_blind()
    log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
    command = connect_command([address])
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)
    return Window(process, log, f"the scene is still served: knee-contact view {address}")
