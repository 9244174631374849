"""Rerun's own viewer as a process on this machine, bound to the loopback interface."""

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
MEMORY = "1GB"
"""What a viewer beside a node may take; older data goes first"""
BEHIND = ("env", "--default-signal=INT,TERM", "nice", "-n", "10")
"""Before the command of a viewer beside a node: it may wait, a tick may not; and it heeds signals that the process of a
scene does not"""
ANY_PORT = ("--port", "0")
"""Of the viewer's own server: with a port that is taken it would take the other for a viewer and send it its data"""


class Window:
    """A viewer that was started."""

    def __init__(self, process: Process, log: IO[bytes], still: str) -> None:
        """`log` is what it says; `still` how to see the scene without it."""
        self.process = process
        self._log, self._still = log, still
        self._told = False

    def news(self) -> tuple[str, ...]:
        """Say once that the viewer has ended."""
        code = self.process.poll()
        if code is None or self._told:
            return ()
        self._told = True
        return (f"the Rerun viewer {ending(code, self._log)}; {self._still}",)

    def close(self) -> None:
        """End it."""
        self.process.terminate()


def address(port: int) -> str:
    """What a viewer connects to."""
    return f"rerun+http://{LOCALHOST}:{port}/proxy"


def viewer() -> Path | None:
    """Rerun's viewer, wherever Python finds its package: in the environment, or in the user's own packages.

    Rerun's library for Python is in the same package: without the one there is none of the other.
    """
    package = find_spec("rerun_cli")
    folders = package.submodule_search_locations or () if package else ()
    return next((path for folder in folders if (path := Path(folder) / "rerun").exists()), None)


def executable(wanted: str = "") -> Path:
    """Rerun's viewer; `wanted` is what asks for it.

    Raises:
        UsageError: it is not installed.
    """
    path = viewer()
    if path is None:
        raise UsageError(f"{wanted}{NOT_INSTALLED}")
    return path


class Hidden(NamedTuple):
    """Where the viewer's own server listens: it answers whoever finds it."""

    address: str
    port: int

    @property
    def options(self) -> tuple[str, ...]:
        """For the viewer."""
        return "--bind", self.address, "--port", str(self.port)

    @property
    def url(self) -> str:
        """For programs that tell it what to show."""
        return f"rerun+http://{self.address}:{self.port}/proxy"


def hidden() -> Hidden:
    """A place that nobody else knows, and that is free."""
    address = unguessable_address()
    return Hidden(address, free_port(address))


def has_screen() -> bool:
    """Whether this machine shows windows to whoever started this process."""
    return any(os.environ.get(name) for name in SCREENS)


def refuse_blind(instead: str) -> None:
    """Tell that a viewer could not be seen, and what to do `instead`.

    Raises:
        UsageError: this machine has no screen.
    """
    if not has_screen():
        raise UsageError(f"there is no screen for a viewer (DISPLAY is not set); {instead}")


def ending(code: int, log: IO[bytes]) -> str:
    """How a viewer that said something to `log` has ended."""
    if code < 0:
        return f"was ended by {signal.Signals(-code).name}"
    if not code:
        return "has ended"
    log.seek(0)
    lines = log.read().decode(errors="replace").strip().splitlines()
    told = [line for line in lines if "error" in line.lower()] or lines or ["it said nothing"]
    return f"has ended with code {code} ({told[-1].strip()})"


def uncoloured() -> dict[str, str]:
    """The environment of a viewer that says what it says without colours."""
    return os.environ | {"NO_COLOR": "1"}


def connect_command(addresses: Sequence[str]) -> list[str]:
    """What opens a viewer that shows what is served at some addresses."""
    return [*BEHIND, str(executable()), *hidden().options, "--memory-limit", MEMORY, *addresses]


def open_window(address: str) -> Window:
    """Start a viewer that shows what is served at an address; it stays when this process ends.

    Raises:
        UsageError: there is none on this machine, or no screen.
    """
    refuse_blind("parameter rerun.mode can be serve or file")
    log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
    command = connect_command([address])
    process = start(command, log, env=uncoloured(), start_new_session=True)
    return Window(process, log, f"the scene is still served: knee-contact view {address}")
