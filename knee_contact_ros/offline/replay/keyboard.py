"""Single keys from the terminal while a command runs; the terminal is restored afterwards, whatever happens.

The terminal is put into cbreak mode: keys come at once and without echo, Ctrl-C and Ctrl-Z keep their meaning. It is
in this mode only while this process is in the foreground: it is restored before Ctrl-Z stops the process, and put into
the mode again when the process continues.
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from types import FrameType
from typing import Any


class Command(Enum):
    """Commands that keys give."""

    PAUSE = "pause or go on"
    STEP = "one message while paused"
    FASTER = "faster"
    SLOWER = "slower"


COMMANDS = {
    b" ": Command.PAUSE,
    b"s": Command.STEP,
    b"\x1b[C": Command.STEP,
    b"\x1b[A": Command.FASTER,
    b"\x1b[B": Command.SLOWER,
}
HELP = "space: pause, s: step, up/down: rate"
KEY = re.compile(rb"\x1b[\[O][A-Z]|.", re.DOTALL)
LONGEST_WAIT = 0.2
"""Time [s] after which to look whether this process is in the foreground"""


class Keyboard:
    """Keys of the terminal at standard input; without a terminal no key is ever pressed."""

    def __init__(self, stood_still: Callable[[float], None]) -> None:
        """Call `stood_still` with the time [s] for which the process was stopped, whenever it continues."""
        self._input = sys.stdin.fileno() if has_terminal() else None
        self._stood_still = stood_still
        self._usual: list[Any] | None = None  # the terminal's modes while it is ours
        self._stop_handler: Any = None

    def __enter__(self) -> Keyboard:
        if self._input is not None:
            if signal.getsignal(signal.SIGTSTP) == signal.SIG_DFL:  # a shell without job control has it ignored
                self._stop_handler = signal.signal(signal.SIGTSTP, self._on_stop)
            self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._give_back()
        if self._stop_handler is not None:
            signal.signal(signal.SIGTSTP, self._stop_handler)

    def wait(self, seconds: float) -> list[Command]:
        """Wait for keys, for `seconds` at most; return their commands."""
        if self._usual is None:
            time.sleep(min(seconds, LONGEST_WAIT))
            self._take()
            return []
        if self._input is None or not select.select([self._input], [], [], min(seconds, LONGEST_WAIT))[0]:
            return []
        return self._pressed()

    def _pressed(self) -> list[Command]:
        """Return the commands of the keys that were pressed."""
        keys = b""
        with suppress(OSError):  # the terminal is gone
            keys = os.read(self._input or 0, 1024)
        if not keys:
            self._input = self._usual = None
        sequences = (key.group().replace(b"\x1bO", b"\x1b[") for key in KEY.finditer(keys))
        return [COMMANDS[key] for key in sequences if key in COMMANDS]

    def _take(self) -> None:
        """Put the terminal into cbreak mode if this process is in the foreground; the kernel stops others that try."""
        if self._input is not None and self._usual is None and in_foreground(self._input):
            self._usual = termios.tcgetattr(self._input)
            tty.setcbreak(self._input, termios.TCSANOW)

    def _give_back(self) -> None:
        """Restore the modes of the terminal."""
        if self._input is not None and self._usual is not None:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._input, termios.TCSANOW, self._usual)
        self._usual = None

    def _on_stop(self, number: int, _frame: FrameType | None) -> None:
        """Stop the process with the terminal restored; the handler returns when the process continues."""
        began = time.perf_counter()
        self._give_back()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._on_stop)
        self._take()
        self._stood_still(time.perf_counter() - began)


def has_terminal() -> bool:
    """Return whether standard input is a terminal."""
    return sys.stdin is not None and not sys.stdin.closed and sys.stdin.isatty()


def in_foreground(terminal: int) -> bool:
    """Return whether this process is in the foreground of a terminal, or the terminal controls no process."""
    try:
        return os.tcgetpgrp(terminal) == os.getpgrp()
    except OSError:
        return True


@contextmanager
def unwinding_on_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the process by an exception, so that context managers restore everything."""

    def end(number: int, _frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    ours = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)
