"""Rerun's viewer as a process on this machine: found, started and watched; its time cursor set.

All servers of it listen on 127.0.0.1 only; Rerun's own default is every interface.
"""

from __future__ import annotations

import os
import signal
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import IO, Any

import numpy as np

from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.files import not_installed
from knee_contact_ros.system.processes import LOCALHOST, Process, free_port, kept, start

NOT_INSTALLED = not_installed("rerun-sdk", "viewer")
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
MEMORY_LIMIT = "1GB"
"""Memory that a viewer beside a node may take; older data is dropped first"""
IN_BACKGROUND = ("env", "--default-signal=INT,TERM", "nice", "-n", "10")
"""Beginning of the command of a viewer beside a node: it runs at low priority, as a tick must not wait for it, and it
heeds signals that the process of a scene ignores"""
END, LOAD = 5.0, 60.0
"""Times [s] that a viewer may take to end, and to load a file"""
PAUSE = 0.1
"""Time [s] between two requests for the viewer's state"""


class Window:
    """A viewer that this process started and that shows what is served at an address."""

    def __init__(self, address: str) -> None:
        """Start the viewer; it stays open when this process ends.

        Raises:
            UsageError: Rerun is not installed, or there is no screen.
        """
        refuse_blind("parameter rerun.mode can be serve or file")
        self._address, self._reported = address, False
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
        self._process: Process = start(connect_command([address]), self._log, env=plain(), start_new_session=True)

    def news(self) -> tuple[str, ...]:
        """Return a message that the viewer has ended, once."""
        code = self._process.poll()
        if code is None or self._reported:
            return ()
        self._reported = True
        still = f"the scene is still served: knee-contact view {self._address}"
        return (f"the Rerun viewer {_ending(code, self._log)}; {still}",)

    def close(self) -> None:
        """End the viewer."""
        self._process.terminate()


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
    """Refuse to open a viewer without a screen, and say what to do `instead`.

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

    It gets a port of its own: at one that is taken, it would send its data to the other process.
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
    """Show a Rerun file in a window, at its largest load, until the window is closed.

    Raises:
        UsageError: Rerun is not installed.
        IncompleteError: the viewer failed.
    """
    port = free_port()
    Thread(target=_put_on_peak, args=(path, address(port)), name="cursor", daemon=True).start()
    look([str(executable()), *on_loopback(port), str(path)])


def peak_of(path: Path) -> Any:
    """Return when the load of any knee in a Rerun file is largest; among equal loads, when the contact force is.

    Where no load is drawn, the contact force counts. It is a `datetime64` or a `timedelta64`, as the timeline shows
    dates or durations; None if the file has no curves of forces.
    """
    from rerun.chunk import RrdReader

    from knee_contact_ros.view.layout import CURVES, FORCE_NUMBER, FORCES, LOAD_NUMBER, TIMELINE

    peaks: list[tuple[float, float, Any]] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.endswith(f"/{CURVES}/{FORCES}") and not chunk.is_static:
            batch = chunk.to_record_batch()
            curves = np.nan_to_num(np.array(batch.column("Scalars:scalars").to_pylist()), nan=-np.inf)
            force = curves[:, FORCE_NUMBER]
            load = curves[:, LOAD_NUMBER] if curves.shape[1] > LOAD_NUMBER else force  # none where the height drives
            best = int(np.lexsort((-np.arange(len(load)), force, load))[-1])
            peaks.append((float(load[best]), float(force[best]), batch.column(TIMELINE).to_numpy()[best]))
    return max(peaks)[-1] if peaks else None


def _put_on_peak(path: Path, viewer: str) -> None:
    """Set the cursor of a viewer to the largest load, once it has loaded the file; errors are ignored.

    A file cannot do it (Rerun 0.41), but a program can.
    """
    from rerun.experimental import ViewerClient

    from knee_contact_ros.view.layout import TIMELINE

    with suppress(Exception):  # nothing depends on it: the viewer may be gone, or the file be none of ours
        moment, end = peak_of(path), time.monotonic() + LOAD
        while moment is not None and time.monotonic() < end:
            with suppress(Exception):  # nobody answers yet; the library raises what it likes
                client = ViewerClient.connect(viewer)
                state = client.get_state()
                if state.views and not state.loading and any(item.timelines for item in state.recordings):
                    break
            time.sleep(PAUSE)
        if moment is not None:
            kind = "timestamp" if isinstance(moment, np.datetime64) else "duration"
            client.set_time(TIMELINE, **{kind: moment}, play_state="paused")


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
