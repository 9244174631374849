"""The account of what every good sample must get, made after the event, and where a pairing differs."""

from __future__ import annotations

import bisect
import itertools
from collections import Counter, defaultdict
from collections.abc import Mapping
from operator import attrgetter
from typing import NamedTuple

from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.sections import PairingSection
from knee_contact_ros.streams.pairing import PairedSample, Pairs, Synchroniser
from knee_contact_ros.streams.timeline import AngleSample, LoadSample
from studies.pairing.world import (
    ANGLE,
    LOAD,
    MAX_GAP,
    SECOND,
    WAIT,
    Arrival,
    Disturbance,
    World,
    angle_at,
    healing_time,
)

TOLERANCE = 1e-9
"""Rounding of an interpolated angle [rad]: a few ulp of 1, times what the ratio of two stamps' differences may add"""
BRIDGED = 3
"""Times in a row that a clock may be set while its samples seem to be late"""
LOOK = 10_000_000
"""Time [ns] between two checks by the caller of whether a load waits too long"""
IN_A_WORLD = 12
"""Number of disturbances in a world"""
FLAGS = ~int(Status.INPUT_REJECTED)
"""Bits of a status that concern the answer itself; a plain number, as enumerations are slow"""
KEPT_ASIDE = 512
"""Largest number of samples that may be kept aside: as many as `MAX_GAP` holds, and some"""


class Answer(NamedTuple):
    """Answer to a load."""

    pair: PairedSample
    given: int
    """True time [ns] of the answer"""


class Breach(NamedTuple):
    """Breach of the account by a pairing."""

    what: str
    arrival: Arrival
    kind: str
    """Kind of the last disturbance before"""


class Judged(NamedTuple):
    """Cost of the disturbances of a world."""

    breaches: list[Breach]
    disturbances: Counter[str]
    """Numbers of disturbances by kind; the other counts are by kind too"""
    flagged: Counter[str]
    """Numbers of good loads whose answer is flagged"""
    lost: Counter[str]
    """Numbers of good samples that are refused: their clock was set back, or angles had not begun"""


def run(world: World) -> tuple[dict[int, list[Answer]], Counter[int], int]:
    """Answers by the number of their load's arrival; how often each angle's arrival was handed on; most kept aside."""
    synchroniser = Synchroniser(PairingSection(max_gap=MAX_GAP / SECOND, wait=WAIT / SECOND))
    answers: dict[int, list[Answer]] = defaultdict(list)
    handed: Counter[int] = Counter()
    most, look = 0, 0

    def keep(pairs: Pairs, now: int) -> None:
        for pair in pairs:
            answers[pair.load.data].append(Answer(pair, now))  # type: ignore[index]
            handed.update(angle.data for angle in pair.angles)  # type: ignore[misc]

    for number, arrival in enumerate(world.arrivals):
        while look < arrival.arrives:
            keep(synchroniser.flush_expired((look - WAIT) / SECOND), look)
            look += LOOK
        if arrival.stream == ANGLE:
            angle = AngleSample(arrival.stamp, angle_at(arrival.taken), number)  # type: ignore[arg-type]
            keep(synchroniser.push_angle(angle), arrival.arrives)
        else:
            load = LoadSample(arrival.stamp, 0.0, 0.0, "", number, arrival.arrives / SECOND)  # type: ignore[arg-type]
            keep(synchroniser.push_load(load), arrival.arrives)
        most = max(
            most, len(synchroniser.angle_time.held_back), len(synchroniser.load_time.held_back)
        )
    keep(synchroniser.finish_streams(), world.now)
    handed.update(angle.data for angle in synchroniser.all_unpaired)  # type: ignore[misc]
    return answers, handed, most


def judged(seed: int) -> tuple[int, Judged]:
    """The seed, and the judgement of its world; every other world is crowded."""
    crowded = 1 if seed % 2 else 3
    return seed, judge(World(seed, IN_A_WORLD // crowded, crowded))


def judge(world: World) -> Judged:
    """Hold what the synchroniser makes of a world against the account."""
    answers, handed, most = run(world)
    account = Account(world, handed)
    found = Judged([], Counter(d.kind for d in world.disturbances), Counter(), Counter())
    for number, arrival in enumerate(world.arrivals):
        given, before = answers.get(number, []), account.before(arrival)
        kind = before.kind if before else ""
        what = (
            account.of_load(arrival, given)
            if arrival.stream == LOAD
            else account.of_angle(arrival, handed[number])
        )
        if what:
            found.breaches.append(Breach(what, arrival, kind))
        if not arrival.good:
            continue
        found.lost[kind] += not (given or handed[number])
        if before and given and not _unflagged(given[0]) and arrival.taken < account.end:
            found.flagged[kind] += 1
    if most > KEPT_ASIDE:
        found.breaches.append(Breach(f"{most} samples kept aside", world.arrivals[-1], ""))
    return found


class Account:
    """Account of what good samples must get."""

    def __init__(self, world: World, handed: Mapping[int, int]) -> None:
        """`handed` tells which angles are recorded: those that are not (see `of_angle`) are no neighbours."""
        self._disturbances, self._crowded = world.disturbances, world.crowded > 1
        self._begins = [disturbance.begins for disturbance in world.disturbances]
        self._heals = healing_time(world.sensors)
        self._latency = max(sensor.latency for sensor in world.sensors)
        self.end = world.now - self._heals
        """True time [ns] before which samples are followed by others"""
        self._good: dict[int, list[Arrival]] = defaultdict(
            list
        )  # angles by the setting of their clock
        self._latest: dict[
            tuple[int, int], int
        ] = {}  # of a stream's earlier settings the largest stamp
        self._loads = {a.setting: a for a in world.arrivals if a.good and a.stream == LOAD}
        """Last good load of each setting of the loads' clock"""
        self._wrong = [a for a in world.arrivals if not a.good and a.stream == ANGLE]
        latest: Counter[int] = Counter()
        kept: dict[int, Arrival] = {}  # the last recorded angle of each setting
        for number, arrival in enumerate(world.arrivals):
            if not arrival.good:
                continue
            if arrival.stream == ANGLE:
                self._good[arrival.setting].append(arrival)
                if handed.get(number):
                    kept[arrival.setting] = arrival
            self._latest.setdefault((arrival.stream, arrival.setting), latest[arrival.stream])
            latest[arrival.stream] = arrival.stamp
        bridges = [
            bridge
            for before, after in itertools.combinations(sorted(self._good), 2)
            if after <= before + BRIDGED
            for last in {self._good[before][-1], kept.get(before, self._good[before][-1])}
            if (bridge := _bridge(last, self._good[after]))
        ]
        if self._crowded:  # where good angles may be lost, those that are not are neighbours
            bridges += [
                recorded for recorded in self._recorded(world, handed).values() if recorded
            ]
        self._good |= {-1 - number: bridge for number, bridge in enumerate(bridges)}
        self._stamps = {
            setting: [angle.stamp for angle in angles] for setting, angles in self._good.items()
        }

    def _recorded(self, world: World, handed: Mapping[int, int]) -> dict[int, list[Arrival]]:
        """Good angles that were recorded, by the setting of their clock."""
        recorded: dict[int, list[Arrival]] = defaultdict(list)
        for number, arrival in enumerate(world.arrivals):
            if arrival.good and arrival.stream == ANGLE and handed.get(number):
                recorded[arrival.setting].append(arrival)
        return recorded

    def of_load(self, load: Arrival, given: list[Answer]) -> str:
        """Fault of a load's answers; empty if there is none."""
        if not load.good:
            unseen = any(_unflagged(answer) for answer in given) and not self._cannot_be_told(load)
            return "a wrong load is answered without a flag" if unseen else ""
        if len(given) > 1:
            return "answered twice"
        if not given:
            return (
                "" if self._may_be_lost(load) or self._lies_before_angles(load) else "not answered"
            )
        (answer,) = given
        if _unflagged(answer) and not self._is_right(load, answer):
            return "a wrong angle without a flag"
        return self._of_quiet(load, answer) if self._quiet(load.taken) else ""

    def _of_quiet(self, load: Arrival, answer: Answer) -> str:
        """Fault of the answer to a load where nothing is disturbed any more; empty if there is none."""
        if not _unflagged(answer):
            return f"flagged {Status(answer.pair.status)!r} long after"
        return "" if answer.given <= self._possible(load) else "answered late"

    def of_angle(self, angle: Arrival, handed: int) -> str:
        """Fault of how often an angle was handed on to be recorded; empty if there is none."""
        if handed > 1:
            return "handed on twice"
        if angle.good and not handed:
            return "" if self._may_be_lost(angle) else "an angle is lost"
        return ""

    def before(self, arrival: Arrival) -> Disturbance | None:
        """The last disturbance before an arrival."""
        number = bisect.bisect_right(self._begins, arrival.arrives)
        return self._disturbances[number - 1] if number else None

    def _quiet(self, taken: int) -> bool:
        """Whether all disturbances before had time to heal, and none comes soon."""
        return taken < self.end and all(
            taken > d.ends + self._heals or taken < d.begins - self._heals
            for d in self._disturbances
        )

    def _may_be_lost(self, arrival: Arrival) -> bool:
        """Whether a good sample may be refused: it seems late, or comes amid faults that none can tell apart."""
        return self._overlaps(arrival) or (self._crowded and not self._quiet(arrival.taken))

    def _overlaps(self, arrival: Arrival) -> bool:
        """Whether the clock was set back by so little that the stamp only seems to be late."""
        return 0 <= self._latest[arrival.stream, arrival.setting] - arrival.stamp <= MAX_GAP

    def _cannot_be_told(self, load: Arrival) -> bool:
        """Whether a wrong load comes right after its clock was set, or angles, their clock too, are off by as much."""
        before, last = self._loads.get(load.setting - 1), self._loads.get(load.setting)
        if before and load.arrives - before.arrives <= self._heals:
            return True
        if any(
            abs(angle.stamp - load.stamp) <= MAX_GAP for angle in self._wrong_angles_near(load)
        ):
            return True
        angles = [
            angle
            for setting in range(max(self._good) + 1)
            for angle in self._good.get(setting, ())
            if abs(angle.arrives - load.arrives) <= self._heals
            and abs(angle.stamp - load.stamp) <= MAX_GAP
        ]
        return last is not None and any(
            abs((angle.stamp - angle.taken) - (last.stamp - last.taken)) > MAX_GAP
            for angle in angles
        )

    def _wrong_angles_near(self, load: Arrival) -> list[Arrival]:
        first = bisect.bisect_left(
            self._wrong, load.arrives - self._heals, key=attrgetter("arrives")
        )
        last = bisect.bisect_right(
            self._wrong, load.arrives + self._heals, key=attrgetter("arrives")
        )
        return self._wrong[first:last]

    def _lies_before_angles(self, load: Arrival) -> bool:
        """Whether a load lies before all angles of a clock that has just been set, or of the beginning."""
        near = (
            angles
            for angles in self._good.values()
            if abs(angles[0].taken - load.taken) <= self._heals
        )
        return any(load.stamp < angles[0].stamp for angles in near)

    def _is_right(self, load: Arrival, answer: Answer) -> bool:
        """Whether the answer's angle lies between two good neighbours of one setting of the clock."""
        return any(
            value is not None and abs(value - answer.pair.angle) <= TOLERANCE
            for value in (self._between(load.stamp, setting) for setting in self._good)
        )

    def _between(self, stamp: int, setting: int) -> float | None:
        stamps, angles = self._stamps[setting], self._good[setting]
        after = bisect.bisect_left(stamps, stamp)
        if after == len(stamps) or (after == 0 and stamps[0] != stamp):
            return None
        value = angle_at(angles[after].taken)
        if stamps[after] == stamp:
            return value
        part = (stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        before = angle_at(angles[after - 1].taken)
        return before + part * (value - before)

    def _possible(self, load: Arrival) -> int:
        """True time [ns] by which it can be answered: its own arrival, or that of the first angle at or after it."""
        settings = [
            s for s, stamps in self._stamps.items() if stamps[0] <= load.stamp <= stamps[-1]
        ]
        after = [self._good[s][bisect.bisect_left(self._stamps[s], load.stamp)] for s in settings]
        near = [angle for angle in after if abs(angle.taken - load.taken) <= self._heals]
        return max(load.arrives, *(angle.arrives for angle in near)) if near else load.arrives


def _bridge(last: Arrival, after: list[Arrival]) -> list[Arrival]:
    """The neighbours where a clock was set: ahead this looks like a pause, and back like samples that are late."""
    return [last, *[angle for angle in after if angle.stamp > last.stamp][:1]]


def _unflagged(answer: Answer) -> bool:
    return not answer.pair.status & FLAGS
