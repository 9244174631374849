"""Which samples of a stream are believed, at once or when more is known."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import pytest

from knee_contact_ros.streams.pairing import STEPS, Timeline

MS = 1_000_000


class Sample(NamedTuple):
    stamp: int


class Stream:
    """A timeline with what it refuses; stamps in ms."""

    def __init__(self, *stamps: float, max_gap: float = 100) -> None:
        self.refused: Counter[str] = Counter()
        self.time: Timeline[Sample] = Timeline(round(max_gap * MS), 100, self._count, "angle")
        for stamp in stamps:
            self.take(stamp)

    def _count(self, reason: str) -> None:
        self.refused[reason] += 1

    def take(self, stamp: float, other: Stream | None = None) -> list[float]:
        """What is believed with this stamp."""
        believed = self.time.take(Sample(round(stamp * MS)), (other or SILENT).time)
        return [sample.stamp / MS for sample in believed]

    def look_again(self, other: Stream, jumped: bool = False) -> list[float]:
        return [sample.stamp / MS for sample in self.time.look_again(other.time, jumped)]


SILENT = Stream()
"""Another stream of which nothing is known"""
TEN = range(0, 100, 10)


def running() -> Stream:
    """A stream at 100 Hz up to 90 ms."""
    return Stream(*TEN)


def test_two_samples_make_a_stream() -> None:
    stream = Stream()
    assert stream.take(5) == []
    assert stream.take(9) == [5, 9]
    assert stream.take(13) == [13]


def test_one_sample_makes_a_stream_where_the_other_one_is() -> None:
    other = Stream(0, 1, 2)
    assert Stream().take(3, other) == [3]
    assert Stream().take(40, other) == []


def test_a_sample_far_ahead_is_refused_when_the_stream_goes_on_as_before() -> None:
    stream = running()
    assert stream.take(300) == []
    assert stream.take(100) == [100]
    assert stream.refused == {"angle_off_time": 1}
    assert stream.take(110) == [110]


def test_three_samples_ahead_are_refused_although_the_next_one_is_far_from_the_last_one_too() -> None:
    stream = running()
    assert [stream.take(stamp) for stamp in (170, 180, 190, 130, 140)] == [[], [], [], [], []]
    assert stream.refused == {"angle_off_time": 3}
    assert stream.take(150, Stream(*range(100, 160, 10))) == [130, 140, 150]


@pytest.mark.parametrize(
    "steps", [(30, 10), (20_000, 10, 10), (30, 10, 10, 300, 10), (10, 10, 10, 10, 10, 10, 10, 10, 40)]
)
def test_how_far_is_far_depends_on_the_last_steps_alone(steps: tuple[int, ...]) -> None:
    stream, at = Stream(0, max_gap=10**6), 0
    for step in steps:
        at += step
        stream.take(at, Stream(at))
    again = Stream()
    again.time.go_on(stream.time.last, stream.time.steps)
    assert stream.time.far == again.time.far


def test_two_pauses_do_not_make_a_second_publisher_a_part_of_the_stream() -> None:
    stream, other = running(), Stream(*TEN)
    for at in (*range(100, 700, 10),):
        other.take(at, stream)
        stream.look_again(other)
        if at in (390, 700):
            stream.take(at, other)
    jumps = stream.time.jumps
    for at in range(700, 2700, 10):
        other.take(at, stream)
        stream.take(at + 1, other)
        stream.take(at + 156, other)
    assert stream.time.jumps <= jumps + 4


def test_a_clock_that_is_set_is_followed_also_if_little_may_be_kept_aside() -> None:
    stream = Stream(*TEN, 150, 160, 220, 230)  # steps of 10 with two pauses: four of 60 are more than ten samples
    stream.time._most = 5
    assert [stream.take(5000 + 10 * number) for number in range(5)][-1]
    assert stream.refused == {}


def test_one_that_is_far_and_that_the_other_stream_has_reached_leaves_no_later_one_aside() -> None:
    """They came out of order: the later one is refused, and not believed behind its back."""
    stream = running()
    other = Stream(*range(200, 290, 10))
    assert stream.take(310, other) == []
    assert stream.take(285, other) == [285]
    assert stream.refused == {"angle_off_time": 1}
    assert stream.look_again(Stream(*range(200, 320, 10))) == []


@pytest.mark.parametrize("behind", [150, 5000])
def test_a_sample_far_behind_is_refused_when_the_stream_goes_on_as_before(behind: float) -> None:
    stream = running()
    assert stream.take(90 - behind) == []
    assert stream.take(100) == [100]
    assert stream.refused == {"angle_off_time": 1}


def test_a_sample_that_is_a_little_late_is_refused_at_once() -> None:
    stream = running()
    assert stream.take(90) == stream.take(85) == stream.take(-10) == []
    assert stream.refused == {"angle_not_in_order": 3}


def test_a_pause_is_believed_at_once_where_the_other_stream_has_gone_on() -> None:
    other = Stream(*range(0, 600, 10))
    assert running().take(590, other) == [590]


def test_a_pause_of_both_is_believed_when_both_are_back() -> None:
    stream, other = running(), running()
    assert stream.take(590, other) == []
    assert other.take(595, stream) == []  # a driver may have got one stamp wrong for both
    assert stream.take(600, other) == [590, 600]
    assert other.look_again(stream) == [595]


@pytest.mark.parametrize("to", [-800, 700])
def test_a_jump_is_believed_after_four_steps_in_which_nothing_goes_on_as_before(to: float) -> None:
    stream = running()
    believed = [stream.take(to + step) for step in (0, 10, 20, 30, 40, 50)]
    assert believed == [[], [], [], [], [to, to + 10, to + 20, to + 30, to + 40], [to + 50]]
    assert stream.time.jumps == 1
    assert not stream.refused


@pytest.mark.parametrize("step", [10, 15, 20])
def test_three_stamps_far_from_another_are_no_stream_because_they_are_far(step: float) -> None:
    """As from a slower publisher: nothing was silent for so long."""
    stream = Stream(*range(100))
    assert [stream.take(5000 + number * step) for number in range(3)] == [[], [], []]
    assert stream.take(100) == [100]
    assert stream.refused == {"angle_off_time": 3}


def test_the_largest_gap_bounds_how_long_a_jump_is_not_believed() -> None:
    slow = Stream(*range(0, 10_000, 1000), max_gap=100)
    assert slow.take(-500) == []
    assert slow.take(-450) == []
    assert slow.take(-400) == [-500, -450, -400]


def test_one_wrong_stamp_of_both_is_not_believed() -> None:
    stream, other = running(), running()
    for one, another in ((stream, other), (other, stream)):
        assert one.take(-800, another) == []
    for one, another in ((stream, other), (other, stream)):
        assert one.take(100, another) == [100]
        assert one.refused == {"angle_off_time": 1}


def test_one_long_step_does_not_make_the_next_ones_long() -> None:
    stream = Stream(*TEN, 110, 120)
    assert stream.take(155) == []
    assert stream.take(130) == [130]


def test_the_slower_stream_does_not_say_how_far_the_faster_one_may_go() -> None:
    slow, fast = Stream(*range(0, 1000, 50)), Stream(*range(900, 960))
    assert fast.take(1040, slow) == []
    assert fast.take(960, slow) == [960]


def test_no_more_than_so_many_are_kept_aside() -> None:
    stream = Stream(*range(0, 10_000, 1000), max_gap=10_000)
    for number in range(250):
        stream.take(-9000 + number)
    assert len(stream.time.pending) <= 100


def test_a_jump_of_both_is_believed_as_soon_as_one_goes_on_there() -> None:
    stream, other = running(), running()
    assert stream.take(-800, other) == []
    assert other.take(-799, stream) == []
    assert stream.take(-790, other) == [-800, -790]
    assert other.look_again(stream, jumped=True) == [-799]


def test_a_stream_comes_back_to_the_other_one_s_time_although_wrong_samples_go_on() -> None:
    """Two publishers on a topic, and the wrong one was there first."""
    other, stream = Stream(*range(0, 200, 5)), Stream(*range(10_000, 10_200, 10))
    assert stream.take(191, other) == []
    assert stream.take(10_200, other) == [10_200]
    assert stream.take(201, other) == [191, 201]
    assert stream.take(10_210, other) == []
    assert stream.take(211, other) == [211]
    assert stream.refused == {"angle_off_time": 1}


def test_samples_kept_aside_that_are_passed_by_are_believed() -> None:
    """Three glitches have made a hole that looks like a pause."""
    stream = running()
    for glitch in (5000, 5010, 5020):
        assert stream.take(glitch) == []
    assert stream.take(125) == []
    assert stream.refused == {"angle_off_time": 3}
    other = Stream(*range(0, 130, 2))
    assert stream.take(135, other) == [125, 135]


def test_wrong_stamps_from_within_a_pause_do_not_undo_its_end() -> None:
    """The other stream has not come back yet, so all of these wait: three are a burst of wrong ones, four none."""
    stream = running()
    pause = [*range(190, 205, 5)]
    for stamp in pause:
        assert stream.take(stamp) == []
    assert stream.take(205) == []
    for wrong in (140, 145, 150):
        assert stream.take(wrong) == []
    assert stream.refused == {"angle_not_in_order": 3}
    assert [stream.take(stamp) for stamp in (215, 225)] == [[], []]
    assert stream.take(230) == [*pause, 205, 215, 225, 230]


def test_a_slower_rate_is_believed() -> None:
    stream = running()
    assert stream.take(1000) == []
    assert stream.take(2000) == [1000, 2000]
    assert stream.take(3000) == [3000]


def test_clear_forgets() -> None:
    stream = running()
    stream.take(500)
    stream.time.clear()
    assert stream.refused == {"angle_off_time": 1}
    assert stream.take(-9000) == []
    assert stream.take(-8990) == [-9000, -8990]


def test_going_on_is_as_after_the_samples_themselves() -> None:
    stream, copy = running(), Stream()
    copy.time.go_on(stream.time.last, stream.time.steps)
    state: Any = [(one.last, one.steps, one.far, one.pending) for one in (stream.time, copy.time)]
    assert state[0] == state[1]
    assert len(stream.time.steps) == STEPS
