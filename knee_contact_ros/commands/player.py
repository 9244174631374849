"""Gives the messages of a bag when they are due, obeys keys, and measures how late each was. Needs no ROS.

The terminal is put into cbreak mode, in which keys come immediately and without echo, and Ctrl-C and Ctrl-Z keep their
meaning. It is in this mode only while this process is in the foreground. It is always restored at the end, and before
Ctrl-Z stops the process.
"""

from __future__ import annotations

import math
import os
import re
import select
import signal
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum
from types import FrameType
from typing import Any

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.streams.messages import stamp_in
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.terminal import say


class Command(Enum):
    """Commands that keys give."""

    PAUSE = "pause or go on"
    STEP = "one message while paused"
    FASTER = "faster"
    SLOWER = "slower"


KEYS = {
    b" ": Command.PAUSE,
    b"s": Command.STEP,
    b"\x1b[C": Command.STEP,
    b"\x1b[A": Command.FASTER,
    b"\x1b[B": Command.SLOWER,
}
HELP = "space: pause, s: step, up/down: rate"
KEY = re.compile(rb"\x1b\[[A-Z]|.", re.DOTALL)
LONGEST_LOOK = 0.2
"""Time [s] after which to look whether this process is in the foreground"""


class Keyboard:
    """Keys of the terminal at standard input; without a terminal no key is ever pressed."""

    def __init__(self, stood_still: Callable[[float], None]) -> None:
        """Call `stood_still` with the time [s] for which the process was stopped, whenever it continues."""
        self._terminal = sys.stdin.fileno() if has_terminal() else None
        self._stood_still = stood_still
        self._usual: list[Any] | None = None  # the terminal's modes while it is ours
        self._stop_handler: Any = None

    def __enter__(self) -> Keyboard:
        # A shell without job control ignores SIGTSTP.
        if self._terminal is not None and signal.getsignal(signal.SIGTSTP) == signal.SIG_DFL:
            self._stop_handler = signal.signal(signal.SIGTSTP, self._on_stop)
        self._take()
        return self

    def __exit__(self, *_: object) -> None:
        self._give_back()
        if self._stop_handler is not None:
            signal.signal(signal.SIGTSTP, self._stop_handler)

    def wait(self, seconds: float) -> list[Command]:
        """Wait for keys, for `seconds` at most; return their commands."""
        self._take()
        if self._terminal is None or self._usual is None:
            time.sleep(min(seconds, LONGEST_LOOK))
            return []
        if not select.select([self._terminal], [], [], min(seconds, LONGEST_LOOK))[0]:
            return []
        keys = b""
        with suppress(OSError):
            keys = os.read(self._terminal, 1024)
        if not keys:  # the terminal is gone
            self._terminal = self._usual = None
        return [KEYS[key] for key in KEY.findall(keys.replace(b"\x1bO", b"\x1b[")) if key in KEYS]

    def _take(self) -> None:
        """Put the terminal into cbreak mode if this process is in the foreground; the kernel stops others that try."""
        if self._terminal is not None and self._usual is None and in_foreground(self._terminal):
            self._usual = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal, termios.TCSANOW)

    def _give_back(self) -> None:
        """Restore the modes of the terminal."""
        if self._terminal is not None and self._usual is not None:
            with suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._terminal, termios.TCSANOW, self._usual)
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

    ours = [
        number
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) == signal.SIG_DFL
    ]
    for number in ours:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


LEAST_RATE, LARGEST_RATE = 0.01, 100.0
RATE_STEP = 1.1
"""Factor by which a key multiplies or divides the rate"""
MARGIN = 1e-4
"""Time [s] that a sleep may take too long; the rest of the time to a message is waited for in a loop"""
LONGEST_WAIT = 1.0
"""Longest single wait [s]"""
LOOK_PERIOD = 0.05
"""Time [s] after which keys are checked even if messages are always due"""
LONGEST_PAUSE = 600 * NANOSECONDS
"""Longest pause [ns] that is waited for"""
JITTER = 1_000_000
"""Time [ns] by which log times may go back without a clock that was set"""


def sleep(seconds: float) -> Sequence[Command]:
    """Wait for a time [s] where there are no keys."""
    time.sleep(seconds)
    return ()


def paced(messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, int]]:
    """Messages with the times [ns] at which they are due: log times, and where these are equal as the stamps go on."""
    last, begins = -1, dict[str, int]()
    for message in messages:
        if message.log_time != last:
            last, begins = message.log_time, {}
        try:
            stamp = stamp_in(message.data)
        except ValueError:
            stamp = begins.get(message.topic, 0)
        step = stamp - begins.setdefault(message.topic, stamp)
        yield message, message.log_time + (step if 0 < step <= LONGEST_PAUSE else 0)


@dataclass
class Player:
    """Plays messages one after another.

    The bag's time is known at one moment, the beginning or the last change. All other times are computed from there, so
    that rounding errors do not accumulate.
    """

    wait: Callable[[float], Sequence[Command]] = sleep
    """Function that waits for a time [s] or shorter, and returns the commands of the keys pressed meanwhile"""
    rate: float = 1.0
    """Seconds of the bag per second"""
    paused: bool = False
    changed: Callable[[float, bool], None] = lambda _rate, _paused: None
    """Called with rate and pause whenever a key changes one of them"""
    tell_time: Callable[[int], None] = lambda _time: None
    """Called with the bag's time [ns] at the rate `clock_rate`"""
    clock_rate: float = 0.0
    """Rate [Hz] of the clock; 0: there is none"""

    def __post_init__(self) -> None:
        """Begin with no message."""
        self._bag, self._clock = 0, 0.0  # the bag's time [ns] at a time of the clock [s]
        self._tick = math.inf  # when the clock is published again
        self._look = 0.0
        self._commands: deque[Command] = deque()

    def play(self, messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, float | None]]:
        """Yield each message when it is due, the first at once, and how late [s] that is.

        The delay is None for a message to which a key stepped. A pause in the bag that is too long is skipped.
        """
        last = None
        for message, due in paced(messages):
            if last is None:
                self._set(due)
                self._tick = self._clock if self.clock_rate else math.inf
            elif (
                not -JITTER <= due - last <= LONGEST_PAUSE
            ):  # a clock was set, or nothing came for long
                if due > last:
                    say(
                        f"the bag pauses for {(due - last) / NANOSECONDS:.6g} s, which is skipped",
                        err=True,
                    )
                self._set(due)
            last = due
            yield message, self._wait_for(due)

    def stood_still(self, seconds: float) -> None:
        """Leave out a time [s] for which the process was stopped."""
        self._clock += seconds

    def _set(self, time_of_bag: int) -> None:
        """Let the bag's time [ns] be now."""
        self._bag, self._clock = time_of_bag, time.perf_counter()

    def _at(self, now: float) -> int:
        """Return the bag's time [ns] at `now` [s] of the clock."""
        return (
            self._bag
            if self.paused
            else self._bag + round((now - self._clock) * NANOSECONDS * self.rate)
        )

    def _wait_for(self, time_of_bag: int) -> float | None:
        """Wait until a message is due; return how late [s] it is then, None if a key has stepped to it."""
        while True:
            now = time.perf_counter()
            if now >= self._tick:
                self.tell_time(self._at(now))
                period = 1.0 / self.clock_rate
                self._tick = period + (self._tick if self._tick + period > now else now)
            due = (
                math.inf
                if self.paused
                else self._clock + (time_of_bag - self._bag) / NANOSECONDS / self.rate
            )
            if due <= now < self._look:
                return now - due
            if not self._commands:
                self._wait_precisely(min(due, self._tick), now)
            while self._commands:
                command = self._commands.popleft()
                if command is Command.STEP and self.paused:
                    self._set(time_of_bag)
                    return None
                self._obey(command)

    def _wait_precisely(self, end: float, now: float) -> None:
        """Wait until `end` [s] at most: asleep, and shortly before it in a loop."""
        if end - now > MARGIN or now >= self._look:
            self._commands += self.wait(max(0.0, min(end - now - MARGIN, LONGEST_WAIT)))
            self._look = time.perf_counter() + LOOK_PERIOD
        while time.perf_counter() < end <= now + MARGIN:
            pass

    def _obey(self, command: Command) -> None:
        """Change rate or pause from now on."""
        self._set(self._at(time.perf_counter()))
        if command is Command.PAUSE:
            self.paused = not self.paused
        elif command is not Command.STEP:
            factor = RATE_STEP if command is Command.FASTER else 1.0 / RATE_STEP
            self.rate = min(max(self.rate * factor, LEAST_RATE), LARGEST_RATE)
        self.changed(self.rate, self.paused)


LATE = 1e-3
"""Delay [s] above which a message counts as late"""


@dataclass
class Lateness:
    """Counts published messages, and measures how much later than due they were."""

    messages: int = 0
    late: int = 0
    largest: float = 0.0
    """Largest delay [s]"""
    drift: float = 0.0
    """Delay [s] of the last message"""

    def add(self, seconds: float | None) -> None:
        """Count a message that was `seconds` late; None: a key stepped to it, and it is never late."""
        self.messages, self.drift = self.messages + 1, seconds or 0.0
        self.late += self.drift > LATE
        self.largest = max(self.largest, self.drift)

    def __str__(self) -> str:
        """Return the report as one line."""
        percent = 100.0 * self.late / max(self.messages, 1)
        return (
            f"{self.messages} messages published, {self.late} ({percent:.3g} %) later than {1e3 * LATE:g} ms, "
            f"the latest by {1e3 * self.largest:.2f} ms; drift at the end {1e3 * self.drift:.2f} ms"
        )
