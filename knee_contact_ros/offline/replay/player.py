"""Send the messages of a bag when they are due, obeying keys, and tell how late each one was. No ROS in here."""

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
"""By which a key multiplies or divides the rate"""
MARGIN = 1e-4
"""[s] that a sleep may take too long; the rest of the time to a message is waited for awake"""
LONGEST_WAIT = 1.0
"""[s]"""
LOOK_EVERY = 0.05
"""[s] after which keys are looked for although messages are due all the time"""

Wait = Callable[[float], Sequence[Command]]
"""Waits so long [s] or shorter; gives what the keys pressed meanwhile ask for"""


def sleep(seconds: float) -> Sequence[Command]:
    """Wait where there are no keys."""
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
        """`rate` is in seconds of the bag per second; `changed` is told when a key changes it or pauses."""
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

    def tell_time(self, publish_clock: Callable[[int], None], rate: float) -> None:
        """Call `publish_clock` with the bag's time [ns] at `rate` [Hz]; 0: with every message."""
        self._publish_clock = publish_clock
        self._clock_period = 1.0 / rate if rate else 0.0

    def play(self, messages: Iterable[RawMessage]) -> Iterator[tuple[RawMessage, float | None]]:
        """Publish each message when it is due, the first one at once; yields it and how late [s] it was.

        None in place of the lateness: a key has called for the message.
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
        """Go on as if a time [s] had not been, for which the process was stopped."""
        if self._schedule:
            self._schedule.stood_still(seconds)

    def _begin(self, log_time: int) -> Schedule:
        now = time.perf_counter()
        if self._clock_period:
            self._clock_began = self._clock_due = now
        return Schedule(log_time, self.rate, now, paused=self.paused)

    def _wait_for(self, log_time: int, schedule: Schedule) -> float | None:
        """Wait until a message is due; tells how late [s] it is then, None if a key has called for it."""
        while True:
            now = time.perf_counter()
            if now >= self._clock_due:
                self._tell_time(schedule, now)
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
        """Wait until `end` at most: asleep, and shortly before it awake."""
        if end - now > MARGIN or now >= self._look:
            self._commands += self._wait(max(0.0, min(end - now - MARGIN, LONGEST_WAIT)))
            self._look = time.perf_counter() + LOOK_EVERY
            return
        while time.perf_counter() < end:
            pass

    def _tell_time(self, schedule: Schedule, now: float) -> None:
        if self._publish_clock:
            self._publish_clock(schedule.at(now))
        told = math.floor((now - self._clock_began) / self._clock_period + 1e-6)
        self._clock_due = self._clock_began + (told + 1) * self._clock_period

    def _obey(self, command: Command, schedule: Schedule) -> None:
        now = time.perf_counter()
        if command is Command.PAUSE:
            (schedule.resume if schedule.paused else schedule.pause)(now)
        elif command in (Command.FASTER, Command.SLOWER):
            rate = schedule.rate * RATE_STEP if command is Command.FASTER else schedule.rate / RATE_STEP
            schedule.change_rate(min(max(rate, LEAST_RATE), LARGEST_RATE), now)
        self.rate, self.paused = schedule.rate, schedule.paused
        self._changed(self.rate, self.paused)
