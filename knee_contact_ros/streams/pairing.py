"""Pairs loads and angles by stamp: every load gets the angle at its own stamp, interpolated between its two neighbours.

The `Timeline` of each stream decides which samples are accepted. No clock is used: pairs depend only on the samples and
their order, and the caller decides when an angle is late (`flush_expired`).
"""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from ..model.types import Status
from ..parameters.sections import PairingSection
from .clock_sets import FIRST_JUDGED, ClockSets
from .timeline import LONG_STEP, AngleSample, LoadSample, Refusals, Timeline
from .topics import NANOSECONDS

# Plain numbers: combining flags of an enumeration takes as long as the rest of a pairing.
STATUS_OK = int(Status.OK)
STALE_INPUT = int(Status.STALE_INPUT)
TIME_RESET = int(Status.TIME_RESET)
INPUT_HELD = int(Status.INPUT_HELD)
INPUT_REJECTED = int(Status.INPUT_REJECTED)

DIFFERING_TIME = NANOSECONDS
"""Time [ns] for which the stamps of both streams must differ before answers are flagged. Tuned; with less, bursts of
one stream would count (tests/streams/test_pairing.py)."""
LONG_AGO = -(2**63)
"""Stamp [ns] before all others"""


class PairedSample(NamedTuple):
    """Input of one tick."""

    load: LoadSample
    angle: float
    """Flexion angle [rad] at the load's stamp; see `AngleSample`"""
    height: float | None
    """Femoral height [m] at the load's stamp, with the displacement drive"""
    status: int
    """Bits of `Status`"""
    angles: tuple[AngleSample, ...]
    """Angle samples up to this stamp that belong to no earlier pair"""
    others: tuple[float, ...] = ()
    """Further numbers of the joints at the load's stamp; see `AngleSample`"""


Pairs = Iterator[PairedSample]
"""Pairs that are made one by one: all must be taken before the next sample is pushed, and `restart` may come between
two of them"""


class Synchroniser:
    """Takes the samples of two streams, and makes pairs in the order of the loads' stamps.

    The `Timeline` of each stream decides which samples are accepted, and when the stream has jumped. If the loads jump
    back, the run starts again from rest; if the angles do, the earlier angles are forgotten.
    """

    def __init__(self, pairing: PairingSection) -> None:
        """Begin without samples."""
        self.refused = Refusals()
        """Number of refused samples by reason"""
        self._max_gap = round(pairing.max_gap * NANOSECONDS)
        self._queue = pairing.queue
        self.angle_delay = round(pairing.angle_delay * NANOSECONDS)
        """Time [ns] by which the stamps of angles have been moved earlier"""
        self.angle_time: Timeline[AngleSample] = Timeline(
            self._max_gap, self._queue, self.refused, "angle"
        )
        self.load_time: Timeline[LoadSample] = Timeline(
            self._max_gap, self._queue, self.refused, "load"
        )
        self.clock_sets = ClockSets(self._max_gap, self._flag_apart)
        """Whether the clock of one stream was set by less than `pairing.max_gap`"""
        for time in (self.angle_time, self.load_time):
            time.on_doubt, time.on_settled = self._note_doubt, self._note_settled
        self.unrecorded_angles = 0
        """Number of angles in no pair, because more than `pairing.queue` came between two loads"""
        self.waiting_loads: deque[LoadSample] = deque()
        """Loads that wait for an angle"""
        self.angles: deque[AngleSample] = deque(maxlen=self._queue)
        """Angles from the last one before the next load on, or earlier"""
        self.unpaired_angles: deque[AngleSample] = deque()
        """Angles that belong to no pair yet"""
        self._earlier_angles: list[AngleSample] = []  # likewise, from before a jump
        self._last_load: int | None = None
        self.last_pair: int | None = None
        """Stamp [ns] of the last pair"""
        self.lasting = STATUS_OK
        """Bits of `Status` of every later pair; see `flag_from_now`"""
        self.on_flags: Callable[[], object] = lambda: None
        """Function that is called when `lasting` has changed"""
        self.on_unanswered: Callable[[], object] = lambda: None
        """Function that is called when a load has no answer, as no angle was before it"""
        self._lasting: dict[str, int] = {}
        self.clocks_differ = False
        """Whether the stamps of both streams differ by more than `pairing.max_gap`, although both come in turns"""
        self.newest_angle: int | None = None
        """Stamp [ns] of the message with the newest angle, whether it is accepted or not"""
        self.load_came_last = False
        """Whether the newest message had a load"""
        self._differing_since: int | None = None  # stamp of a load
        self._has_paired = False  # later loads before all angles are due to the clocks
        self._flags = STATUS_OK

    @property
    def unpaired(self) -> int:
        """Number of angles that belong to no pair yet."""
        return len(self._earlier_angles) + len(self.unpaired_angles)

    @property
    def all_unpaired(self) -> list[AngleSample]:
        """Angles that belong to no pair yet, also those from before a jump."""
        return [*self._earlier_angles, *self.unpaired_angles]

    @property
    def fill(self) -> float:
        """Fill of the fuller one of the queues, from 0 to 1 at `pairing.queue`."""
        return max(len(self.waiting_loads), self.unpaired) / self._queue

    @property
    def lead(self) -> float | None:
        """Last load's stamp minus the last angle's [s], as they came; None if unknown."""
        angle = self.angle_time.last
        load = self.load_time.last
        if angle is None or load is None:
            return None
        return (load - angle - self.angle_delay) / NANOSECONDS

    @property
    def is_steady(self) -> bool:
        """Whether nothing unusual has happened since the last pair; `resume` is allowed only then."""
        is_unusual = self._flags or self.lasting or self.refused.is_new or self._earlier_angles
        is_doubtful = self.angle_time.is_doubtful or self.load_time.is_doubtful
        is_doubtful = is_doubtful or self.clock_sets.due > 0 or self._differing_since is not None
        return not (is_unusual or is_doubtful)

    def resume(
        self,
        angles: Iterable[AngleSample],
        unpaired_angles: Iterable[AngleSample],
        waiting_loads: Iterable[LoadSample],
        last_pair: int | None,
    ) -> None:
        """Replace the queues by these samples, and continue after a pair at a stamp [ns].

        Call `resume` of `angle_time` and `load_time` before.
        """
        self.angles = deque(angles, maxlen=self._queue)
        self.unpaired_angles = deque(unpaired_angles)
        self.waiting_loads = deque(waiting_loads)
        self._last_load = last_pair if self.load_time.last is None else self.load_time.last
        self.last_pair = last_pair
        self._has_paired = True

    @property
    def will_restart(self) -> bool:
        """Whether the next tick starts from rest, although it may not be the first one."""
        return bool(self._flags & TIME_RESET)

    def restart(self) -> None:
        """Make the next tick start from rest, as after a jump back in time."""
        self.last_pair = None
        self._flags |= TIME_RESET

    def flag_from_now(self, reason: str, bits: int) -> None:
        """Give every later pair these bits of `Status` for a reason, until they are set to 0."""
        self._lasting[reason] = bits
        lasting = STATUS_OK
        for each in self._lasting.values():
            lasting |= each
        if lasting != self.lasting:
            self.lasting = lasting
            self.on_flags()

    def clear_streams(self) -> None:
        """Forget the last stamps, so that the streams may continue anywhere; to be called after `finish_streams`."""
        self.angle_time.clear_stream()
        self.load_time.clear_stream()
        self._last_load = None
        self._differing_since = None
        self._set_clocks_differ(False)
        self.clock_sets.clear()
        self.newest_angle = None

    def expect_recording(self) -> None:
        """Accept all samples, as a node has accepted those of its recording, which judged the clocks, too."""
        self.angle_time.is_recorded = self.load_time.is_recorded = True

    def clear_angles(self) -> None:
        """Stop using earlier angles; to be called after `clear_streams` if the streams are interrupted."""
        self._earlier_angles += self.unpaired_angles
        self.angles.clear()
        self.unpaired_angles.clear()
        self._has_paired = False

    def push_angle(self, sample: AngleSample) -> Pairs:
        """Take an angle; return the pairs that it makes possible."""
        self.newest_angle = sample.message_stamp
        self._compare_clocks(self.newest_angle, of_load=False)
        jumps = self.angle_time.jumps
        accepted = self.angle_time.push_sample(sample, self.load_time)
        if not self.load_time.held_back:
            return self._pairs_with_angles(accepted)
        loads = self.load_time.recheck_held_back(self.angle_time, self.angle_time.jumps > jumps)
        return itertools.chain(self._pairs_with_angles(accepted), self._pairs_with_loads(loads))

    def push_load(self, sample: LoadSample) -> Pairs:
        """Take a load; return the pairs that it makes possible."""
        self._compare_clocks(sample.stamp, of_load=True)
        jumps = self.load_time.jumps
        accepted = self.load_time.push_sample(sample, self.angle_time)
        if not self.angle_time.held_back:
            return self._pairs_with_loads(accepted)
        # The angles first: the loads may have to be answered with them.
        angles = self.angle_time.recheck_held_back(self.load_time, self.load_time.jumps > jumps)
        return itertools.chain(self._pairs_with_angles(angles), self._pairs_with_loads(accepted))

    def flush_expired(self, arrived_by: float = math.inf) -> Pairs:
        """Pair the waiting loads that arrived until a time [s] with the last angle before them.

        No angle at or after their stamps came in time. Loads that were held back for that long are accepted.
        """
        held_back = self.load_time.held_back
        if held_back and held_back[0].arrived <= arrived_by < math.inf:
            loads = self.load_time.accept_held_back()
            angles = self.angle_time.recheck_held_back(self.load_time, jumped=True)
            yield from self._pairs_with_angles(angles)
            yield from self._pairs_with_loads(loads)
        expired = itertools.takewhile(lambda load: load.arrived <= arrived_by, self.waiting_loads)
        yield from self._make_pairs(hold=True, most=len(list(expired)))

    def finish_streams(self) -> Pairs:
        """Pair everything that came, because no more samples will come; samples held back are accepted.

        Loads that waited before are not paired with angles that were held back.
        """
        if self.angle_time.held_back:
            yield from self.flush_expired()
        yield from self._pairs_with_angles(self.angle_time.accept_held_back())
        yield from self._pairs_with_loads(self.load_time.accept_held_back())
        yield from self.flush_expired()

    def _compare_clocks(self, stamp: int, of_load: bool) -> None:
        """Compare a stamp [ns], as it came, with the other stream's last one, if that came before it.

        If streams come in turns for a second and differ all that time, their clocks differ or one has a latency; after
        a jump at once, and at the beginning after some turns. With bursts this does not happen, as their last samples
        are at the other stream's time.
        """
        if of_load == self.load_came_last or self.load_time.is_recorded:
            return
        self.load_came_last = of_load
        last = self.angle_time.last if of_load else self.load_time.last
        if last is None:
            return
        other = last + self.angle_delay if of_load else last
        if abs(stamp - other) <= self._max_gap:
            since, self._differing_since = self._differing_since, None
            if self.clocks_differ:
                # The stamp may be wrong; but after a jump each burst has one that agrees.
                if since != LONG_AGO or not self.clock_sets.agree:
                    self._differing_since = LONG_AGO
                self._set_clocks_differ(False)
        elif of_load and (self._differing_since is None or stamp < self._differing_since):
            self._differing_since = stamp
        elif of_load and self._differing_since is not None:
            differ = stamp - self._differing_since >= DIFFERING_TIME
            leads = self.clock_sets.leads
            if len(leads) == FIRST_JUDGED:  # while bursts come in turns, every other lead agrees
                differ |= min(map(abs, leads)) > self._max_gap
            self._set_clocks_differ(differ or self.clocks_differ)
        if of_load and self.newest_angle is not None:
            self.clock_sets.add_lead(stamp, stamp - self.newest_angle)

    def _note_doubt(self) -> None:
        faster = min(self.angle_time.step_limit, self.load_time.step_limit)
        differ = self.clocks_differ or self._differing_since == LONG_AGO
        self.clock_sets.note_doubt(faster // LONG_STEP, None if differ else self.load_time.last)

    def _note_settled(self, step: int) -> None:
        """Judge the clocks after a step [ns]; if it is a jump, they differ as soon as their stamps do."""
        if not 0 < step <= self._max_gap:
            self._differing_since = LONG_AGO
        self.clock_sets.judge(not 0 < step <= 2 * self._max_gap)

    def _flag_apart(self) -> None:
        """Flag all answers while the clock of one stream is set beside the other; its step is no hole."""
        for time in (self.angle_time, self.load_time):
            time.holes.forget()
        self.flag_from_now("clock set", STALE_INPUT if self.clock_sets.apart else STATUS_OK)

    def _set_clocks_differ(self, differ: bool) -> None:
        self.clocks_differ = differ
        self.flag_from_now("clocks differ", STALE_INPUT if differ else STATUS_OK)

    def _pairs_with_angles(self, samples: Iterable[AngleSample]) -> Pairs:
        """Make the pairs that accepted angles make possible."""
        for sample in samples:
            if self.angles and sample.stamp <= self.angles[-1].stamp:
                yield from self.flush_expired()
                self.clear_angles()
            self.angles.append(sample)
            self.unpaired_angles.append(sample)
        while self.unpaired > self._queue:
            if self._earlier_angles:
                self._earlier_angles.pop(0)
            else:
                self.unpaired_angles.popleft()
            self.unrecorded_angles += 1
        if self.waiting_loads:
            yield from self._make_pairs(most=len(self.waiting_loads))

    def _pairs_with_loads(self, samples: Iterable[LoadSample]) -> Pairs:
        """Make the pairs that accepted loads make possible."""
        for sample in samples:
            if self._last_load is not None and sample.stamp <= self._last_load:
                yield from self.flush_expired()
                if self.last_pair is not None:
                    self.restart()
            self._last_load = sample.stamp
            if self.angles and sample.stamp < self.angles[0].stamp - self._max_gap:
                self._has_paired = True
            self.waiting_loads.append(sample)
        yield from self._make_pairs(most=len(self.waiting_loads))
        surplus = len(self.waiting_loads) - self._queue
        if surplus > 0:
            yield from self._make_pairs(hold=True, most=surplus)

    def _make_pairs(self, most: int, hold: bool = False) -> Pairs:
        """Pair the oldest loads, at most `most` of them; with `hold` also those whose angle is not known."""
        for _ in range(most):
            load = self.waiting_loads[0]
            found = self._angle_at(load.stamp, hold)
            if found is None:
                return
            self.waiting_loads.popleft()
            angle, status = found
            if angle is None:
                self.refused.count_refused("no_angle_before")
                self.on_unanswered()
                continue
            self._has_paired = True
            if self.last_pair is not None:
                if load.stamp - self.last_pair > self._max_gap:
                    status |= STALE_INPUT
                if load.stamp <= self.last_pair:  # a jump back whose own samples found no angle
                    status |= TIME_RESET
            self.last_pair = load.stamp
            angles = self._earlier_angles
            self._earlier_angles = []
            until = max(load.stamp, angle.stamp)
            while self.unpaired_angles and self.unpaired_angles[0].stamp <= until:
                angles.append(self.unpaired_angles.popleft())
            status |= self._flags | self.lasting
            if self.refused.is_new:
                status |= INPUT_REJECTED
            self._flags = STATUS_OK
            self.refused.is_new = False
            yield PairedSample(
                load, angle.angle, angle.height, status, tuple(angles), angle.others
            )

    def _angle_at(self, stamp: int, hold: bool) -> tuple[AngleSample | None, int] | None:
        """Angle at a stamp [ns], and its status bits; stamps of successive calls do not decrease.

        None while the angle is not known; with `hold` the last one is returned then. If there is no angle for the load
        at all, the first part of the result is None.
        """
        angles = self.angles
        while len(angles) > 1 and angles[1].stamp <= stamp:
            angles.popleft()
        if not angles:
            return (None, STATUS_OK) if hold else None
        before = angles[0]
        if before.stamp > stamp:  # the loads have jumped back alone, or began sooner
            return (
                (angles[-1], INPUT_HELD | STALE_INPUT) if self._has_paired else (None, STATUS_OK)
            )
        if before.stamp == stamp:
            return before, STATUS_OK
        if len(angles) > 1:
            after = angles[1]
            return _interpolate(before, after, stamp), self._stale(after.stamp - before.stamp)
        return (before, INPUT_HELD | self._stale(stamp - before.stamp)) if hold else None

    def _stale(self, gap: int) -> int:
        """Status bit of a gap [ns] between two samples."""
        return STALE_INPUT if gap > self._max_gap else STATUS_OK


def _interpolate(before: AngleSample, after: AngleSample, stamp: int) -> AngleSample:
    """Interpolate between two samples at a stamp [ns], linear in time."""
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    height = before.height
    if height is not None and after.height is not None:
        height += part * (after.height - height)
    angle = before.angle + part * (after.angle - before.angle)
    if not before.others:
        return before._replace(stamp=stamp, angle=angle, height=height)
    pairs = zip(before.others, after.others, strict=True)
    others = tuple([old + part * (new - old) for old, new in pairs])
    return before._replace(stamp=stamp, angle=angle, height=height, others=others)
