"""Signals that tell a node's process to stop."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MEANINGLESS = (signal.SIGUSR1, signal.SIGUSR2, signal.SIGALRM, signal.SIGVTALRM, signal.SIGPROF, signal.SIGPIPE)
"""Signals that would end a process that does not care for them"""
LOST_PERIOD = 0.01
"""How long [s] after an interruption was lost the next one is tried"""


class Stop:
    """The signals that end the node: noted; while the model compiles the first one interrupts. Others do not end it."""

    def __init__(self) -> None:
        self.asked = False
        self._interrupts = False
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if (number, signal.getsignal(number)) != (signal.SIGHUP, signal.SIG_IGN):  # as nohup has it
                signal.signal(number, self._on_signal)
        for number in MEANINGLESS:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def interrupting(self) -> Iterator[None]:
        """Let the first signal raise KeyboardInterrupt meanwhile; so does one that has come before.

        What is raised in a finalizer or in a callback from C, of which the compiler has many, is lost: it is raised
        again a little later.
        """
        self._interrupts, told = True, sys.unraisablehook

        def on_lost(lost: Any) -> None:
            if not issubclass(lost.exc_type, KeyboardInterrupt):
                told(lost)
                return
            self._interrupts = True
            threading.Timer(LOST_PERIOD, os.kill, (os.getpid(), signal.SIGINT)).start()

        sys.unraisablehook = on_lost
        try:
            if self.asked:
                raise KeyboardInterrupt
            yield
        finally:
            self._interrupts, sys.unraisablehook = False, told

    def _on_signal(self, _number: int, _frame: object) -> None:
        self.asked = True
        if self._interrupts:
            self._interrupts = False  # another one must not interrupt what clears up behind this one
            raise KeyboardInterrupt
