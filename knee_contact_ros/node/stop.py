"""Signals that stop the process of a node."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MEANINGLESS = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, signal.SIGPIPE)
"""Signals without a meaning for a node, which would end a process that does not handle them"""
LOST_PERIOD = 0.01
"""Time [s] after which a lost interruption is repeated"""


class Stop:
    """Handler of the signals that end the node: SIGINT, SIGTERM and SIGHUP. Other ones do not end it.

    As a rule a signal is only noted (`requested`); while the model compiles, the first one interrupts.
    """

    def __init__(self) -> None:
        self.requested = False
        self._interrupts = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if (number, signal.getsignal(number)) != (signal.SIGHUP, signal.SIG_IGN):  # as nohup has it
                signal.signal(number, self._on_signal)
        for number in MEANINGLESS:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Let the first signal raise KeyboardInterrupt within the `with` block, at once if it has come before.

        An exception in a finalizer or in a callback from C, of which the compiler has many, is lost: it is raised again
        a little later.
        """
        self._interrupts, previous_hook = True, sys.unraisablehook

        def on_lost(lost: Any) -> None:
            if not issubclass(lost.exc_type, KeyboardInterrupt):
                previous_hook(lost)
                return
            self._interrupts = True
            threading.Timer(LOST_PERIOD, os.kill, (os.getpid(), signal.SIGINT)).start()

        sys.unraisablehook = on_lost
        try:
            if self.requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._interrupts, sys.unraisablehook = False, previous_hook

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.requested = True
        if self._interrupts:
            self._interrupts = False  # another one must not interrupt the cleaning up after this one
            raise KeyboardInterrupt
