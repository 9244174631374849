"""Two sensors with clocks of their own, the disturbances of their stamps, and the samples that arrive.

Times are whole nanoseconds. The true flexion angle is a function of true time, so every wrong pairing shows in a value.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import NamedTuple

MS = 1_000_000
SECOND = 1000 * MS
PERIODS = {1 * MS: 1, 2 * MS: 1, 5 * MS: 4, 10 * MS: 6}
"""Periods [ns] with the weights by which they are drawn: a short one makes a large world, and shows no more"""
JITTER = 0.2
"""Part of a period by which a sample may be early or late"""
LATENCIES = (0, 1 * MS, 4 * MS, 12 * MS, 30 * MS)
MAX_GAP = 100 * MS
WAIT = 100 * MS
REST = 24
"""Number of samples of the slower stream between a disturbance that has healed and the next one"""
ANGLE, LOAD = 0, 1


class Arrival(NamedTuple):
    """A sample that arrives."""

    arrives: int
    """True time [ns]"""
    stream: int
    """`ANGLE` or `LOAD`"""
    stamp: int
    """Stamp [ns] by the sensor's clock, or by a fault"""
    taken: int
    """True time [ns] at which it was measured"""
    setting: int
    """Number of times that the sensor's clock had been set"""
    good: bool
    """Whether the stamp is that of the sensor's clock"""


class Sensor:
    """A sensor with its clock."""

    def __init__(self, stream: int, rng: random.Random) -> None:
        self.stream = stream
        (self.period,) = rng.choices(list(PERIODS), list(PERIODS.values()))
        self.latency = rng.choice(LATENCIES)
        self.offset = 0
        """Offset of the clock [ns]"""
        self.setting = 0
        """Number of times that the clock was set"""
        self.silent_until = 0
        """True time [ns] until which the sensor is silent"""
        self._rng = rng
        self._next = rng.randrange(self.period)

    def sample(self, wrong_by: int = 0) -> Arrival | None:
        """Next sample; None while the sensor is silent."""
        taken = self._next + round(self.period * self._rng.uniform(-JITTER, JITTER))
        self._next += self.period
        if taken < self.silent_until:
            return None
        stamp = taken + self.offset + wrong_by
        return Arrival(
            taken + self.latency, self.stream, stamp, taken, self.setting, wrong_by == 0
        )

    def set_clock(self, offset: int) -> None:
        """Set the clock to another offset [ns]."""
        self.offset, self.setting = offset, self.setting + 1

    @property
    def now(self) -> int:
        """True time [ns] of the next sample."""
        return self._next


class Disturbance(NamedTuple):
    """An interval in which something was wrong."""

    kind: str
    begins: int
    """True time [ns] of its begin"""
    ends: int


class World:
    """Both sensors, and the disturbances that befall them one after the other."""

    def __init__(self, seed: int, disturbances: int, crowded: int = 1) -> None:
        """`crowded`: so many disturbances come one upon the other before there is time to heal."""
        self.crowded = crowded
        self.rng = random.Random(seed)  # noqa: S311  (a world, and no secret)
        self.sensors = (Sensor(ANGLE, self.rng), Sensor(LOAD, self.rng))
        self.arrivals: list[Arrival] = []
        self.disturbances: list[Disturbance] = []
        self.slowest = max(sensor.period for sensor in self.sensors)
        self._begin()
        self.run_for(
            self.rng.choice((3, 6, REST)) * self.slowest + max(LATENCIES)
        )  # both have begun
        for _ in range(disturbances):
            for place in range(crowded):
                if place:
                    self.run_for(self.rng.randrange(MAX_GAP))
                self._disturb()
            self.run_for(healing_time(self.sensors) + REST * self.slowest)
        self.arrivals.sort(key=lambda arrival: arrival.arrives)  # stable: a stream stays in order

    @property
    def now(self) -> int:
        """True time [ns] up to which both sensors have measured."""
        return max(sensor.now for sensor in self.sensors)

    def run_for(self, duration: int) -> None:
        """Let both sensors measure for a duration [ns]."""
        until = self.now + duration
        for sensor in self.sensors:
            while sensor.now < until:
                self.emit(sensor)

    def emit(self, sensor: Sensor, wrong_by: int = 0) -> None:
        """Let a sensor send its next sample, with a stamp that is wrong by some [ns]."""
        if arrival := sensor.sample(wrong_by):
            self.arrivals.append(arrival)

    def apart(self) -> int:
        """Least error [ns] of a wrong stamp that can be seen: no step of a stream, and not the other's present."""
        latency = abs(self.sensors[0].latency - self.sensors[1].latency)
        return latency + round(3.0 * (1.0 + 2.0 * JITTER) * 2.0 * self.slowest)

    def _disturb(self) -> None:
        kind, begins = self.rng.choice(list(KINDS)), self.now
        KINDS[kind](self, self.sensors[self.rng.randrange(2)])
        self.disturbances.append(Disturbance(kind, begins, self.now))

    def _begin(self) -> None:
        start = self.rng.choice((0, 3 * SECOND, 10**18))
        for sensor in self.sensors:
            sensor.offset = start + SECOND * 20


def healing_time(sensors: tuple[Sensor, Sensor]) -> int:
    """Time [ns] within which all must be as before: the largest gap, one more sample, and what is on its way."""
    return MAX_GAP + 2 * max(s.period for s in sensors) + max(s.latency for s in sensors) + WAIT


def ahead(world: World, sensor: Sensor) -> None:
    """Disturbance: up to three samples in a row have stamps that lie ahead."""
    by = world.rng.randrange(world.apart(), 10 * SECOND)
    for _ in range(world.rng.randint(1, 3)):
        world.emit(sensor, wrong_by=by)


def behind(world: World, sensor: Sensor) -> None:
    """Disturbance: up to three samples in a row have stamps that lie behind."""
    by = world.rng.randrange(world.apart(), 10 * SECOND)
    for _ in range(world.rng.randint(1, 3)):
        world.emit(sensor, wrong_by=-by)


def doubled(world: World, sensor: Sensor) -> None:
    """Disturbance: a sample repeats a stamp."""
    last = next(a for a in reversed(world.arrivals) if a.stream == sensor.stream)
    world.arrivals.append(last._replace(good=False))


def pause(world: World, sensor: Sensor) -> None:
    """Disturbance: a stream is silent for a while."""
    sensor.silent_until = world.now + world.rng.randrange(MAX_GAP // 5, 5 * MAX_GAP)
    world.run_for(sensor.silent_until - world.now)


def pause_of_both(world: World, _sensor: Sensor) -> None:
    """Disturbance: both streams are silent for a while."""
    until = world.now + world.rng.randrange(MAX_GAP // 5, 5 * MAX_GAP)
    for sensor in world.sensors:
        sensor.silent_until = until
    world.run_for(until - world.now)


def step(world: World, sensor: Sensor) -> None:
    """Disturbance: the clock of one stream is set, to be set right again later."""
    right, by = sensor.offset, _jump(world)
    sensor.set_clock(right + by)
    world.run_for(world.rng.randrange(2 * MAX_GAP, 8 * MAX_GAP))
    sensor.set_clock(right)


def step_of_both(world: World, sensor: Sensor) -> None:
    """Disturbance: simulated time jumps, or a bag begins anew; one stream a little before the other, or at once."""
    by = _jump(world)
    sensor.set_clock(sensor.offset + by)
    world.run_for(world.rng.choice((0, 0, MAX_GAP // 10, 3 * MAX_GAP)))
    other = world.sensors[1 - sensor.stream]
    other.set_clock(other.offset + by)


def restart(world: World, sensor: Sensor) -> None:
    """Disturbance: a sensor begins anew with another clock, and gets the right time later."""
    right, by = sensor.offset, _jump(world)
    sensor.set_clock(right + by)
    sensor.silent_until = world.now + world.rng.randrange(MAX_GAP, 5 * MAX_GAP)
    world.run_for(sensor.silent_until - world.now + world.rng.randrange(2 * MAX_GAP, 8 * MAX_GAP))
    sensor.set_clock(right)


def two_publishers(world: World, sensor: Sensor) -> None:
    """Disturbance: another node publishes on the topic too, with a clock of its own."""
    by = world.rng.choice((-1, 1)) * world.rng.randrange(2 * MAX_GAP, 10 * SECOND)
    turns = world.rng.randint(5, 60)
    for _ in range(turns):
        world.emit(sensor)
        last = world.arrivals[-1]
        if last.good and last.stream == sensor.stream:
            off = by + sensor.period // 3
            world.arrivals.append(
                last._replace(stamp=last.stamp + off, arrives=last.arrives + 1, good=False)
            )
    world.run_for(sensor.now - world.sensors[1 - sensor.stream].now + 1)


def drift(world: World, sensor: Sensor) -> None:
    """Disturbance: a clock runs too fast or too slowly for a while."""
    rate = world.rng.choice((-1, 1)) * world.rng.uniform(0.0, 0.02)
    for _ in range(100):
        sensor.offset += round(rate * sensor.period)
        world.emit(sensor)
    for _ in range(100):
        sensor.offset -= round(rate * sensor.period)
        world.emit(sensor)
    world.run_for(max(1, sensor.now - world.sensors[1 - sensor.stream].now))


def nothing(_world: World, _sensor: Sensor) -> None:
    """No disturbance."""


KINDS: dict[str, Callable[[World, Sensor], None]] = {
    kind.__name__: kind
    for kind in (
        ahead,
        behind,
        doubled,
        pause,
        pause_of_both,
        step,
        step_of_both,
        restart,
        two_publishers,
        drift,
        nothing,
    )
}


def _jump(world: World) -> int:
    """Time [ns] by which a clock is set."""
    size = round(10 ** world.rng.uniform(math.log10(2 * MS), math.log10(15 * SECOND)))
    return world.rng.choice((-1, 1)) * size


def angle_at(taken: int) -> float:
    """The true flexion angle [rad]."""
    return math.sin(23.0 * (taken % (1000 * SECOND)) / SECOND)
