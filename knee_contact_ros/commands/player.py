"""Gives the messages of a bag when they are due, obeys keys, and measures how late each was. Needs no ROS."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from ..bags.bag import RawMessage
from ..streams.messages import stamp_in
from ..streams.topics import NANOSECONDS
from ..system.terminal import say


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


def commands_of(keys: Iterable[bytes]) -> list[Command]:
    """Return the commands that pressed keys give."""
    return [KEYS[key] for key in keys if key in KEYS]


_MIN_RATE = 0.01
_MAX_RATE = 100.0
_RATE_STEP = 1.1
"""Factor by which a key multiplies or divides the rate"""
_SLEEP_MARGIN = 1e-4
"""Time [s] that a sleep may take too long; the rest of the time to a message is waited for in a loop"""
_MAX_WAIT = 1.0
"""Longest single wait [s]"""
_KEYS_PERIOD = 0.05
"""Time [s] after which keys are checked even if messages are always due"""
_MAX_PAUSE = 600 * NANOSECONDS
"""Longest pause [ns] that is waited for"""
_MAX_JITTER = 1_000_000
"""Time [ns] by which log times may go back without a clock that was set"""


def sleep_without_keys(seconds: float) -> Sequence[Command]:
    """Wait for a time [s] where there are no keys."""
    time.sleep(seconds)
    return ()


def with_due_times(messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, int]]:
    """Yield messages with the times [ns] at which they are due: log times; of equal ones, as the stamps go on."""
    last = -1
    begins: dict[str, int] = {}
    for message in messages:
        if message.log_time != last:
            last = message.log_time
            begins = {}
        try:
            stamp = stamp_in(message.data)
        except ValueError:
            stamp = begins.get(message.topic, 0)
        step = stamp - begins.setdefault(message.topic, stamp)
        yield message, message.log_time + (step if 0 < step <= _MAX_PAUSE else 0)


@dataclass
class Player:
    """Plays messages one after another.

    The bag's time is known at one moment, the beginning or the last change. All other times are computed from there, so
    that rounding errors do not accumulate.
    """

    wait: Callable[[float], Sequence[Command]] = sleep_without_keys
    """Function that waits for a time [s] or shorter, and returns the commands of the keys pressed meanwhile"""
    rate: float = 1.0
    """Seconds of the bag per second"""
    paused: bool = False
    on_change: Callable[[float, bool], None] | None = None
    """Called with rate and pause whenever a key changes one of them"""
    publish_time: Callable[[int], None] | None = None
    """Called with the bag's time [ns] at the rate `clock_rate`"""
    clock_rate: float = 0.0
    """Rate [Hz] of the clock; 0: there is none"""

    def __post_init__(self) -> None:
        """Begin with no message."""
        self._bag_time = 0
        """The bag's time [ns] at the time `_clock` [s]"""
        self._clock = 0.0
        self._next_publication = math.inf
        """When the bag's time is published again [s]"""
        self._next_keys = 0.0
        """When keys are checked at the latest [s]"""
        self._commands: deque[Command] = deque()

    def play(self, messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, float | None]]:
        """Yield each message when it is due, the first at once, and how late [s] that is.

        The delay is None for a message to which a key stepped. A pause in the bag that is too long is skipped.
        """
        last = None
        for message, due in with_due_times(messages):
            if last is None:
                self._set_time(due)
                self._next_publication = (
                    self._clock if self.publish_time and self.clock_rate else math.inf
                )
            elif not -_MAX_JITTER <= due - last <= _MAX_PAUSE:
                # A clock was set, or nothing came for long.
                if due > last:
                    pause = (due - last) / NANOSECONDS
                    say(f"the bag pauses for {pause:.6g} s, which is skipped", err=True)
                self._set_time(due)
            last = due
            yield message, self._wait_for(due)

    def leave_out(self, seconds: float) -> None:
        """Leave out a time [s] for which the process was stopped."""
        self._clock += seconds

    def _set_time(self, bag_time: int) -> None:
        """Let the bag's time [ns] be now."""
        self._bag_time = bag_time
        self._clock = time.perf_counter()

    def _time_at(self, now: float) -> int:
        """Return the bag's time [ns] at `now` [s] of the clock."""
        if self.paused:
            return self._bag_time
        return self._bag_time + round((now - self._clock) * NANOSECONDS * self.rate)

    def _wait_for(self, bag_time: int) -> float | None:
        """Wait until a message is due; return how late [s] it is then, None if a key has stepped to it."""
        while True:
            now = time.perf_counter()
            if now >= self._next_publication and self.publish_time:
                self.publish_time(self._time_at(now))
                period = 1.0 / self.clock_rate
                self._next_publication += period
                if self._next_publication <= now:
                    self._next_publication = now + period
            due = math.inf
            if not self.paused:
                due = self._clock + (bag_time - self._bag_time) / NANOSECONDS / self.rate
            if due <= now < self._next_keys:
                return now - due
            if not self._commands:
                self._wait_precisely(min(due, self._next_publication), now)
            while self._commands:
                command = self._commands.popleft()
                if command is Command.STEP and self.paused:
                    self._set_time(bag_time)
                    return None
                self._obey(command)

    def _wait_precisely(self, end: float, now: float) -> None:
        """Wait until `end` [s] at most: asleep, and shortly before it in a loop."""
        if end - now > _SLEEP_MARGIN or now >= self._next_keys:
            seconds = min(end - now - _SLEEP_MARGIN, _MAX_WAIT)
            self._commands += self.wait(max(0.0, seconds))
            self._next_keys = time.perf_counter() + _KEYS_PERIOD
        while time.perf_counter() < end <= now + _SLEEP_MARGIN:
            pass

    def _obey(self, command: Command) -> None:
        """Change rate or pause from now on."""
        self._set_time(self._time_at(time.perf_counter()))
        if command is Command.PAUSE:
            self.paused = not self.paused
        elif command is not Command.STEP:
            factor = _RATE_STEP if command is Command.FASTER else 1.0 / _RATE_STEP
            self.rate = min(max(self.rate * factor, _MIN_RATE), _MAX_RATE)
        if self.on_change:
            self.on_change(self.rate, self.paused)


_LATE = 1e-3
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

    def count_message(self, delay: float | None) -> None:
        """Count a message with its delay [s]; None: a key stepped to it, and it is never late."""
        self.messages += 1
        self.drift = delay or 0.0
        self.late += self.drift > _LATE
        self.largest = max(self.largest, self.drift)

    def __str__(self) -> str:
        """Return the report as one line."""
        percent = 100.0 * self.late / max(self.messages, 1)
        return (
            f"{self.messages} messages published, {self.late} ({percent:.3g} %) later than {1e3 * _LATE:g} ms, "
            f"the latest by {1e3 * self.largest:.2f} ms; drift at the end {1e3 * self.drift:.2f} ms"
        )
