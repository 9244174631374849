"""Pairs loads and angles by stamp: every load gets the angle at its own stamp, interpolated between its two neighbours.

The `Timeline` of each stream decides by the stamps which samples to believe. A sample that continues the stream is
believed immediately. A stamp far ahead is wrong, or the stream has paused. A stamp far behind is wrong, or the clock
was set back, or a bag starts again. The following samples show which it is; until then the sample is kept aside. It is
believed as soon as the other stream is at the same time, or if for a while no sample continues the stream from the last
believed one. It is refused once a sample does.

No clock is used: pairs depend only on the samples and their order, and the caller decides when an angle is late
(`give_up`).
"""

from __future__ import annotations

import itertools
import math
import re
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import NANOSECOND, Status
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.parameters.sections import PairingSection
from knee_contact_ros.streams.frames import ForceFrame
from knee_contact_ros.streams.messages import (
    JOINT_STATE,
    WRENCH,
    JointState,
    RefusedSampleError,
    WrenchStamped,
)
from knee_contact_ros.streams.topics import JOINT_STATES, NANOSECONDS, Answer, Ending

STEPS = 8
"""Number of past steps that show how far the next one may go; the second longest counts, as one may be a pause"""
FAR = 3
"""Multiple of the second longest step beyond which a step is far"""
SILENT = 4
"""Samples kept aside are believed after this multiple of that step, or of the longest step among them"""
ENOUGH = 3
"""Number of samples of both streams that count as a jump of both; two wrong stamps do not. More samples than this of
one stream after a pause are no burst of wrong stamps either; then samples from within the pause are wrong"""
# Plain numbers: combining flags of an enumeration takes as long as the rest of a pairing.
OK, STALE_INPUT, TIME_RESET = int(Status.OK), int(Status.STALE_INPUT), int(Status.TIME_RESET)
INPUT_HELD, INPUT_REJECTED = int(Status.INPUT_HELD), int(Status.INPUT_REJECTED)


APART, MOST_LEADS = NANOSECONDS, 10_000
"""Time [ns] for which both streams must be apart before answers are flagged; largest number of `leads` kept"""


class AngleSample(NamedTuple):
    """Flexion angle at a stamp, and femoral height with the displacement drive."""

    stamp: int
    """Stamp [ns] at which the angle holds: that of the message minus `delay`, which may be negative"""
    angle: float
    """Flexion angle [rad], positive in flexion, without `knee.flexion_offset`, which the tick adds"""
    data: bytes = b""
    """Bytes of the message to record; the original bytes may have old memory of the sender between fields"""
    height: float | None = None
    """Height of the femoral reference point [m]; None with the force drive"""
    delay: int = 0
    """Delay of the angles `pairing.angle_delay` [ns]"""
    others: tuple[float, ...] = ()
    """Further numbers of the leg's joints [rad] or [N m], in the order of `leg_sample`"""

    @property
    def came_at(self) -> int:
        """Stamp [ns] of the message, under which it is recorded."""
        return self.stamp + self.delay


class LoadSample(NamedTuple):
    """Joint reaction at a stamp; it is split between the compartments once the flexion angle is known."""

    stamp: int
    """Stamp [ns]"""
    axial: float
    """Axial force -force.y [N], positive when it presses the femur onto the tibia"""
    moment: float
    """Frontal moment about x [N m]; NaN if it is not needed and was not given"""
    frame_id: str
    """Name of the tibia frame"""
    data: bytes = b""
    """Bytes of the message as it is recorded"""
    arrived: float = 0.0
    """Time of arrival by the caller's clock [s]"""
    wrench: WrenchStamped | None = None
    """The whole wrench, if more than the axial force is used"""
    doubtful: bool = False
    """Whether the sender says that the load is doubtful"""


class Refusals(Counter[str]):
    """Number of refused samples by reason."""

    is_new = False
    """Whether samples were refused since the last flagged pair"""

    def count(self, reason: str, number: int = 1) -> None:
        """Count samples that cannot be used; the next tick is flagged with them."""
        self[reason] += number
        self.is_new = True


S = TypeVar("S", bound=AngleSample | LoadSample)


class Timeline(Generic[S]):
    """Decides which samples of one stream to believe."""

    def __init__(self, max_gap: int, most: int, refused: Refusals, name: str) -> None:
        """Begin a stream.

        Args:
            max_gap: Largest time [ns] by which a sample may be behind and count as late.
            most: Largest number of samples that are kept aside.
            refused: Counts the samples that are refused.
            name: Name of the stream, with which the reasons begin.
        """
        self.last: int | None = None
        """Stamp [ns] of the last sample that was believed"""
        self.pending: list[S] = []
        """Samples that may be believed later, in increasing order of their stamps"""
        self.jumps = 0
        """Number of jumps of the stream"""
        self.steps: deque[int] = deque(maxlen=STEPS)
        """Last steps forward [ns]"""
        self.far = max_gap
        """Longest step [ns] that is not far"""
        self._max_gap, self._most, self._refused, self._name = max_gap, most, refused, name

    def take(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Take a sample; return the samples that are believed now, oldest first. `other` is the paired stream.

        If the stream has jumped back, the stamp of the first one is not later than the previous `last`.
        """
        stamp, last, aside = sample.stamp, self.last, self.pending
        late = False
        if last is not None:
            step = stamp - last
            near = 0 < step <= self.far
            if near or (step > 0 and other.has_reached(stamp)):
                passed: list[S] = []
                if aside and not (near and self._is_alone(other)):
                    passed = [one for one in aside if last < one.stamp < stamp]
                    self.drop_aside(but=len(passed))
                    for one in passed:
                        self._go_to(one.stamp)
                self._go_to(stamp)
                return [*passed, sample]
            late = -self._max_gap <= step <= 0 and not (aside and stamp > aside[-1].stamp)
        if (
            aside and not late and stamp <= aside[-1].stamp
        ):  # else the stream does not continue where it was
            late = self._is_late_aside(stamp)
            if not late:
                self.drop_aside()
        if late:
            self._refused.count(f"{self._name}_not_in_order")
            return []
        self.pending.append(sample)
        return self.believe(None if len(self.pending) >= self._most else self._believable(other))

    def look_again(self, other: Timeline[Any], jumped: bool) -> list[S]:
        """Return samples kept aside that are believed because the other stream has new samples, or has `jumped`."""
        if not self.pending:
            return []
        there = (
            jumped
            and other.last is not None
            and abs(self.pending[-1].stamp - other.last) <= self._max_gap
        )
        return self.believe(None if there else self._believable(other))

    def has_reached(self, stamp: int) -> bool:
        """Whether a stamp [ns] is at or before the expected next sample of this stream."""
        return self.last is not None and stamp <= self.last + self.far // FAR

    def believe(self, number: int | None = None) -> list[S]:
        """Believe the oldest samples of those kept aside, or all of them; return them."""
        if number == 0:
            return []
        believed, self.pending = (
            self.pending[:number],
            [] if number is None else self.pending[number:],
        )
        for sample in believed:
            self.jumps += (
                self.last is not None and not 0 < sample.stamp - self.last <= self._max_gap
            )
            if (
                self.last is not None and sample.stamp <= self.last
            ):  # the jumps on the way there are no steps
                self.go_on(self.last, [step for step in self.steps if step <= self._max_gap])
            self._go_to(sample.stamp)
        return believed

    def drop_aside(self, but: int = 0) -> None:
        """Refuse the samples that were kept aside, except a number of them (`but`)."""
        if len(self.pending) > but:
            self._refused.count(f"{self._name}_off_time", len(self.pending) - but)
        self.pending = []

    def go_on(self, last: int | None, steps: Iterable[int]) -> None:
        """Set the state to that after samples up to a stamp [ns] with these last steps [ns], none kept aside."""
        self.last = last
        self.steps = deque(steps, maxlen=STEPS)
        self.far = FAR * _longest_but_one(self.steps) if self.steps else self._max_gap

    def clear(self) -> None:
        """Forget everything; the samples that were kept aside are refused."""
        self.drop_aside()
        self.go_on(None, ())

    def _is_late_aside(self, stamp: int) -> bool:
        """Whether a sample belongs to those kept aside but is late; otherwise the stream does not continue there."""
        first, newest, many = (
            self.pending[0].stamp,
            self.pending[-1].stamp,
            len(self.pending) > ENOUGH,
        )
        before = (
            self.last if many and self.last is not None and self.last < first else first - self.far
        )
        return stamp == newest or (
            len(self.pending) > 1 and stamp >= max(before, newest - self._max_gap)
        )

    def _believable(self, other: Timeline[Any]) -> int:
        """Number of the oldest samples kept aside with which the stream continues."""
        first, newest, every = self.pending[0].stamp, self.pending[-1].stamp, len(self.pending)
        enough = self.last is None or every + len(other.pending) >= ENOUGH
        if other.pending and enough and abs(newest - other.pending[-1].stamp) <= self._max_gap:
            return every
        silence = 0  # time [ns] without a sample that continues the stream, after which those kept aside are believed
        if self.steps and every > 1:
            longest = max(after.stamp - before.stamp for before, after in pairwise(self.pending))
            silence = min(SILENT * max(_longest_but_one(self.steps), longest), self._max_gap)
        if every > 1 and (newest - first >= silence or self._is_alone(other)):
            return every
        at = self.last  # else the oldest that are not far from each other or from the other stream
        for number, sample in enumerate(self.pending):
            goes_on = at is not None and at < sample.stamp <= at + self.far
            if not (
                goes_on or ((at is None or at < sample.stamp) and other.has_reached(sample.stamp))
            ):
                return number
            at = sample.stamp
        return every

    def _is_alone(self, other: Timeline[Any]) -> bool:
        """Whether the samples kept aside are at the other stream's time, and those believed are not."""
        if self.last is None or other.last is None:
            return False
        return (
            abs(self.pending[-1].stamp - other.last) <= self._max_gap < abs(self.last - other.last)
        )

    def _go_to(self, stamp: int) -> None:
        if self.last is not None and stamp > self.last:
            step, steps = stamp - self.last, self.steps
            gone = steps[0] if len(steps) == STEPS else 0
            steps.append(step)
            if (
                FAR * step >= self.far or FAR * gone >= self.far or len(steps) <= 2
            ):  # else it stays as it is
                self.far = FAR * _longest_but_one(steps)
        self.last = stamp


def _longest_but_one(steps: deque[int]) -> int:
    """Second longest step [ns]; the only one if there is one."""
    return sorted(steps)[-2:][0]


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


class Synchroniser:
    """Takes the samples of two streams, and makes pairs in the order of the loads' stamps.

    The `Timeline` of each stream decides which samples are believed, and when the stream has jumped. If the loads jump
    back, the run starts again from rest; if the angles do, the earlier angles are forgotten.
    """

    def __init__(self, pairing: PairingSection) -> None:
        self.refused = Refusals()
        """Number of refused samples by reason"""
        self._max_gap, self._queue = round(pairing.max_gap * NANOSECONDS), pairing.queue
        self.angle_delay = round(pairing.angle_delay * NANOSECONDS)
        """Time [ns] by which the stamps of angles have been moved earlier"""
        self.angle_time: Timeline[AngleSample] = Timeline(
            self._max_gap, self._queue, self.refused, "angle"
        )
        self.load_time: Timeline[LoadSample] = Timeline(
            self._max_gap, self._queue, self.refused, "load"
        )
        self.unrecorded = 0
        """Number of angles in no pair, because more than `pairing.queue` came between two loads"""
        self.waiting: deque[LoadSample] = deque()
        """Loads that wait for an angle"""
        self.angles: deque[AngleSample] = deque(maxlen=self._queue)
        """Angles from the last one before the next load on, or earlier"""
        self.fresh: deque[AngleSample] = deque()
        """Angles that belong to no pair yet"""
        self._left: list[
            AngleSample
        ] = []  # likewise, from before a jump: they go to the next pair
        self._last_load: int | None = None
        self.last_pair: int | None = None
        """Stamp [ns] of the last pair"""
        self.apart = False
        """Whether the stamps of both streams differ by more than `pairing.max_gap`, although both come in turns"""
        self.leads: list[int] = []
        """Stamps of loads minus those of angles [ns], as they came in turns since the last report"""
        self._loads_came = False  # last
        self._apart_since: int | None = None  # stamp of a load
        self._met = (
            False  # loads before all angles are due to the clocks, and not to the beginning
        )
        self._flags = OK

    @property
    def fill(self) -> float:
        """Fill of the fuller one of the queues, from 0 to 1 at `pairing.queue`."""
        return max(len(self.waiting), len(self._left) + len(self.fresh)) / self._queue

    @property
    def lead(self) -> float | None:
        """Last load's stamp minus the last angle's [s], as they came; None if unknown."""
        angle, load = self.angle_time.last, self.load_time.last
        return (
            None
            if angle is None or load is None
            else (load - angle - self.angle_delay) / NANOSECONDS
        )

    def _compare(self, stamp: int, of_load: bool) -> None:
        """Compare a stamp [ns], as it came, with the other stream's last one, if that came before it.

        If streams come in turns for a second and are apart all that time, their clocks differ or one has a latency.
        With bursts this does not happen, as their last samples are at the other stream's time.
        """
        if of_load == self._loads_came:
            return
        self._loads_came = of_load
        last = self.angle_time.last if of_load else self.load_time.last
        if last is None:
            return
        other = last + self.angle_delay if of_load else last
        if abs(stamp - other) <= self._max_gap:
            self._apart_since, self.apart = None, False
        elif of_load and (self._apart_since is None or stamp < self._apart_since):
            self._apart_since = stamp
        elif of_load and self._apart_since is not None:
            self.apart |= stamp - self._apart_since >= APART
        if of_load and len(self.leads) < MOST_LEADS:
            self.leads.append(stamp - other)

    @property
    def is_steady(self) -> bool:
        """Whether nothing unusual has happened since the last pair; `go_on` is allowed only then."""
        unusual = self._flags or self.refused.is_new or self._left or self._apart_since is not None
        return not (unusual or self.angle_time.pending or self.load_time.pending)

    def go_on(
        self,
        angles: Iterable[AngleSample],
        fresh: Iterable[AngleSample],
        waiting: Iterable[LoadSample],
        last_pair: int,
    ) -> None:
        """Replace `angles`, `fresh` and `waiting` by these samples, and continue after a pair at a stamp [ns].

        Call `go_on` of `angle_time` and `load_time` before.
        """
        self.angles, self.fresh, self.waiting = (
            deque(angles, maxlen=self._queue),
            deque(fresh),
            deque(waiting),
        )
        self._last_load, self.last_pair, self._met = self.load_time.last, last_pair, True

    def start_anew(self) -> None:
        """Make the next tick start from rest, as after a jump back in time."""
        self.last_pair = None
        self._flags |= TIME_RESET

    def forget(self) -> None:
        """Forget the last stamps, so that the streams may continue anywhere; to be called after `finish`."""
        self.angle_time.clear()
        self.load_time.clear()
        self._last_load, self._apart_since, self.apart = None, None, False

    def forget_angles(self) -> None:
        """Stop using earlier angles; to be called after `forget` if the streams are interrupted."""
        self._left += self.fresh
        self.angles.clear()
        self.fresh.clear()
        self._met = False

    def push_angle(self, sample: AngleSample) -> list[PairedSample]:
        """Take an angle; return the pairs that it makes possible."""
        self._compare(sample.came_at, of_load=False)
        jumps = self.angle_time.jumps
        pairs = self._take_angles(self.angle_time.take(sample, self.load_time))
        if not self.load_time.pending:
            return pairs
        jumped = self.angle_time.jumps > jumps
        return pairs + self._take_loads(self.load_time.look_again(self.angle_time, jumped))

    def push_load(self, sample: LoadSample) -> list[PairedSample]:
        """Take a load; return the pairs that it makes possible."""
        self._compare(sample.stamp, of_load=True)
        jumps = self.load_time.jumps
        believed = self.load_time.take(sample, self.angle_time)
        if not self.angle_time.pending:
            return self._take_loads(believed)
        # The angles first: the loads may have to be answered with them.
        jumped = self.load_time.jumps > jumps
        pairs = self._take_angles(self.angle_time.look_again(self.load_time, jumped))
        return pairs + self._take_loads(believed)

    def give_up(self, arrived_by: float = math.inf) -> list[PairedSample]:
        """Pair the waiting loads that arrived until a time [s] with the last angle before them.

        No angle at or after their stamps came in time. Loads that were kept aside for that long are believed.
        """
        pending = self.load_time.pending
        if pending and pending[0].arrived <= arrived_by < math.inf:
            jumped = self.load_time.believe()
            angles = self._take_angles(self.angle_time.look_again(self.load_time, jumped=True))
            return angles + self._take_loads(jumped) + self.give_up(arrived_by)
        number = sum(
            1 for _ in itertools.takewhile(lambda load: load.arrived <= arrived_by, self.waiting)
        )
        return self._pairs(hold=True, most=number)

    def finish(self) -> list[PairedSample]:
        """Pair everything that came, because no more samples will come; samples kept aside are believed.

        Loads that waited before are not paired with angles that were kept aside.
        """
        pairs = self.give_up() if self.angle_time.pending else []
        pairs += self._take_angles(self.angle_time.believe())
        return pairs + self._take_loads(self.load_time.believe()) + self.give_up()

    def rest(self) -> list[AngleSample]:
        """Remove and return the angle samples that belong to no pair, at the end of a stream."""
        rest = [*self._left, *self.fresh]
        self.fresh.clear()
        self._left = []
        return rest

    def _take_angles(self, samples: Sequence[AngleSample]) -> list[PairedSample]:
        pairs = []
        for sample in samples:
            if self.angles and sample.stamp <= self.angles[-1].stamp:
                pairs += self.give_up()
                self.forget_angles()
            self.angles.append(sample)
            self.fresh.append(sample)
        while len(self._left) + len(self.fresh) > self._queue:
            self._left.pop(0) if self._left else self.fresh.popleft()
            self.unrecorded += 1
        return pairs + self._pairs() if self.waiting else pairs

    def _take_loads(self, samples: Sequence[LoadSample]) -> list[PairedSample]:
        pairs = []
        for sample in samples:
            if self._last_load is not None and sample.stamp <= self._last_load:
                pairs += self.give_up()
                self.start_anew()
            self._last_load = sample.stamp
            self._met |= bool(self.angles) and sample.stamp < self.angles[0].stamp - self._max_gap
            self.waiting.append(sample)
        pairs += self._pairs()
        if (surplus := len(self.waiting) - self._queue) > 0:
            pairs += self._pairs(hold=True, most=surplus)
        return pairs

    def _pairs(self, hold: bool = False, most: int | None = None) -> list[PairedSample]:
        """Pair the oldest loads, at most `most` of them; with `hold` also those whose angle is not known."""
        pairs: list[PairedSample] = []
        for _ in range(len(self.waiting) if most is None else most):
            load = self.waiting[0]
            result = self._angle_at(load.stamp, hold)
            if result is None:
                break
            self.waiting.popleft()
            pose, status = result
            if pose is None:
                self.refused.count("no_angle_before")
                continue
            self._met = True
            if self.last_pair is not None and load.stamp - self.last_pair > self._max_gap:
                status |= STALE_INPUT
            self.last_pair = load.stamp
            taken, self._left, until = self._left, [], max(load.stamp, pose.stamp)
            while self.fresh and self.fresh[0].stamp <= until:
                taken.append(self.fresh.popleft())
            status |= self._flags | (STALE_INPUT if self.apart else OK)
            status |= INPUT_REJECTED if self.refused.is_new else OK
            pairs.append(
                PairedSample(load, pose.angle, pose.height, status, tuple(taken), pose.others)
            )
            self._flags, self.refused.is_new = OK, False
        return pairs

    def _angle_at(self, stamp: int, hold: bool) -> tuple[AngleSample | None, int] | None:
        """Angle at a stamp [ns], and its status bits; stamps of successive calls do not decrease.

        None while the angle is not known; with `hold` the last one is returned then. If there is no angle for the load
        at all, the first part of the result is None.
        """
        angles = self.angles
        while len(angles) > 1 and angles[1].stamp <= stamp:
            angles.popleft()
        if not angles:
            return (None, OK) if hold else None
        before, after = angles[0], angles[1] if len(angles) > 1 else None
        if before.stamp > stamp:  # the loads have jumped back alone, or began sooner
            return (angles[-1], INPUT_HELD | STALE_INPUT) if self._met else (None, OK)
        if before.stamp == stamp:
            return before, OK
        if after is not None:
            return _between(before, after, stamp), self._stale(after.stamp - before.stamp)
        return (before, INPUT_HELD | self._stale(stamp - before.stamp)) if hold else None

    def _stale(self, gap: int) -> int:
        return STALE_INPUT if gap > self._max_gap else OK


def _between(before: AngleSample, after: AngleSample, stamp: int) -> AngleSample:
    """Interpolate between two samples at a stamp [ns], linear in time."""
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    height = before.height
    if height is not None and after.height is not None:
        height += part * (after.height - height)
    angle = before.angle + part * (after.angle - before.angle)
    if not before.others:
        return before._replace(stamp=stamp, angle=angle, height=height)
    others = tuple(
        [old + part * (new - old) for old, new in zip(before.others, after.others, strict=True)]
    )
    return before._replace(stamp=stamp, angle=angle, height=height, others=others)


DIFFERENT_ANGLES, DIFFERENT_FORCES = 0.03, 50.0
"""Differences [rad] and [N] above which two publishers disagree"""
UNSURE = 4.0
"""Multiple of these unless there are known to be two publishers: one sensor may be noisy"""
SHORT = 0.05
"""Longest time [s] in which a quantity cannot change and change back"""
BACK = 0.5
"""Largest fraction of a change that remains after the way back"""
OFTEN, TOLD_FROM = 0.05, 10
"""Fraction and number of alternating samples above which they are reported"""
MOST = 8192
"""Number of samples that are checked together"""


class Publishers:
    """Detects that several publishers of one quantity disagree, so that samples alternate.

    A message does not say who sent it. But a knee does not turn forth, back and forth again between samples; if samples
    do so often, they come from two sources.
    """

    def __init__(self, topic: str, difference: float, unit: str) -> None:
        """Begin without samples of a topic, whose publishers disagree above a `difference` in a unit."""
        self._topic, self._difference, self._unit = topic, difference, unit
        self._waiting: list[tuple[int, float]] = []  # samples that have yet to be looked at
        self._last = np.empty(0, np.int64), np.empty(0)  # the last two of those that were
        self._samples = 0
        self._found = np.empty(0)  # sizes of the changes back and forth

    def add(self, stamp: int, value: float) -> None:
        """Add a sample with its stamp [ns]."""
        self._waiting.append((stamp, value))
        if len(self._waiting) >= MOST:
            self.look()

    def look(self) -> None:
        """Check the samples that have come since the last check."""
        waiting, self._waiting = self._waiting, []
        self.add_all(
            np.array([stamp for stamp, _ in waiting], np.int64),
            np.array([value for _, value in waiting]),
        )

    def add_all(self, stamps: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Add many samples, shape (n,), and check them."""
        if self._waiting:
            self.look()
        stamps, values = np.append(self._last[0], stamps), np.append(self._last[1], values)
        self._last = stamps[-2:], values[-2:]
        if len(stamps) < 3:
            return
        steps, lasts = np.diff(values), stamps[2:] - stamps[:-2]
        sizes = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:]))
        left = np.abs(steps[:-1] + steps[1:])
        found = (
            (sizes > self._difference)
            & (left < BACK * sizes)
            & (np.abs(lasts) * NANOSECOND < SHORT)
        )
        self._samples += len(lasts)
        self._found = np.concatenate([self._found, sizes[found]])[-MOST:]

    def sentence(self, several: str = "", joint: str = "") -> str:
        """Sentence that publishers disagree; empty if they agree. `several`: it is known that there are several.

        It is about the samples up to the last `look`.
        """
        found = self._found if several else self._found[self._found > UNSURE * self._difference]
        if len(found) < max(TOLD_FROM, OFTEN * min(self._samples, MOST)):
            return ""
        what = f"the joint {joint!r} of {self._topic}" if joint else self._topic
        apart = float(np.median(found))
        often = f"{what} goes back and forth by about {apart:.{0 if apart >= 10 else 2}f} {self._unit} between samples"
        if several:
            return f"{often}: {several} send it and disagree; remap or stop one of them"
        return f"{often}: do two publishers send it, or is the sensor that noisy?"

    def forget(self) -> None:
        """Forget what was found; called once a second live, so that a sentence is about now."""
        self._samples, self._found = 0, np.empty(0)


class Pipeline(ABC):
    """Base of all computations on two streams: samples are refused or paired, and pairs are answered."""

    def __init__(
        self, force_topic: str, parameters: Parameters | LoadParameters, frame: ForceFrame
    ) -> None:
        """Begin without samples."""
        self.force_topic = force_topic
        angles, forces = parameters.inputs()
        self.sources = {JOINT_STATES: angles.topic, force_topic: forces.topic}
        """Topics from which the inputs come, by their usual names, for the sentences about refused samples"""
        self.frame = frame
        self.synchroniser = Synchroniser(parameters.pairing)
        self.ticks = 0
        self.angles_seen = Publishers(JOINT_STATES, DIFFERENT_ANGLES, "rad")
        """Whether the angles come from publishers that disagree"""
        self.forces_seen = Publishers(force_topic, DIFFERENT_FORCES, "N")
        """Whether the forces come from publishers that disagree"""
        self.stamp: int | None = None
        """Stamp [ns] of the last message; None if its bytes are not a message"""
        self.last_refusal = ""
        self._pending: deque[PairedSample] = deque()  # what is being answered

    @abstractmethod
    def angle_sample(self, message: JointState, data: bytes) -> AngleSample:
        """Sample of a JointState that is recorded as `data`; raises RefusedSampleError."""

    @abstractmethod
    def load_sample(self, message: WrenchStamped, data: bytes, arrived: float) -> LoadSample:
        """Sample of a WrenchStamped in the wanted frame; see `take_force`; raises RefusedSampleError."""

    def take_joint_state(self, data: bytes) -> list[PairedSample]:
        """Take the bytes of a JointState; return the pairs that it makes possible, to be computed one by one."""
        self.stamp = None
        try:
            message, recorded = JOINT_STATE.read(data, JOINT_STATES)
            self.stamp = message.stamp
            if not message.stamp:
                self._refuse_unset(JOINT_STATES)
            sample = self.angle_sample(message, recorded)
            self.angles_seen.add(message.stamp, sample.angle)
        except RefusedSampleError as refused:
            return self.refuse(refused)
        return self.synchroniser.push_angle(sample)

    def take_force(self, data: bytes, arrived: float = 0.0) -> list[PairedSample]:
        """Take the bytes of a WrenchStamped that arrived at a time [s] by the caller's clock; return the pairs."""
        self.stamp = None
        try:
            came, as_it_came = WRENCH.read(data, self.force_topic)
            self.stamp = came.stamp
            if not came.stamp:
                self._refuse_unset(self.force_topic)
            wrench, recorded = self.frame.turned(came, as_it_came)
            sample = self.load_sample(wrench, recorded, arrived)
            self.forces_seen.add(came.stamp, sample.axial)
        except RefusedSampleError as refused:
            return self.refuse(refused)
        if self.frame.is_held:
            return self.synchroniser.push_load(sample)
        refused_before = self.refused
        pairs = self.synchroniser.push_load(sample)
        if self.refused == refused_before:
            self.frame.hold(came.frame_id)  # all others are expected in it
        return pairs

    @abstractmethod
    def compute(self, pair: PairedSample) -> list[bytes]:
        """Compute a tick; return the bytes of its messages."""

    @abstractmethod
    def answer(
        self, pair: PairedSample, messages: Sequence[bytes], latency: float = 0.0
    ) -> Answer:
        """Answer of the tick that was computed last: its `messages`, and the inputs that led to them.

        `latency` [s] is the time from the arrival of the force to the publication, where it is measured.
        """

    def check(self, parameters: Any) -> None:  # noqa: B027
        """Check that `retune` will accept these parameters; raises the reason if not, and changes nothing."""

    @abstractmethod
    def retune(self, parameters: Any) -> None:
        """Continue with changed numbers among the parameters, between two ticks."""

    def _refuse_unset(self, topic: str) -> None:
        """Refuse a sample with the stamp 0, unless it may be the first one of a recording that begins there.

        Raises:
            RefusedSampleError: the last sample of the topic also has that stamp.
        """
        time = (
            self.synchroniser.load_time
            if topic == self.force_topic
            else self.synchroniser.angle_time
        )
        delay = 0 if topic == self.force_topic else self.synchroniser.angle_delay
        if time.last == -delay or any(sample.stamp == -delay for sample in time.pending):
            raise RefusedSampleError("no_stamp", f"{topic}: header.stamp is not set (0)")

    @property
    def refused(self) -> int:
        """Number of refused samples."""
        return self.synchroniser.refused.total()

    def refuse(self, refused: RefusedSampleError) -> list[PairedSample]:
        """Count a sample that cannot be used; it makes no pairs."""
        self.synchroniser.refused.count(refused.reason)
        topic, *_ = re.split("[: ]", str(refused), maxsplit=1)
        self.last_refusal = self.sources.get(topic, topic) + str(refused).removeprefix(topic)
        return []

    def joint_state(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a JointState; yield the answers that it makes possible."""
        return self._answers(self.take_joint_state(data))

    def force(self, data: bytes) -> Iterator[Answer]:
        """Take the bytes of a WrenchStamped; yield the answers that it makes possible."""
        return self._answers(self.take_force(data))

    def finish(self) -> Iterator[Answer]:
        """Yield the answers to all waiting samples, because no more will come."""
        self.angles_seen.look()
        self.forces_seen.look()
        return self._answers(self.synchroniser.finish())

    def reset(self) -> None:
        """Restart from rest at the next tick, which is flagged (`TIME_RESET`), with forces in any frame."""
        self.frame.forget()
        if self._pending:
            self._pending[0] = self._pending[0]._replace(
                status=self._pending[0].status | TIME_RESET
            )
        else:
            self.synchroniser.start_anew()

    def ending(self) -> Ending:
        """End of a recording: the angles that belong to no answer, and the counts of refused samples."""
        inputs = tuple(
            (JOINT_STATES, sample.came_at, sample.data) for sample in self.synchroniser.rest()
        )
        return Ending(inputs, dict(self.synchroniser.refused))

    def _answers(self, pairs: Sequence[PairedSample]) -> Iterator[Answer]:
        self._pending.extend(pairs)
        while self._pending:
            pair = self._pending.popleft()
            yield self.answer(pair, self.compute(pair))
