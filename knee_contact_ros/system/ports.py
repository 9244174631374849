"""TCP ports of this machine."""

from __future__ import annotations

import socket

from knee_contact_ros.system.errors import UsageError

LOCALHOST = "127.0.0.1"


def free_port(address: str = LOCALHOST) -> int:
    """Find a port that no process listens on at an address of this machine."""
    with socket.socket() as probe:
        probe.bind((address, 0))
        return int(probe.getsockname()[1])


def refuse_taken(port: int, name: str) -> None:
    """Check that a port can be listened on; `name` is the parameter or option that gave it.

    Raises:
        UsageError: another process listens on it, or it is not allowed.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server does: closed connections linger
        try:
            probe.bind((LOCALHOST, port))
        except OSError as error:
            raise UsageError(f"{name}: {port} on {LOCALHOST}: {error.strerror}") from None
