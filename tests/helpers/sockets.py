"""What a process listens on and is connected to."""

from __future__ import annotations

from typing import Any

import psutil


def internet_sockets(process: psutil.Process) -> list[Any]:
    """Its sockets of the internet; psutil before 6, as in Ubuntu 24.04, has another name for them."""
    ask = process.net_connections if hasattr(process, "net_connections") else process.connections
    return list(ask(kind="inet"))
