"""Pair load and angle by stamp: every load gets the angle at its own stamp, interpolated between its two neighbours.

No clock in here: whether an angle is late is for the caller to say (`give_up`).
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from typing import NamedTuple

from knee_contact_ros.core.types import Status
from knee_contact_ros.parameters import Pairing
from knee_contact_ros.stream_in.samples import AngleSample, LoadSample

SECOND = 1_000_000_000
# Plain numbers: combining flags of an enumeration takes as long as the rest of a pairing.
OK, STALE_INPUT, TIME_RESET = int(Status.OK), int(Status.STALE_INPUT), int(Status.TIME_RESET)
INPUT_HELD, INPUT_REJECTED = int(Status.INPUT_HELD), int(Status.INPUT_REJECTED)


class PairedSample(NamedTuple):
    """What one tick is made of."""

    load: LoadSample
    angle: float
    """Flexion angle [rad] at the load's stamp"""
    height: float | None
    """Femoral height [m] there, with the displacement drive"""
    status: int
    """Bits of `Status`"""
    angles: tuple[AngleSample, ...]
    """Angle samples up to this stamp that no earlier pair has taken along"""


class Steady(NamedTuple):
    """What a synchroniser holds between two samples while nothing unusual happens."""

    angles: tuple[AngleSample, ...]
    """From the last one before the next load on, or earlier"""
    fresh: tuple[AngleSample, ...]
    """Those that no pair has taken along"""
    loads: tuple[LoadSample, ...]
    """That wait for an angle"""
    last_angle: int | None
    """Stamps [ns]"""
    last_load: int | None
    last_pair: int | None


class Synchroniser:
    """Two streams in, pairs out, in the order of the load's stamps.

    Both streams may jump back in time, and not at the same moment (a looped bag). Each stretch between jumps is an
    epoch; samples pair only within one.
    """

    def __init__(self, pairing: Pairing) -> None:
        self.refused: Counter[str] = Counter()
        """Refused samples by reason"""
        self._max_gap = round(pairing.max_gap * SECOND)
        self._epochs: defaultdict[int, _Epoch] = defaultdict(lambda: _Epoch(self._max_gap))
        self._angle_epoch = 0
        self._load_epoch = 0
        self._angles_adopted = False  # the angles were counted into the loads' epoch without having jumped
        self._last_angle: int | None = None
        self._last_load: int | None = None
        self._last_pair: int | None = None
        self._flags = OK

    @property
    def waiting(self) -> int:
        """Loads that wait for an angle."""
        return len(self._epochs[self._load_epoch].loads)

    def steady(self) -> Steady | None:
        """What is held; None after something unusual, until a pair has told it."""
        epoch = self._epochs[self._load_epoch]
        if self._flags or self._angle_epoch != self._load_epoch or self._angles_adopted or epoch.angles_ended:
            return None
        return Steady(
            tuple(epoch.angles), tuple(epoch.fresh), tuple(epoch.loads),
            self._last_angle, self._last_load, self._last_pair,
        )  # fmt: skip

    def go_on(self, steady: Steady) -> None:
        """Hold this; only while `steady` gives something."""
        epoch = self._epochs[self._load_epoch]
        epoch.angles, epoch.fresh, epoch.loads = deque(steady.angles), deque(steady.fresh), deque(steady.loads)
        self._last_angle, self._last_load, self._last_pair = steady[3:]

    def refuse(self, reason: str) -> None:
        """Count a sample that cannot be used; the next tick says so."""
        self.refused[reason] += 1
        self._flags |= INPUT_REJECTED

    def start_anew(self) -> None:
        """Have the next tick start from rest, as after a jump back in time."""
        self._last_pair = None
        self._flags |= TIME_RESET

    def push_angle(self, sample: AngleSample) -> list[PairedSample]:
        """Take an angle; return the pairs that can be made now."""
        if self._last_angle is not None and sample.stamp <= self._last_angle:
            if self._last_angle - sample.stamp <= self._max_gap:
                self.refuse("angle_not_in_order")
                return []
            if self._angles_adopted:
                self._epochs[self._angle_epoch].angles.clear()  # the jump that the loads have made before
            else:
                self._epochs[self._angle_epoch].angles_ended = True
                self._angle_epoch += 1
            self._angles_adopted = False
        self._last_angle = sample.stamp
        self._epochs[self._angle_epoch].add_angle(sample)
        return self._pairs() if self.waiting else []

    def push_load(self, sample: LoadSample) -> list[PairedSample]:
        """Take a load; return the pairs that can be made now."""
        pairs = []
        if self._last_load is not None and sample.stamp <= self._last_load:
            if self._last_load - sample.stamp <= self._max_gap:
                self.refuse("load_not_in_order")
                return []
            pairs = self.give_up()
            del self._epochs[self._load_epoch]
            self._load_epoch += 1
            self.start_anew()
        self._last_load = sample.stamp
        self._epochs[self._load_epoch].loads.append(sample)
        return pairs + self._pairs()

    def give_up(self) -> list[PairedSample]:
        """Answer all waiting loads with the last angle before them: no angle at or after their stamps came in time."""
        if self._angle_epoch < self._load_epoch:
            self._angle_epoch, self._angles_adopted = self._load_epoch, True
        return self._pairs(hold=True)

    def rest(self) -> list[AngleSample]:
        """Angle samples that no pair has taken along; for the end of a stream."""
        return [angle for epoch in self._epochs.values() for angle in epoch.take_fresh(None)]

    def _pairs(self, hold: bool = False) -> list[PairedSample]:
        epoch = self._epochs[self._load_epoch]
        pairs = []
        while (found := epoch.next_pair(hold)) is not None:
            load, pose, status = found
            if pose is None:
                self.refuse("no_angle_before")
                continue
            if self._last_pair is not None and load.stamp - self._last_pair > self._max_gap:
                status |= STALE_INPUT
            self._last_pair = load.stamp
            taken = tuple(epoch.take_fresh(load.stamp))
            pairs.append(PairedSample(load, pose.angle, pose.height, status | self._flags, taken))
            self._flags = OK
        return pairs


class _Epoch:
    """Samples of both streams between two jumps in time; stamps grow in each."""

    def __init__(self, max_gap: int) -> None:
        self.max_gap = max_gap
        self.loads: deque[LoadSample] = deque()
        self.angles: deque[AngleSample] = deque()
        self.fresh: deque[AngleSample] = deque()
        self.angles_ended = False

    def add_angle(self, sample: AngleSample) -> None:
        self.angles.append(sample)
        self.fresh.append(sample)

    def take_fresh(self, until: int | None) -> list[AngleSample]:
        """Angles up to a stamp [ns] (None: all) that have not been taken yet."""
        taken = []
        while self.fresh and (until is None or self.fresh[0].stamp <= until):
            taken.append(self.fresh.popleft())
        return taken

    def next_pair(self, hold: bool) -> tuple[LoadSample, AngleSample | None, int] | None:
        """The oldest load with the angle at its stamp; the angle is None if the load lies before all angles.

        None while the load must wait; with `hold`, and when no more angles will come, it gets the last one instead.
        """
        if not self.loads:
            return None
        found = self._angle_at(self.loads[0].stamp, hold or self.angles_ended)
        return None if found is None else (self.loads.popleft(), *found)

    def _angle_at(self, stamp: int, hold: bool) -> tuple[AngleSample | None, int] | None:
        """The angle at a stamp that no later call goes behind; None while it is not known."""
        while len(self.angles) > 1 and self.angles[1].stamp <= stamp:
            self.angles.popleft()
        if not self.angles:
            return (None, OK) if hold else None
        before, after = self.angles[0], self.angles[1] if len(self.angles) > 1 else None
        if before.stamp > stamp:
            return None, OK
        if before.stamp == stamp:
            return before, OK
        if after is not None:
            return _between(before, after, stamp), self._stale(after.stamp - before.stamp)
        return (before, INPUT_HELD | self._stale(stamp - before.stamp)) if hold else None

    def _stale(self, gap: int) -> int:
        return STALE_INPUT if gap > self.max_gap else OK


def _between(before: AngleSample, after: AngleSample, stamp: int) -> AngleSample:
    """The sample at a stamp between two: linear in time."""
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    height = before.height
    if height is not None and after.height is not None:
        height += part * (after.height - height)
    return before._replace(stamp=stamp, angle=before.angle + part * (after.angle - before.angle), height=height)
