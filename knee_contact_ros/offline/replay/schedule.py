"""When each moment of a bag is due on a clock, at a rate that may change, and with pauses."""

from __future__ import annotations

from knee_contact_ros.streams.topics import NANOSECONDS


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
