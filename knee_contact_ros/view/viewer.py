"""Rerun's viewer as a process on this machine: found, started and watched.

All servers of it listen on 127.0.0.1 only; Rerun's own default is every interface.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import IO

from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.files import not_installed
from knee_contact_ros.system.processes import LOCALHOST, Process, free_port, kept, start

NOT_INSTALLED = not_installed("rerun-sdk", "viewer")
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
MEMORY_LIMIT = "1GB"
"""Memory that a node's viewer may take; older data is dropped first"""
IN_BACKGROUND = ("env", "--default-signal=INT,TERM", "nice", "-n", "10")
"""Prefix of the command of a node's viewer, which runs at low priority, so that no tick waits for it, and obeys signals
that the process of a scene ignores"""
END = 5.0
"""Time [s] that a viewer may take to end"""


class Window:
    """A viewer that this process started and that shows what is served at an address; it stays when we end."""

    def __init__(self, address: str) -> None:
        """Start the viewer.

        Raises:
            UsageError: Rerun is not installed, or there is no screen.
        """
        refuse_blind("parameter rerun.mode can be serve or file")
        self._address = address
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
        self._process: Process | None = start(
            connect_command([address]), self._log, env=plain(), start_new_session=True
        )

    def news(self) -> tuple[str, ...]:
        """Return a message that the viewer has ended, once."""
        if self._process is None or (code := self._process.poll()) is None:
            return ()
        self._process = None
        still = f"the scene is still served: knee-contact view {self._address}"
        return (f"the Rerun viewer {_ending(code, self._log)}; {still}",)


def address(port: int) -> str:
    """Return the address at which a viewer connects to a server of this machine."""
    return f"rerun+http://{LOCALHOST}:{port}/proxy"


def viewer() -> Path | None:
    """Return Rerun's viewer, wherever Python finds its package; None if it is not installed.

    Rerun's library for Python is in the same package: either both are installed or neither.
    """
    package = find_spec("rerun_cli")
    folders = package.submodule_search_locations or () if package else ()
    return next((path for folder in folders if (path := Path(folder) / "rerun").exists()), None)


def executable(wanted: str = "") -> Path:
    """Return Rerun's viewer; `wanted` begins the message of the error.

    Raises:
        UsageError: Rerun is not installed.
    """
    path = viewer()
    if path is None:
        raise UsageError(f"{wanted}{NOT_INSTALLED}")
    return path


def has_screen() -> bool:
    """Return whether this process can open windows on a screen."""
    return any(os.environ.get(name) for name in SCREENS)


def refuse_blind(instead: str) -> None:
    """Refuse to open a viewer without a screen; the error says what to do `instead`.

    Raises:
        UsageError: there is no screen.
    """
    if not has_screen():
        raise UsageError(f"there is no screen for a viewer (DISPLAY is not set); {instead}")


def plain() -> dict[str, str]:
    """Return the environment of a viewer whose output has no colours."""
    return os.environ | {"NO_COLOR": "1"}


def on_loopback(port: int) -> tuple[str, ...]:
    """Return the options that make the viewer's own server listen on a port of this machine only."""
    return "--bind", LOCALHOST, "--port", str(port)


def connect_command(addresses: Sequence[str]) -> list[str]:
    """Return the command of a viewer that shows the scenes served at addresses.

    It gets its own port: at a port in use, it would send its data to the other process.
    """
    viewer = [str(executable()), *on_loopback(free_port()), "--memory-limit", MEMORY_LIMIT]
    return [*IN_BACKGROUND, *viewer, *addresses]


def look(command: Sequence[str]) -> None:
    """Run the command of a viewer until it ends.

    Raises:
        IncompleteError: the viewer failed.
    """
    with tempfile.TemporaryFile() as log:
        with kept(command, log, END, env=plain()) as process:
            code = process.wait()
        if code:
            raise IncompleteError(f"the Rerun viewer {_ending(code, log)}")


def look_at(path: Path) -> None:
    """Show a Rerun file in a window until the window is closed.

    Raises:
        UsageError: Rerun is not installed.
        IncompleteError: the viewer failed.
    """
    look([str(executable()), *on_loopback(free_port()), str(path)])


def _ending(code: int, log: IO[bytes]) -> str:
    """Return how a viewer has ended, as text, with the last error in its `log`."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    if not code:
        return "has ended"
    log.seek(0)
    lines = log.read().decode(errors="replace").strip().splitlines()
    reasons = [line for line in lines if "error" in line.lower()] or lines or ["it said nothing"]
    return f"has ended with code {code} ({reasons[-1].strip()})"
