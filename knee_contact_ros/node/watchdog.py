"""Notices that a node stands still: the service manager restarts it, and `/diagnostics` says so."""

import os
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Event, Thread

SIGN_PERIOD = 1.0
"""Time [s] between two signs of life, and between two looks for them"""
STANDSTILL = 3.0
"""Time [s] without a sign of life from which the node stands still"""


class Watchdog:
    """Gets a sign of life from the thread that works, and looks in a thread of its own how old the last one is."""

    def __init__(self, reports: Sequence[Callable[[float], None]]) -> None:
        """Tell the service manager that all is ready; `reports` are called with the time [s] of a standstill."""
        self._reports = reports
        self._last = time.monotonic()
        self._done = Event()
        notify("READY=1")
        Thread(target=self._look, name="watchdog", daemon=True).start()

    def note_life(self) -> None:
        """Note that the working thread works, and tell the service manager."""
        now = time.monotonic()
        if now >= self._last + SIGN_PERIOD:
            self._last = now
            notify("WATCHDOG=1")

    def end(self) -> None:
        """Tell the service manager that the nodes end, and look no more."""
        self._done.set()
        notify("STOPPING=1")

    def _look(self) -> None:
        while not self._done.wait(SIGN_PERIOD):
            age = time.monotonic() - self._last
            for report in self._reports if age > STANDSTILL else ():
                report(age)


def notify(state: str) -> None:
    """Tell a state to the service manager that started the process, if it asked for that (`sd_notify`)."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if address:
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(state.encode(), address.replace("@", "\0", 1))
