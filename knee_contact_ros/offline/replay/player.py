"""Publish the messages of a bag when they are due, obey keys, and measure how late each was. Needs no ROS."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.offline.replay.keyboard import Command
from knee_contact_ros.offline.replay.schedule import Schedule

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
        for message in messages:
            if self._schedule is None:
                self._schedule = self._begin(message.log_time)
            late = self._wait_for(message.log_time, self._schedule)
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
