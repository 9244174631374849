"""Where a scene goes: into a file, or to viewers that connect to this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import rerun as rr

from knee_contact_ros.system.output_files import claim, open_claimed, take_name
from knee_contact_ros.system.ports import free_port, refuse_taken
from knee_contact_ros.view.gate import Gate
from knee_contact_ros.view.layout import blueprint
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.piped import PipedFile
from knee_contact_ros.view.visitors import unguessable_address

APPLICATION = "knee_contact_ros"
SERVED_MEMORY = "64MB"
"""What is kept for viewers that connect later; older data goes first"""


class Outlet(Protocol):
    """Takes a recording."""

    recording: rr.RecordingStream
    name: str
    """Of the file; empty if it is none"""

    def flush(self) -> None:
        """Leave nothing for later."""

    def close(self) -> None:
        """Complete it."""

    def discard(self) -> None:
        """Leave nothing behind."""


class RerunFile:
    """An `.rrd` file with its blueprint; it appears under its final name when it is complete."""

    def __init__(
        self, path: Path, drawings: Sequence[KneeOutlines], latency: bool = False, overwrite: bool = False
    ) -> None:
        """Open the file for these knees; `latency` says whether there will be some.

        Raises:
            UsageError: see `claim` and `open_claimed`.
        """
        self.path, self._overwrite = path, overwrite
        self.name = str(path)
        self._partial = claim(path, overwrite)
        self._file = PipedFile(open_claimed(self._partial))
        self.recording = rr.RecordingStream(APPLICATION)
        self.recording.save(self._file.name, default_blueprint=blueprint(drawings, latency))
        self._file.begin()

    def flush(self) -> None:
        """Hand over all that was shown, and tell whether what came before was written.

        Raises:
            OSError: it was not.
        """
        self.recording.flush()
        self._file.check()

    def close(self) -> None:
        """Complete the file and give it its name.

        Raises:
            OSError: it is not complete.
        """
        self.recording.flush()
        self.recording.disconnect()
        self._file.close()
        self.path = take_name(self._partial, self.path, self._overwrite)
        self.name = str(self.path)

    def discard(self) -> None:
        """Give up: leave no file behind."""
        self.recording.disconnect()
        self._partial.unlink(missing_ok=True)


class Served:
    """A server on this machine, to which viewers connect; without any, and with one that stands still, all goes on."""

    name = ""

    def __init__(self, port: int, drawings: Sequence[KneeOutlines], recording_id: str | None = None) -> None:
        """Listen on the loopback interface; pages of other sites are refused (403).

        Rerun's own server answers everybody, so it gets an address that nobody can guess.

        Recordings of one `recording_id` are one in a viewer that is connected to several servers.

        Raises:
            UsageError: the port is taken.
        """
        refuse_taken(port, "parameter rerun.port")
        self.recording = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        inner = unguessable_address()
        inner_port = free_port(inner)
        server = rr.GrpcServerSink(bind_ip=inner, port=inner_port, server_memory_limit=SERVED_MEMORY)
        self.recording.set_sinks(server, default_blueprint=blueprint(drawings, latency=True, follow=True))
        self._gate = Gate(port, (inner, inner_port))

    def flush(self) -> None:
        """Hand over what waits to the server."""
        self.recording.flush()

    def close(self) -> None:
        """Serve no more; viewers keep what they have."""
        self.recording.flush()
        self.recording.disconnect()
        self._gate.close()

    discard = close
