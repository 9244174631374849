"""The scene as an output of a node: a Rerun file, or a server for viewers on this machine; and Rerun's viewer.

`sink_for` describes it to the node, `open_output` opens it in a process of its own. Rerun is large, so that only what
runs there imports it. Its viewer is a process that is found, started and watched; all servers of it listen on 127.0.0.1
only, as Rerun's own default is every interface.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from threading import Thread
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ..model.types import ROW
from ..streams.output import RecordedKnee, Sink
from ..streams.topics import KNEE_CONTACT, Ending, knee_name
from ..system import output_files
from ..system.errors import IncompleteError, UsageError
from ..system.files import not_installed
from ..system.processes import (
    LOCALHOST,
    Process,
    check_port_free,
    free_port,
    running,
    start_process,
)
from .anatomy import KneeOutlines, compartment_names, outlines_of_compartments

if TYPE_CHECKING:
    from .scene import Scene

APPLICATION = "knee_contact_ros"
VIEWER_NICENESS = 10
"""Niceness of a scene's process: unlike a recorder, whose unwritten data can be lost, it may wait for all others"""
FILE_GATHER = 0.25
"""Time [s] for which answers are gathered before they are sent to the scene's process, for a file"""
LIVE_GATHER = 0.05
"""The same, for a live viewer"""
SERVED_MEMORY = "64MB"
"""Memory that a server keeps for viewers that connect later; older data is dropped first"""
MAX_BATCH = 4000
"""Number of answers shown at a time: a message to Rerun costs as much as hundreds of answers"""
FILE_PERIOD = 1.0
"""Longest time [s] that a batch waits to be full, for a file"""
LIVE_PERIOD = 0.1
"""The same, for a live viewer"""
MESSAGE_PAUSE = 0.0005
"""Pause [s] between two messages to Rerun while a node runs, which then gets the processor"""
PIPE_SIZE = 1 << 16
"""Bytes that a pipe holds"""
NOT_INSTALLED = not_installed("rerun-sdk", "viewer")
DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")
MEMORY_LIMIT = "1GB"
"""Memory that a node's viewer may take; older data is dropped first"""
VIEWER_NAMES = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
"""Names of the viewer in its package, on Linux, Windows and macOS"""
VIEWER_ENVIRONMENT = {"NO_COLOR": "1"}
"""Environment variables of a viewer, whose output is then without colours"""
LOW_PRIORITY_PREFIX = (
    ("env", "--default-signal=INT,TERM", "nice", "-n", "10") if sys.platform == "linux" else ()
)
"""Prefix of the command of a node's viewer, which runs at low priority, so that no tick waits for it, and obeys signals
that the process of a scene ignores"""
VIEWER_EXIT_TIMEOUT = 5.0
"""Time [s] that a viewer may take to end"""


def sink_for(knee: RecordedKnee) -> Sink | None:
    """Describe the process that writes a Rerun file or serves a scene; None if drawing is off.

    Raises:
        UsageError: Rerun is not installed, or the knee's name is not among those that share the viewer.
    """
    rerun = knee.parameters.rerun
    name = knee_name(knee.names[KNEE_CONTACT])
    models = tuple(knee.models.values())
    if rerun.mode == "off":
        return None
    require_viewer(f"parameter rerun.mode: {rerun.mode}: ")
    knees = tuple(one.strip() for one in rerun.knees.split(",")) if rerun.knees else ()
    if knees and (name not in knees or "" in knees):
        raise UsageError(
            f"parameter rerun.knees: {rerun.knees!r} is not allowed; this knee, {name}, must be one of them"
        )
    path = Path(rerun.path) if rerun.mode == "file" else None
    own = compartment_names(name, models)
    if len(models) > 1:  # each is a knee of its own to a viewer
        knees = tuple(part for one in knees or (name,) for part in compartment_names(one, models))
    drawings = outlines_of_compartments(models, own, knee.parameters.body_weight)
    arguments = path, drawings, rerun.port, rerun.mode == "spawn", knees
    kind = "Rerun recording" if path else f"Rerun scene on port {rerun.port}"
    gather = FILE_GATHER if path else LIVE_GATHER
    return Sink(
        "viewer", kind, str(path or ""), __name__, arguments, "row", True, VIEWER_NICENESS, gather
    )


def open_output(
    path: Path | None,
    own: Sequence[KneeOutlines],
    port: int = 0,
    spawn: bool = False,
    knees: Sequence[str] = (),
) -> Viewer:
    """Open the output for a knee of one or two compartments: a file, or a server if there is no `path`.

    Args:
        path: Rerun file to write; None: serve the scene.
        own: Outlines of the compartments.
        port: Port of this machine's loopback interface, to serve on.
        spawn: Whether to open a viewer on this machine, too.
        knees: Names of all knees that share the viewer, with this one's; empty: this knee has the viewer for itself.

    Raises:
        UsageError: the output cannot be opened; see `RerunFile`, `serve` and `ViewerWindow`.
    """
    from .scene import Scene

    remarks: list[str] = []
    known = {drawing.knee: drawing for drawing in own}
    among = list(known)
    file = None
    window = None
    if path:
        output_files.check_writable(path)
        name = next(output_files.free_names(path))
        if name != path:
            remarks.append(f"{path} is there already: this Rerun recording is {name}")
        remarks += map(
            output_files.cut_off_message, output_files.unfinished_files(path.parent, ".rrd")
        )
        file = RerunFile(name, own, latency=True)
        recording = file.recording
    else:
        # The others' surfaces are not known here; where they are looked at is much the same.
        among = list(knees) or among
        drawings = [known.get(name, own[0]._replace(knee=name)) for name in among]
        recording = serve(port, drawings, "+".join(knees) or None)
        window = ViewerWindow(server_address(port)) if spawn else None
    scenes = [
        Scene(recording, one, latency=True, pause=MESSAGE_PAUSE, forgetful=not path, among=among)
        for one in own
    ]
    return Viewer(recording, scenes, file, remarks, window)


class Viewer:
    """An output (see `streams/output.py`) that shows answers in batches."""

    def __init__(
        self,
        recording: Any,
        scenes: Sequence[Scene],
        file: RerunFile | None,
        remarks: Sequence[str],
        window: ViewerWindow | None,
    ) -> None:
        """Show each compartment in one of the `scenes`, which write to Rerun's `recording`, perhaps one in a `file`.

        `remarks` are messages to the user about the opening, and `window` is the viewer on this machine, if one was
        opened.
        """
        self.period, self.name = (FILE_PERIOD, str(file.path)) if file else (LIVE_PERIOD, "")
        self._recording = recording
        self._scenes = scenes
        self._file = file
        self._window = window
        self._remarks = tuple(remarks)
        self._batch: list[bytes] = []

    def write(self, parts: Sequence[bytes]) -> None:
        """Add the rows of answers to the batch, and show it if it is full."""
        self._batch += parts
        if len(self._batch) >= MAX_BATCH:
            self._show()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Show a note on something that happened between two answers."""
        self._show()
        for scene in self._scenes:
            scene.note(name, values)

    def flush(self) -> None:
        """Show the waiting answers, and hand them over."""
        self._show()
        self._recording.flush()
        if self._file:
            self._file.check()

    def news(self) -> tuple[str, ...]:
        """Return messages to the user, each once: remarks, and that the viewer on this machine has ended."""
        news = self._remarks
        self._remarks = ()
        return news + (self._window.news() if self._window else ())

    def finish(self, ending: Ending | None) -> None:  # noqa: ARG002  (inputs alone are not shown)
        """Show the waiting answers, and complete the file; viewers of a server keep the data that they have."""
        self._show()
        for scene in self._scenes:
            scene.finish()
        if self._file:
            self._file.close()
            self.name = str(self._file.path)
        else:
            self._recording.flush()
            self._recording.disconnect()

    def _show(self) -> None:
        if self._batch:
            rows = np.frombuffer(b"".join(self._batch), ROW)
            for first, scene in enumerate(self._scenes):
                scene.show(rows[first :: len(self._scenes)])
            self._batch = []


def serve(port: int, drawings: Sequence[KneeOutlines], recording_id: str | None) -> Any:
    """Serve a Rerun recording on 127.0.0.1, to which viewers connect; it never waits for a viewer.

    A viewer that is connected to several servers merges recordings with the same `recording_id`.

    Raises:
        UsageError: the port is taken.
    """
    import rerun as rr

    from .layout import blueprint

    check_port_free(port, "parameter rerun.port")
    recording = rr.RecordingStream(APPLICATION, recording_id=recording_id)
    server = rr.GrpcServerSink(bind_ip=LOCALHOST, port=port, server_memory_limit=SERVED_MEMORY)
    recording.set_sinks(server, default_blueprint=blueprint(drawings, latency=True, follow=True))
    return recording


class RerunFile:
    """An `.rrd` file with its blueprint; it appears under its final name when it is complete.

    Rerun's thread for files ends at an error, such as a full disk, and waiting for it may then last forever. So it
    writes into a pipe, which gives it no errors, and our own thread writes the file. On Windows a pipe has no path, and
    Rerun writes the file.
    """

    def __init__(
        self,
        path: Path,
        drawings: Sequence[KneeOutlines],
        latency: bool = False,
        overwrite: bool = False,
    ) -> None:
        """Open a file for these knees; `latency` says whether their answers have latencies.

        Raises:
            UsageError: the file cannot be written; see `claim`.
        """
        import rerun as rr

        from .layout import blueprint

        self.path = path
        """Name of the file, which may change when it is complete"""
        self._overwrite = overwrite
        self._partial = output_files.partial_name(path)
        self._file = output_files.claim(path, overwrite)
        self._error: OSError | None = None
        self._thread = None
        self.recording = rr.RecordingStream(APPLICATION)
        drawn = blueprint(drawings, latency)
        if sys.platform == "win32":
            self.recording.save(self._partial, default_blueprint=drawn)
            return
        source, sink = os.pipe()
        self._thread = Thread(target=self._copy, args=[source], name="Rerun file", daemon=True)
        self._thread.start()
        self.recording.save(f"/dev/fd/{sink}", default_blueprint=drawn)
        os.close(sink)  # Rerun has opened it: the copy is complete when Rerun closes it

    def check(self) -> None:
        """Raise the error of earlier data that could not be written.

        Raises:
            OSError: there was one.
        """
        if self._error:
            raise self._error

    def close(self) -> None:
        """Complete the file and give it its name.

        Raises:
            OSError: the file is not complete.
        """
        self.recording.flush()
        self._end_writing()
        self.check()
        self.path = output_files.take_name(self._partial, self.path, self._overwrite)

    def discard(self) -> None:
        """Give up, and remove the file."""
        self._end_writing()
        self._partial.unlink(missing_ok=True)

    def _end_writing(self) -> None:
        self.recording.disconnect()
        if self._thread:
            self._thread.join()
        self._file.close()

    def _copy(self, descriptor: int) -> None:
        """Write all that comes until the pipe is closed; after an error, which is kept, drop it."""
        with os.fdopen(descriptor, "rb", buffering=0) as source:
            try:
                with self._file as file:  # a network disk may report an error when it is closed
                    while data := source.read(PIPE_SIZE):
                        file.write(data)
                        file.flush()
            except OSError as error:
                error.filename = str(self._partial)
                self._error = error
                while source.read(PIPE_SIZE):
                    pass


class ViewerWindow:
    """A viewer of what is served at an address. This process starts it; it keeps running after this process exits."""

    def __init__(self, address: str) -> None:
        """Start the viewer.

        Raises:
            UsageError: Rerun is not installed, or there is no screen.
        """
        require_display("parameter rerun.mode can be serve or file")
        self._address = address
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  (the viewer writes to it as long as it lives)
        self._process: Process | None = start_process(
            connect_command([address]),
            self._log,
            start_new_session=True,
            env=os.environ | VIEWER_ENVIRONMENT,
        )

    def news(self) -> tuple[str, ...]:
        """Return a message that the viewer has ended, once."""
        if self._process is None or (code := self._process.poll()) is None:
            return ()
        self._process = None
        still = f"the scene is still served: knee-contact view {self._address}"
        return (f"the Rerun viewer {_ending(code, self._log)}; {still}",)


def server_address(port: int) -> str:
    """Return the address at which a viewer connects to a server of this machine."""
    return f"rerun+http://{LOCALHOST}:{port}/proxy"


def find_viewer() -> Path | None:
    """Return Rerun's viewer, wherever Python finds its package; None if it is not installed.

    Rerun's library for Python is in the same package: either both are installed or neither.
    """
    package = find_spec("rerun_cli")
    folders = package.submodule_search_locations or () if package else ()
    places = (Path(folder) / name for folder in folders for name in VIEWER_NAMES)
    return next((path for path in places if path.exists()), None)


def require_viewer(wanted: str = "") -> Path:
    """Return Rerun's viewer; `wanted` begins the message of the error.

    Raises:
        UsageError: Rerun is not installed.
    """
    path = find_viewer()
    if path is None:
        raise UsageError(f"{wanted}{NOT_INSTALLED}")
    return path


def has_display() -> bool:
    """Return whether this process can open windows on a screen."""
    return sys.platform in ("win32", "darwin") or any(
        os.environ.get(name) for name in DISPLAY_VARIABLES
    )


def require_display(instead: str) -> None:
    """Refuse to open a viewer without a screen; the error says what to do `instead`.

    Raises:
        UsageError: there is no screen.
    """
    if not has_display():
        raise UsageError(f"there is no screen for a viewer (DISPLAY is not set); {instead}")


def viewer_command(*options: str, port: int = 0) -> list[str]:
    """Return the command of a viewer whose own server only this machine can reach.

    It gets a `port`, by default a free one: at a port in use, the viewer would send its data to the other process.

    Raises:
        UsageError: Rerun is not installed.
    """
    server = ("--bind", LOCALHOST, "--port", str(port or free_port()))
    return [str(require_viewer()), *server, *options]


def connect_command(addresses: Sequence[str]) -> list[str]:
    """Return the command of a viewer that shows the scenes served at addresses."""
    return [*LOW_PRIORITY_PREFIX, *viewer_command("--memory-limit", MEMORY_LIMIT, *addresses)]


def run_viewer(command: Sequence[str]) -> None:
    """Run the command of a viewer until it ends.

    Raises:
        IncompleteError: the viewer failed.
    """
    with tempfile.TemporaryFile() as log:
        environment = os.environ | VIEWER_ENVIRONMENT
        with running(command, log, VIEWER_EXIT_TIMEOUT, env=environment) as process:
            code = process.wait()
        if code:
            raise IncompleteError(f"the Rerun viewer {_ending(code, log)}")


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
