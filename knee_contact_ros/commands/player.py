"""Publishes the messages of a bag when they are due, obeys keys, and measures how late each was. Needs no ROS.

For keys the terminal is put into cbreak mode: they come at once and without echo, Ctrl-C and Ctrl-Z keep their meaning.
It is in this mode only while this process is in the foreground: it is restored before Ctrl-Z stops the process, put
into the mode again when the process continues, and restored at the end, whatever happens.
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
from enum import Enum
from types import FrameType
from typing import Any

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.streams.messages import stamp_in
from knee_contact_ros.streams.topics import NANOSECONDS


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
LONGEST_LOOK = 0.2
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
            time.sleep(min(seconds, LONGEST_LOOK))
            self._take()
            return []
        if self._input is None or not select.select([self._input], [], [], min(seconds, LONGEST_LOOK))[0]:
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


class Schedule:
    """Relation of the bag's time to the time of a clock.

    Both are known at one moment, the beginning or the last change. All other times are computed from there, so that
    rounding errors do not accumulate.
    """

    def __init__(self, begin: int, rate: float, now: float, *, paused: bool = False) -> None:
        """Begin at the bag's time `begin` [ns] and the clock's `now` [s], with `rate` seconds of the bag per second."""
        self.rate = rate
        self.paused = paused
        self._bag = begin
        self._clock = now

    def due(self, log_time: int) -> float:
        """Return the time [s] of the clock at which a time of the bag [ns] is due, without further pauses."""
        return self._clock + (log_time - self._bag) / NANOSECONDS / self.rate

    def at(self, now: float) -> int:
        """Return the bag's time [ns] at `now` [s] of the clock."""
        return self._bag if self.paused else self._bag + round((now - self._clock) * NANOSECONDS * self.rate)

    def pause(self, now: float) -> None:
        """Stop the bag's time at `now` [s] of the clock."""
        self._bag, self._clock, self.paused = self.at(now), now, True

    def resume(self, now: float) -> None:
        """Continue the bag's time at `now` [s] of the clock."""
        self._clock, self.paused = now, False

    def change_rate(self, rate: float, now: float) -> None:
        """Continue at another rate from `now` [s] of the clock on."""
        self._bag, self._clock, self.rate = self.at(now), now, rate

    def step_to(self, log_time: int, now: float) -> None:
        """Set the bag's time [ns] at `now` [s] of the clock."""
        self._bag, self._clock = log_time, now

    def stood_still(self, seconds: float) -> None:
        """Leave out a time [s] for which the whole process was stopped."""
        self._clock += seconds


LEAST_RATE, LARGEST_RATE = 0.01, 100.0
RATE_STEP = 1.1
"""Factor by which a key multiplies or divides the rate"""
MARGIN = 1e-4
"""Time [s] that a sleep may take too long; the rest of the time to a message is waited for in a loop"""
LONGEST_WAIT = 1.0
"""Longest wait [s] at once"""
LOOK_PERIOD = 0.05
"""Time [s] after which keys are looked for although messages are due all the time"""

Wait = Callable[[float], Sequence[Command]]
"""Function that waits for a time [s] or shorter, and returns the commands of the keys pressed meanwhile"""


def sleep(seconds: float) -> Sequence[Command]:
    """Wait for a time [s] where there are no keys."""
    time.sleep(seconds)
    return ()


LONGEST_PAUSE = 600 * NANOSECONDS
"""Longest pause [ns] that is waited for"""
JITTER = 1_000_000
"""Time [ns] by which log times may go back without a clock that was set"""


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


class Player:
    """Plays messages one after another."""

    def __init__(
        self,
        publish: Callable[[RawMessage], None],
        wait: Wait = sleep,
        *,
        rate: float = 1.0,
        paused: bool = False,
        changed: Callable[[float, bool], None] = lambda _rate, _paused: None,
    ) -> None:
        """Publish by `publish`, at `rate` in seconds of the bag per second.

        `changed` is called with rate and pause whenever a key changes one of them.
        """
        self.rate = rate
        self.paused = paused
        self._publish = publish
        self._wait = wait
        self._changed = changed
        self.skipped: Callable[[float], None] = lambda _pause: None
        """Called with a pause [s] that is left out"""
        self._schedule: Schedule | None = None
        self._publish_clock: Callable[[int], None] | None = None
        self._clock_period = 0.0
        self._clock_began = 0.0
        self._clock_due = math.inf
        self._look = 0.0
        self._commands: deque[Command] = deque()

    def drive_clock(self, publish_clock: Callable[[int], None], rate: float) -> None:
        """Call `publish_clock` with the bag's time [ns] at `rate` [Hz]; 0: before every message."""
        self._publish_clock = publish_clock
        self._clock_period = 1.0 / rate if rate else 0.0

    def play(self, messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, float | None]]:
        """Publish each message when it is due, the first at once; yield the message and how late [s] it was.

        The delay is None for a message to which a key stepped.
        """
        self._schedule = None
        for message, due in paced(messages):
            if self._schedule is None:
                self._schedule, last = self._begin(due), due
            if not -JITTER <= due - last <= LONGEST_PAUSE:  # a clock was set, or nothing came for long
                if due > last:
                    self.skipped((due - last) / NANOSECONDS)
                self._schedule.step_to(due, time.perf_counter())
            last = due
            late = self._wait_for(due, self._schedule)
            if self._publish_clock and not self._clock_period:
                self._publish_clock(message.log_time)
            self._publish(message)
            yield message, late

    def stood_still(self, seconds: float) -> None:
        """Leave out a time [s] for which the process was stopped."""
        if self._schedule:
            self._schedule.stood_still(seconds)

    def _begin(self, log_time: int) -> Schedule:
        now = time.perf_counter()
        if self._clock_period:
            self._clock_began = self._clock_due = now
        return Schedule(log_time, self.rate, now, paused=self.paused)

    def _wait_for(self, log_time: int, schedule: Schedule) -> float | None:
        """Wait until a message is due; return how late [s] it is then, None if a key has stepped to it."""
        while True:
            now = time.perf_counter()
            if now >= self._clock_due:
                self._publish_time(schedule, now)
            due = math.inf if schedule.paused else schedule.due(log_time)
            if due <= now < self._look:
                return now - due
            if not self._commands:
                self._wait_precisely(min(due, self._clock_due), now)
            while self._commands:
                command = self._commands.popleft()
                if command is Command.STEP and schedule.paused:
                    schedule.step_to(log_time, time.perf_counter())
                    return None
                self._obey(command, schedule)

    def _wait_precisely(self, end: float, now: float) -> None:
        """Wait until `end` [s] at most: asleep, and shortly before it in a loop."""
        if end - now > MARGIN or now >= self._look:
            self._commands += self._wait(max(0.0, min(end - now - MARGIN, LONGEST_WAIT)))
            self._look = time.perf_counter() + LOOK_PERIOD
            return
        while time.perf_counter() < end:
            pass

    def _publish_time(self, schedule: Schedule, now: float) -> None:
        """Publish the bag's time, and plan the next time to do so."""
        if self._publish_clock:
            self._publish_clock(schedule.at(now))
        periods = math.floor((now - self._clock_began) / self._clock_period + 1e-6)
        self._clock_due = self._clock_began + (periods + 1) * self._clock_period

    def _obey(self, command: Command, schedule: Schedule) -> None:
        now = time.perf_counter()
        if command is Command.PAUSE:
            (schedule.resume if schedule.paused else schedule.pause)(now)
        elif command in (Command.FASTER, Command.SLOWER):
            rate = schedule.rate * RATE_STEP if command is Command.FASTER else schedule.rate / RATE_STEP
            schedule.change_rate(min(max(rate, LEAST_RATE), LARGEST_RATE), now)
        self.rate, self.paused = schedule.rate, schedule.paused
        self._changed(self.rate, self.paused)


LATE = 1e-3
"""Delay [s] above which a message counts as late"""
MS = 1e3


class Lateness:
    """Counts published messages, and measures how much later than due they were."""

    def __init__(self) -> None:
        self.messages = 0
        self.late = 0
        self.largest = 0.0
        """Largest delay [s]"""
        self.drift = 0.0
        """Delay [s] of the last message of a pass through the bag, the largest of all passes"""
        self._last = 0.0

    def add(self, seconds: float | None) -> None:
        """Count a message that was `seconds` late; None: a key stepped to it, and it is never late."""
        self.messages += 1
        self._last = seconds or 0.0
        if self._last > LATE:
            self.late += 1
        self.largest = max(self.largest, self._last)

    def end(self) -> None:
        """Note the end of a pass through the bag."""
        self.drift = max(self.drift, self._last)
        self._last = 0.0

    def __str__(self) -> str:
        """Return the report as one line."""
        percent = 100.0 * self.late / max(self.messages, 1)
        return (
            f"{self.messages} messages published, {self.late} ({percent:.3g} %) later than {LATE * MS:g} ms, "
            f"the latest by {self.largest * MS:.2f} ms; drift at the end {self.drift * MS:.2f} ms"
        )
