"""When each moment of a bag is due, on a clock, at a rate that may change and with pauses in between."""

from __future__ import annotations

from knee_contact_ros.messages.ros_types import NANOSECONDS


class Schedule:
    """The bag's time against a clock's.

    Both are known at one moment, the beginning or the last change. Everything else is computed from there, so nothing
    adds up on the way.
    """

    def __init__(self, begin: int, rate: float, now: float, *, paused: bool = False) -> None:
        """The bag's time `begin` [ns] is at `now` [s] of the clock; `rate` is in seconds of the bag per second."""
        self.rate = rate
        self.paused = paused
        self._bag = begin
        self._clock = now

    def due(self, log_time: int) -> float:
        """When [s] a time of the bag [ns] comes, if no pause does."""
        return self._clock + (log_time - self._bag) / NANOSECONDS / self.rate

    def at(self, now: float) -> int:
        """The bag's time [ns] at `now` [s]."""
        return self._bag if self.paused else self._bag + round((now - self._clock) * NANOSECONDS * self.rate)

    def pause(self, now: float) -> None:
        """Let the bag's time stand still."""
        self._bag, self._clock, self.paused = self.at(now), now, True

    def resume(self, now: float) -> None:
        """Let it go on."""
        self._clock, self.paused = now, False

    def change_rate(self, rate: float, now: float) -> None:
        """Go on at another rate."""
        self._bag, self._clock, self.rate = self.at(now), now, rate

    def step_to(self, log_time: int, now: float) -> None:
        """Be at a time of the bag [ns] now."""
        self._bag, self._clock = log_time, now

    def stood_still(self, seconds: float) -> None:
        """Leave out a time [s] for which the whole process was stopped."""
        self._clock += seconds
