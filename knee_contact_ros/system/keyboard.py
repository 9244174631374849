"""Keys of the terminal, of POSIX systems.

The terminal is put into cbreak mode, in which keys come immediately and without echo, and Ctrl-C and Ctrl-Z keep their
meaning. It is in this mode only while this process is in the foreground. It is always restored at the end, and before
Ctrl-Z stops the process.
"""

from __future__ import annotations

import os
import re
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from types import FrameType
from typing import Any

_KEY = re.compile(rb"\x1b\[[A-Z]|.", re.DOTALL)
_FOREGROUND_PERIOD = 0.2
"""Time [s] after which to look again whether this process is in the foreground"""


class Keyboard:
    """Keys of the terminal at standard input; without a terminal no key is ever pressed."""

    def __init__(self, on_continue: Callable[[float], None]) -> None:
        """Call `on_continue` with the time [s] for which the process was stopped, whenever it continues."""
        self._terminal = sys.stdin.fileno() if has_terminal() else None
        self._on_continue = on_continue
        self._saved_modes: list[Any] | None = None
        """The terminal's modes while it is in cbreak mode"""
        self._stop_handler: Any = None

    def __enter__(self) -> Keyboard:
        # A shell without job control ignores SIGTSTP.
        if self._terminal is not None and signal.getsignal(signal.SIGTSTP) == signal.SIG_DFL:
            self._stop_handler = signal.signal(signal.SIGTSTP, self._on_stop)
        self._enter_cbreak()
        return self

    def __exit__(self, *_: object) -> None:
        self._restore()
        if self._stop_handler is not None:
            signal.signal(signal.SIGTSTP, self._stop_handler)

    def wait_for_keys(self, seconds: float) -> list[bytes]:
        """Wait for keys, for `seconds` at most; return them, an arrow as `ESC [ A` and the like."""
        self._enter_cbreak()
        if self._terminal is None or self._saved_modes is None:
            time.sleep(min(seconds, _FOREGROUND_PERIOD))
            return []
        if not select.select([self._terminal], [], [], min(seconds, _FOREGROUND_PERIOD))[0]:
            return []
        keys = b""
        with suppress(OSError):
            keys = os.read(self._terminal, 1024)
        # A terminal that is gone gives nothing, at once.
        if not keys:
            self._terminal = self._saved_modes = None
        return _KEY.findall(keys.replace(b"\x1bO", b"\x1b["))

    def _enter_cbreak(self) -> None:
        """Put the terminal into cbreak mode if this process is in the foreground; the kernel stops others that try."""
        if (
            self._terminal is not None
            and self._saved_modes is None
            and in_foreground(self._terminal)
        ):
            self._saved_modes = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal, termios.TCSANOW)

    def _restore(self) -> None:
        """Restore the modes of the terminal."""
        if self._terminal is not None and self._saved_modes is not None:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._terminal, termios.TCSANOW, self._saved_modes)
        self._saved_modes = None

    def _on_stop(self, number: int, _frame: FrameType | None) -> None:
        """Stop the process with the terminal restored; the handler returns when the process continues."""
        began = time.perf_counter()
        self._restore()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._on_stop)
        self._enter_cbreak()
        self._on_continue(time.perf_counter() - began)


def has_terminal() -> bool:
    """Return whether standard input is a terminal."""
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def in_foreground(terminal: int) -> bool:
    """Return whether this process is in the foreground of a terminal, or the terminal controls no process."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True
