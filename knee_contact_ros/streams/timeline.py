"""Samples of a stream, and the decision which of them are accepted.

The `Timeline` of each stream decides by the stamps. A sample that continues the stream is accepted at once. A stamp far
ahead is wrong, or the stream has paused. A stamp far behind is wrong, or the clock was set back, or a bag starts again.
The following samples show which it is; until then the sample is held back. It is accepted as soon as the other stream
is at the same time, or if for a while no sample continues the stream from the last accepted one. It is rejected once a
sample does.

No clock is used: the decision depends only on the samples of both streams and their order.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any, Generic, NamedTuple, TypeVar

from .holes import STEPS, Holes
from .messages import WrenchStamped

LONG_STEP = 3
"""Multiple of the usual step beyond which a step is long. Tuned; `studies.pairing` would notice."""
SILENT_STEPS = 4
"""Samples held back are accepted when they span this multiple of the usual step, or of the longest step among them.
Tuned; `studies.pairing` would notice."""
JUMP_SAMPLES = 3
"""Number of samples of both streams that count as a jump of both, as two wrong stamps may coincide. If more samples
than this of one stream follow a pause, they are not a burst of wrong stamps either; then samples from within the pause
are wrong. Tuned; `studies.pairing` would notice."""


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
    def message_stamp(self) -> int:
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

    def count_refused(self, reason: str, number: int = 1) -> None:
        """Count samples that cannot be used; the next tick is flagged with them."""
        self[reason] += number
        self.is_new = True


S = TypeVar("S", bound=AngleSample | LoadSample)


class Timeline(Generic[S]):
    """Decides which samples of one stream are accepted."""

    def __init__(self, max_gap: int, max_held_back: int, refused: Refusals, name: str) -> None:
        """Begin a stream.

        Args:
            max_gap: Largest time [ns] by which a sample may be behind and count as late.
            max_held_back: Largest number of samples that are held back.
            refused: Counts the samples that are rejected.
            name: Name of the stream, with which the reasons begin.
        """
        self.last: int | None = None
        """Stamp [ns] of the last accepted sample"""
        self.held_back: list[S] = []
        """Samples that may be accepted later, in increasing order of their stamps"""
        self.jumps = 0
        """Number of jumps of the stream"""
        self.last_jump = 0
        """Step [ns] of the last jump"""
        self.steps: deque[int] = deque(maxlen=STEPS)
        """Last steps forward [ns]"""
        self.holes = Holes(max_gap)
        """Counts samples that are missing"""
        self.is_recorded = False
        """Whether all samples are those that a node has accepted, in its recording"""
        self.is_doubtful = False
        """Whether the newest sample did not continue the stream, or samples are held back"""
        self.on_doubt: Callable[[], object] = lambda: None
        """Function that is called when a sample does not continue the stream"""
        self.on_settled: Callable[[int], object] = lambda _: None
        """Function that is called when the stream goes on after such a sample, with the step [ns] there"""
        self.step_limit = max_gap
        """Longest step [ns] that continues the stream"""
        self._max_gap = max_gap
        self._max_held_back = max_held_back
        self._refused = refused
        self._name = name

    def push_sample(self, sample: S, other: Timeline[Any]) -> list[S]:
        """Take a sample; return the samples that are accepted now, oldest first. `other` is the paired stream.

        If the stream has jumped back, the stamp of the first one is not later than the previous `last`.
        """
        if self.is_recorded:
            self._accept(sample.stamp)
            return [sample]
        stamp = sample.stamp
        last = self.last
        held_back = self.held_back
        is_late = False
        if last is not None:
            step = stamp - last
            continues = 0 < step <= self.step_limit
            if continues or (step > 0 and other.has_reached(stamp)):
                between: list[S] = []
                if self.is_doubtful or not continues:
                    between = self._accept_between(last, stamp, continues, other)
                self._advance_to(stamp)
                return [*between, sample]
            # Behind the last one, but not if it goes on from those held back
            is_late = -self._max_gap <= step <= 0 and not (
                held_back and 0 < stamp - held_back[-1].stamp <= self._max_gap
            )
        if held_back and not is_late:
            is_late = self._is_late_among_held_back(stamp)
            if not (is_late or self._follows_held_back(stamp)):
                self._reject_held_back(len(held_back))
        if not self.is_doubtful:
            self._doubt()
        if is_late:
            self.holes.note_late(last or 0)
            self._refused.count_refused(f"{self._name}_not_in_order")
            return []
        self.held_back.append(sample)
        if len(self.held_back) >= self._max_held_back:
            return self.accept_held_back()
        return self.accept_held_back(self._acceptable(other))

    def recheck_held_back(self, other: Timeline[Any], jumped: bool) -> list[S]:
        """Return samples held back that are accepted because the other stream has new samples, or has `jumped`."""
        if not self.held_back:
            return []
        if jumped and self._newest_is_near(other.last):
            return self.accept_held_back()
        return self.accept_held_back(self._acceptable(other))

    def has_reached(self, stamp: int) -> bool:
        """Whether a stamp [ns] is at or before the expected next sample of this stream."""
        return self.last is not None and stamp <= self.last + self.step_limit // LONG_STEP

    def accept_held_back(self, number: int | None = None) -> list[S]:
        """Accept the oldest samples of those held back, or all of them; return them."""
        if number == 0:
            return []
        accepted = self.held_back[:number]
        self.held_back = [] if number is None else self.held_back[number:]
        if accepted and self.last is not None:
            self._settle(accepted[0].stamp - self.last)
        for sample in accepted:
            self._accept(sample.stamp)
        return accepted

    def resume(self, last: int | None, steps: Iterable[int]) -> None:
        """Continue after samples up to a stamp [ns] with these last steps [ns], with none held back."""
        self.last = last
        self.steps = deque(steps, maxlen=STEPS)
        self.holes.is_open = False
        self.step_limit = LONG_STEP * _usual_step(self.steps) if self.steps else self._max_gap

    def clear_stream(self) -> None:
        """Forget everything; the samples that were held back are rejected."""
        self._reject_held_back(len(self.held_back))
        self.resume(None, ())
        self.is_doubtful = False

    def _accept(self, stamp: int) -> None:
        """Let a stamp [ns] be the last one, which may be a jump."""
        if self.last is not None:
            if not 0 < stamp - self.last <= self._max_gap:
                self.jumps += 1
                self.last_jump = stamp - self.last
            if stamp <= self.last:  # steps longer than `max_gap` came from jumps
                self.resume(self.last, [step for step in self.steps if step <= self._max_gap])
        self._advance_to(stamp)

    def _accept_between(
        self, last: int, stamp: int, continues: bool, other: Timeline[Any]
    ) -> list[S]:
        """Accept the samples held back between the last stamp [ns] and the next one, with which the stream goes on."""
        between: list[S] = []
        if self.held_back and not (continues and self._has_jumped_to(other)):
            between = [one for one in self.held_back if last < one.stamp < stamp]
            self._reject_held_back(len(self.held_back) - len(between))
            for one in between:
                self._advance_to(one.stamp)
        self._settle(stamp - last)
        return between

    def _doubt(self) -> None:
        self.is_doubtful = True
        self.holes.clock_is_set = False
        self.on_doubt()

    def _settle(self, step: int) -> None:
        """Continue after samples, or with one, that did not continue the stream."""
        if not self.is_doubtful:
            self._doubt()
        self.is_doubtful = bool(self.held_back)
        self.on_settled(step)

    def _reject_held_back(self, rejected: int) -> None:
        """Hold no samples back any more, and count this number of them as refused."""
        if rejected:
            self._refused.count_refused(f"{self._name}_off_time", rejected)
        self.held_back = []

    def _is_late_among_held_back(self, stamp: int) -> bool:
        """Whether a sample belongs to those held back but is late; otherwise the stream does not continue there."""
        first = self.held_back[0].stamp
        newest = self.held_back[-1].stamp
        begin = first - self.step_limit
        if len(self.held_back) > JUMP_SAMPLES and self.last is not None and self.last < first:
            begin = self.last
        is_within = max(begin, newest - self._max_gap) <= stamp < newest
        return stamp == newest or (len(self.held_back) > 1 and is_within)

    def _follows_held_back(self, stamp: int) -> bool:
        """Whether a sample may continue the stream with those held back, and is not nearer to the last accepted one.

        The step from that is too long if samples were lost.
        """
        step = stamp - self.held_back[-1].stamp
        is_near = self.last is not None and 0 < stamp - self.last <= self._max_gap
        return step > 0 and not (is_near and step > self._max_gap)

    def _acceptable(self, other: Timeline[Any]) -> int:
        """Number of the oldest samples held back with which the stream continues."""
        held_back = self.held_back
        every = len(held_back)
        is_enough = self.last is None or every + len(other.held_back) >= JUMP_SAMPLES
        if other.held_back and is_enough and self._newest_is_near(other.held_back[-1].stamp):
            return every
        if every > 1:
            # Time [ns] without a sample that continues the stream from `last`.
            silence = 0
            if self.steps:
                longest = max(after.stamp - before.stamp for before, after in pairwise(held_back))
                silence = min(SILENT_STEPS * max(_usual_step(self.steps), longest), self._max_gap)
            span = held_back[-1].stamp - held_back[0].stamp
            if span >= silence or self._has_jumped_to(other):
                return every
        # Else the oldest that are not far from each other or from the other stream.
        last = self.last
        for number, sample in enumerate(held_back):
            continues = last is not None and last < sample.stamp <= last + self.step_limit
            is_later = last is None or last < sample.stamp
            if not (continues or (is_later and other.has_reached(sample.stamp))):
                return number
            last = sample.stamp
        return every

    def _newest_is_near(self, stamp: int | None) -> bool:
        """Whether the newest sample held back is at the time of a stamp [ns] of the other stream."""
        return stamp is not None and abs(self.held_back[-1].stamp - stamp) <= self._max_gap

    def _has_jumped_to(self, other: Timeline[Any]) -> bool:
        """Whether the samples held back are at the other stream's time, and those accepted are not."""
        if self.last is None or other.last is None:
            return False
        return self._newest_is_near(other.last) and abs(self.last - other.last) > self._max_gap

    def _advance_to(self, stamp: int) -> None:
        """Let a stamp [ns] be the last one, and remember the step to it."""
        if self.last is not None and stamp > self.last:
            step = stamp - self.last
            steps = self.steps
            usual = self.step_limit // LONG_STEP
            if self.holes.is_open or (5 * usual < 4 * step and len(steps) == STEPS):
                self.holes.add_step(step, steps, self.last)
            dropped = steps[0] if len(steps) == STEPS else 0
            steps.append(step)
            # Sorting is left out where the second longest step stays: a new one of its length changes nothing.
            if len(steps) <= 2 or step > usual or step < usual <= dropped:
                self.step_limit = LONG_STEP * _usual_step(steps)
        self.last = stamp


def _usual_step(steps: deque[int]) -> int:
    """Second longest step [ns], as the longest may be a pause; the only one if there is one."""
    return sorted(steps)[-2] if len(steps) > 1 else steps[0]
