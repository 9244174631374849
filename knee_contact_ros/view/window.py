"""Rerun's viewer as a process on this machine, bound to the loopback interface."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import IO, NamedTuple

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import not_installed
from knee_contact_ros.system.ports import LOCALHOST, free_port
from knee_contact_ros.system.processes import Process, start
from knee_contact_ros.view.visitors import unguessable_address

NOT_INSTALLED = not_installed("rerun-sdk", "viewer")
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
MEMORY_LIMIT = "1GB"
"""Memory that a viewer beside a node may take; older data is dropped first"""
BEHIND = ("env", "--default-signal=INT,TERM", "nice", "-n", "10")
"""Beginning of the command of a viewer beside a node: it runs at low priority, as a tick must not wait for it, and it
heeds signals that the process of a scene ignores"""
ANY_PORT = ("--port", "0")
"""Options for the viewer's own server: at a port that is taken, it would send its data to the other process"""


class Window:
    """A viewer that this process started."""

    def __init__(self, process: Process, log: IO[bytes], still: str) -> None:
        """Watch a process; `log` has its output, and `still` says how to see the scene without it."""
        self.process = process
        self._log, self._still = log, still
        self._told = False

    def news(self) -> tuple[str, ...]:
        """Return a message that the viewer has ended, once."""
        code = self.process.poll()
        if code is None or self._told:
            return ()
        self._told = True
        return (f"the Rerun viewer {ending(code, self._log)}; {self._still}",)

    def close(self) -> None:
        """End the viewer."""
        self.process.terminate()


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


class Hidden(NamedTuple):
    """Address and port of the viewer's own server, which answers everybody who finds it."""

    address: str
    port: int

    @property
    def options(self) -> tuple[str, ...]:
        """Options that make the viewer listen there."""
        return "--bind", self.address, "--port", str(self.port)

    @property
    def url(self) -> str:
        """Address for programs that control the viewer."""
        return f"rerun+http://{self.address}:{self.port}/proxy"


def hidden() -> Hidden:
    """Return an address that nobody can guess, and a free port there."""
    address = unguessable_address()
    return Hidden(address, free_port(address))


def has_screen() -> bool:
    """Return whether this process can open windows on a screen."""
    return any(os.environ.get(name) for name in SCREENS)


def refuse_blind(instead: str) -> None:
    """Refuse to open a viewer without a screen, and say what to do `instead`.

    Raises:
        UsageError: there is no screen.
    """
    if not has_screen():
        raise UsageError(f"there is no screen for a viewer (DISPLAY is not set); {instead}")


def ending(code: int, log: IO[bytes]) -> str:
    """Return how a viewer has ended, as text, with the last error in its `log`."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    if not code:
        return "has ended"
    log.seek(0)
    lines = log.read().decode(errors="replace").strip().splitlines()
    reasons = [line for line in lines if "error" in line.lower()] or lines or ["it said nothing"]
    return f"has ended with code {code} ({reasons[-1].strip()})"


def uncoloured() -> dict[str, str]:
    """Return the environment of a viewer whose output has no colours."""
    return os.environ | {"NO_COLOR": "1"}


def connect_command(addresses: Sequence[str]) -> list[str]:
    """Return the command of a viewer that shows the scenes served at addresses."""
    return [*BEHIND, str(executable()), *hidden().options, "--memory-limit", MEMORY_LIMIT, *addresses]


def open_window(address: str) -> Window:
    """Start a viewer that shows the scene served at an address; it stays open when this process ends.

    Raises:
        UsageError: Rerun is not installed, or there is no screen.
    """
    refuse_blind("parameter rerun.mode can be serve or file")
    log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
    command = connect_command([address])
    process = start(command, log, env=uncoloured(), start_new_session=True)
    return Window(process, log, f"the scene is still served: knee-contact view {address}")
