"""Pairing by stamp: orders of arrival, rates, gaps, jumps."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.schema import Pairing
from knee_contact_ros.streams.pairing import AngleSample, LoadSample, PairedSample, Synchroniser

MS = 1_000_000


def angle(stamp: int, value: float | None = None) -> AngleSample:
    return AngleSample(stamp, float(stamp) if value is None else value, None)


def load(stamp: int) -> LoadSample:
    return LoadSample(stamp, float(stamp), 0.0, "tibia")


def feed(synchroniser: Synchroniser, samples: list[AngleSample | LoadSample]) -> list[PairedSample]:
    """Push samples in this order."""
    pairs = []
    for sample in samples:
        push = synchroniser.push_angle if isinstance(sample, AngleSample) else synchroniser.push_load
        pairs += push(sample)  # type: ignore[operator]
    return pairs


def test_equal_stamps_pair_exactly_whichever_comes_first() -> None:
    for samples in ([angle(5 * MS), load(5 * MS)], [load(5 * MS), angle(5 * MS)]):
        (pair,) = feed(Synchroniser(Pairing()), samples)
        assert (pair.angle, pair.status) == (5.0 * MS, Status.OK)


def test_a_load_between_two_angles_gets_the_value_between() -> None:
    synchroniser = Synchroniser(Pairing())
    assert feed(synchroniser, [angle(10 * MS, 1.0), load(12 * MS)]) == []
    assert synchroniser.waiting == 1
    (pair,) = feed(synchroniser, [angle(20 * MS, 2.0)])
    assert pair.angle == pytest.approx(1.2, abs=1e-15)


def test_heights_are_interpolated_as_the_angles_are() -> None:
    synchroniser = Synchroniser(Pairing())
    low, high = (angle(stamp, 1.0)._replace(height=height) for stamp, height in ((10 * MS, 0.03), (20 * MS, 0.04)))
    (between,) = feed(synchroniser, [low, load(13 * MS), high])
    assert between.height == pytest.approx(0.033, abs=1e-17)
    (without,) = feed(Synchroniser(Pairing()), [angle(10 * MS), load(10 * MS)])
    assert without.height is None


@given(st.integers(0, 10**9))
def test_the_order_of_arrival_does_not_matter(seed: int) -> None:
    angles = [angle(i * 10 * MS) for i in range(8)]
    loads = [load(i * MS) for i in range(70)]
    expected = feed(Synchroniser(Pairing()), [*angles, *loads])
    mixed: list[AngleSample | LoadSample] = []
    rng = random.Random(seed)
    a, b = list(angles), list(loads)
    while a or b:
        mixed.append((a if a and (not b or rng.random() < 0.2) else b).pop(0))
    pairs = feed(Synchroniser(Pairing()), mixed)
    assert [(p.load.stamp, p.angle, p.status) for p in pairs] == [(p.load.stamp, p.angle, p.status) for p in expected]
    assert len(pairs) == 70
    assert [a for p in pairs for a in p.angles] == angles[: len([a for p in pairs for a in p.angles])]


@given(st.lists(st.integers(0, 50), min_size=2, max_size=30), st.lists(st.integers(0, 50), min_size=1, max_size=30))
def test_every_load_is_answered_or_counted(angle_steps: list[int], load_steps: list[int]) -> None:
    synchroniser = Synchroniser(Pairing())
    samples: list[AngleSample | LoadSample] = []
    stamp = 0
    for step in angle_steps:
        stamp += step * MS
        samples.append(angle(stamp))
    stamp = 0
    for step in load_steps:
        stamp += step * MS
        samples.append(load(stamp))
    random.Random(1).shuffle(samples)
    pairs = feed(synchroniser, samples) + synchroniser.finish()
    assert len(pairs) + synchroniser.refused.total() >= len(load_steps)
    resets = [i for i, pair in enumerate(pairs) if pair.status & Status.TIME_RESET]
    for i, (before, after) in enumerate(pairwise(pairs), start=1):
        assert after.load.stamp > before.load.stamp or i in resets


def test_a_load_before_every_angle_is_refused_and_said() -> None:
    synchroniser = Synchroniser(Pairing())
    (pair,) = feed(synchroniser, [load(1 * MS), load(5 * MS), angle(5 * MS)])
    assert pair.load.stamp == 5 * MS
    assert pair.status == Status.INPUT_REJECTED
    assert synchroniser.refused == {"no_angle_before": 1}


def test_what_waits_too_long_is_answered_with_the_last_angle() -> None:
    synchroniser = Synchroniser(Pairing())
    assert feed(synchroniser, [angle(5 * MS, 0.3), load(6 * MS), load(7 * MS)]) == []
    held = synchroniser.give_up()
    assert [(pair.angle, pair.status) for pair in held] == [(0.3, Status.INPUT_HELD)] * 2


def test_gaps_are_flagged() -> None:
    synchroniser = Synchroniser(Pairing(max_gap=0.1))
    pairs = feed(synchroniser, [angle(0), load(0), angle(50 * MS), load(50 * MS), load(200 * MS), angle(300 * MS)])
    pairs += synchroniser.finish()
    held = Status.INPUT_HELD | Status.STALE_INPUT  # nothing has come that tells whether the last angle is right
    assert [pair.status for pair in pairs] == [Status.OK, Status.OK, held]


def test_what_waits_at_the_end_is_not_answered_with_an_angle_that_may_be_wrong() -> None:
    synchroniser = Synchroniser(Pairing())
    pairs = feed(synchroniser, [sample for at in range(0, 100, 10) for sample in (angle(at * MS, 0.3), load(at * MS))])
    pairs += feed(synchroniser, [load(95 * MS), angle(150 * MS, 1.0)])
    pairs += synchroniser.finish()
    assert [(pair.angle, pair.status) for pair in pairs[9:]] == [(0.3, Status.OK), (0.3, Status.INPUT_HELD)]


def test_a_second_publisher_from_the_first_sample_on_is_refused() -> None:
    """Jumps to the other one and back are no steps of a stream."""
    synchroniser = Synchroniser(Pairing())
    pairs = []
    for at in range(20_000, 25_000, 5):
        pairs += feed(synchroniser, [load(at * MS), load((at + 5000) * MS), angle(at * MS)])
    assert synchroniser.load_time.jumps <= 2
    assert synchroniser.refused["load_off_time"] > 990
    assert sum(bool(pair.status & Status.TIME_RESET) for pair in pairs) <= 2


def test_doubled_and_late_samples_are_refused() -> None:
    synchroniser = Synchroniser(Pairing())
    pairs = feed(
        synchroniser, [angle(0), load(0), load(0), angle(0), angle(10 * MS), angle(5 * MS), load(10 * MS), load(8 * MS)]
    )
    assert [pair.load.stamp for pair in pairs] == [0, 10 * MS]
    assert synchroniser.refused == {"load_not_in_order": 2, "angle_not_in_order": 2}
    assert pairs[1].status == Status.INPUT_REJECTED


@pytest.mark.parametrize("angle_first", [True, False])
def test_a_looped_stream_starts_anew(angle_first: bool) -> None:
    first = [angle(1990 * MS), load(1990 * MS), angle(2000 * MS), load(2000 * MS)]
    again = [angle(0, 7.0), load(0)] if angle_first else [load(0), angle(0, 7.0)]
    synchroniser = Synchroniser(Pairing())
    assert len(feed(synchroniser, first)) == 2
    assert feed(synchroniser, again) == []  # a driver may have got one stamp wrong for both
    pair, following = feed(synchroniser, [angle(10 * MS, 8.0), load(10 * MS)])
    assert pair.status == Status.TIME_RESET
    assert (pair.angle, following.angle) == (7.0, 8.0)


def test_loads_that_jump_back_alone_are_answered_with_the_newest_angle_and_flagged() -> None:
    synchroniser = Synchroniser(Pairing())
    pairs = feed(synchroniser, [angle(1990 * MS), load(1990 * MS), angle(2000 * MS), load(2000 * MS)])
    assert feed(synchroniser, [load(500 * MS)]) == []  # is it late, or has its clock been set back?
    alone = feed(synchroniser, [angle(2010 * MS, 7.0), *(load(stamp * MS) for stamp in (501, 520, 600, 601))])
    assert [pair.load.stamp // MS for pair in alone] == [500, 501, 520, 600, 601]
    assert {pair.angle for pair in alone} == {7.0}
    assert alone[0].status == Status.TIME_RESET | Status.INPUT_HELD | Status.STALE_INPUT
    assert {pair.status for pair in alone[1:]} == {Status.INPUT_HELD | Status.STALE_INPUT}
    assert not synchroniser.refused
    assert [a.stamp // MS for pair in pairs + alone for a in pair.angles] == [1990, 2000, 2010]  # all are recorded


def test_angles_follow_loads_that_have_jumped_back() -> None:
    synchroniser = Synchroniser(Pairing())
    feed(synchroniser, [angle(1990 * MS), load(1990 * MS), angle(2000 * MS), load(2000 * MS)])
    feed(synchroniser, [load(500 * MS), load(600 * MS), load(610 * MS)])
    (pair,) = feed(synchroniser, [angle(620 * MS, 6.0), angle(630 * MS, 7.0), load(630 * MS)])
    assert (pair.angle, pair.status) == (7.0, Status.OK)


def test_nothing_grows_while_the_other_stream_is_silent() -> None:
    """What waits for a force that does not come is given up, oldest first, and counted; so it is with an angle."""
    synchroniser = Synchroniser(Pairing(queue=100))
    feed(synchroniser, [angle(i * MS) for i in range(1000)])
    assert synchroniser.unrecorded == 900
    assert synchroniser.fill == 1.0
    (pair,) = feed(synchroniser, [load(999 * MS)])
    assert [a.stamp // MS for a in pair.angles] == list(range(900, 1000))
    held = feed(synchroniser, [load(i * MS) for i in range(1000, 1300)])
    assert [pair.load.stamp // MS for pair in held] == list(range(1000, 1200))
    assert {pair.angle for pair in held} == {999.0 * MS}
    assert synchroniser.waiting == 100


def test_after_forget_nothing_of_before_is_known() -> None:
    synchroniser = Synchroniser(Pairing())
    feed(synchroniser, [angle(9000 * MS), load(9000 * MS), angle(9010 * MS), load(9005 * MS)])
    synchroniser.forget()
    assert [a.stamp // MS for a in synchroniser.rest()] == [9010]  # is still to be recorded
    pairs = feed(synchroniser, [angle(0), load(0), angle(10 * MS), load(10 * MS)])
    assert [(pair.load.stamp // MS, pair.angle, pair.status) for pair in pairs] == [(0, 0, 0), (10, 10 * MS, 0)]


def test_loads_still_on_their_way_when_the_angles_jump_are_held() -> None:
    synchroniser = Synchroniser(Pairing())
    pairs = feed(
        synchroniser, [angle(1990 * MS), angle(2000 * MS, 3.0), angle(0), load(2005 * MS), load(0), angle(10 * MS)]
    )
    assert [(pair.load.stamp, pair.angle) for pair in pairs] == [(2005 * MS, 3.0), (0, 0.0)]
    assert [pair.status for pair in pairs] == [Status.INPUT_HELD, Status.TIME_RESET]


def test_an_angle_of_before_a_jump_is_recorded_with_the_next_pair() -> None:
    synchroniser = Synchroniser(Pairing())
    feed(synchroniser, [angle(1990 * MS), load(1990 * MS), angle(2000 * MS)])
    assert synchroniser.steady()
    pairs = feed(synchroniser, [angle(0), load(0), angle(10 * MS), load(10 * MS), angle(20 * MS)])
    assert [[a.stamp // MS for a in pair.angles] for pair in pairs] == [[2000, 0], [10]]


@pytest.mark.parametrize("ahead", [3_600_000, 500])
def test_an_angle_ahead_from_the_start_is_held_and_flagged(ahead: int) -> None:
    """One clock is wrong: the answer goes with the newest angle, as if it had been set so later."""
    synchroniser = Synchroniser(Pairing())
    pairs = []
    for i in range(0, 200, 5):
        pairs += feed(synchroniser, [angle((i + ahead) * MS), load(i * MS)])
    assert len(pairs) >= 38
    assert {pair.status for pair in pairs[2:]} == {Status.INPUT_HELD | Status.STALE_INPUT}
    assert pairs[-1].angle == (195 + ahead) * MS


def test_what_was_kept_aside_is_answered_in_time_if_nothing_more_comes() -> None:
    synchroniser = Synchroniser(Pairing())
    feed(synchroniser, [angle(0), load(0), angle(10 * MS), load(10 * MS)])
    assert feed(synchroniser, [load(5000 * MS)._replace(arrived=3.0), angle(5000 * MS, 0.7)]) == []
    assert synchroniser.give_up(2.9) == []
    (pair,) = synchroniser.give_up(3.0)
    assert (pair.load.stamp, pair.angle, pair.status) == (5000 * MS, 0.7, Status.STALE_INPUT)


def test_a_reset_loses_no_force_between_two_angles() -> None:
    synchroniser = Synchroniser(Pairing())
    feed(synchroniser, [angle(0, 0.0), load(0), angle(10 * MS, 1.0), load(9 * MS)])
    synchroniser.finish()
    synchroniser.forget()
    pairs = feed(synchroniser, [load(12 * MS), load(13 * MS), angle(20 * MS, 2.0), angle(30 * MS, 3.0), load(14 * MS)])
    assert [(pair.load.stamp // MS, pair.angle) for pair in pairs] == [(12, 1.2), (13, 1.3), (14, 1.4)]
    assert not synchroniser.refused
