"""Destinations of a scene: a Rerun file, or viewers that connect to this machine."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
"""Memory that a server keeps for viewers that connect later; older data is dropped first"""


class RerunFile:
    """An `.rrd` file with its blueprint; it appears under its final name when it is complete."""

    def __init__(
        self, path: Path, drawings: Sequence[KneeOutlines], latency: bool = False, overwrite: bool = False
    ) -> None:
        """Open a file for these knees; `latency` says whether their answers have latencies.

        Raises:
            UsageError: the file cannot be written; see `claim` and `open_claimed`.
        """
        self.path, self._overwrite = path, overwrite
        self.name = str(path)
        self._partial = claim(path, overwrite)
        self._file = PipedFile(open_claimed(self._partial))
        self.recording = rr.RecordingStream(APPLICATION)
        self.recording.save(self._file.name, default_blueprint=blueprint(drawings, latency))
        self._file.begin()

    def flush(self) -> None:
        """Hand over all data that waits, and check that earlier data was written.

        Raises:
            OSError: data could not be written.
        """
        self.recording.flush()
        self._file.check()

    def close(self) -> None:
        """Complete the file and give it its name.

        Raises:
            OSError: the file is not complete.
        """
        self.recording.flush()
        self.recording.disconnect()
        self._file.close()
        self.path = take_name(self._partial, self.path, self._overwrite)
        self.name = str(self.path)

    def discard(self) -> None:
        """Give up, and remove the file."""
        self.recording.disconnect()
        self._partial.unlink(missing_ok=True)


class Served:
    """A server on this machine, to which viewers connect; it never waits for a viewer."""

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
        """Hand over all data that waits to the server."""
        self.recording.flush()

    def close(self) -> None:
        """End the server; viewers keep the data that they have."""
        self.recording.flush()
        self.recording.disconnect()
        self._gate.close()

    discard = close


Outlet = RerunFile | Served
"""A destination of a scene"""
