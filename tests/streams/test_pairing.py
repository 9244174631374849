"""Pairing by stamp: which samples of a stream are accepted, and what becomes of them; rates, gaps, jumps, orders."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.sections import PairingSection
from knee_contact_ros.streams.clock_sets import FIRST_JUDGED
from knee_contact_ros.streams.pairing import PairedSample, Synchroniser
from knee_contact_ros.streams.timeline import AngleSample, LoadSample, Refusals, Timeline

MS = 1_000_000
HELD, STALE, RESET, REJECTED = (
    Status.INPUT_HELD,
    Status.STALE_INPUT,
    Status.TIME_RESET,
    Status.INPUT_REJECTED,
)


class Stream:
    """A timeline with what it refuses; stamps in ms."""

    def __init__(self, stamps=(), max_gap=100):
        self.refused = Refusals()
        self.time: Timeline[LoadSample] = Timeline(round(max_gap * MS), 100, self.refused, "angle")
        for stamp in stamps:
            self.take(stamp)

    def take(self, stamp, other=None):
        """What is believed with this stamp."""
        believed = self.time.push_sample(load(stamp), (other or SILENT).time)
        return [sample.stamp / MS for sample in believed]

    def recheck(self, other, jumped=False):
        return [sample.stamp / MS for sample in self.time.recheck_held_back(other.time, jumped)]


SILENT = Stream()
"""Another stream of which nothing is known"""
TEN, SLOW = range(0, 100, 10), range(0, 10_000, 1000)
BEHIND, ALONE, LATE = {"angle_off_time": 1}, {"angle_off_time": 3}, {"angle_not_in_order": 3}
BELIEVED: list[tuple[str, Sequence[int], Sequence[int], list[Any], dict[str, int]]] = [
    ("two samples make a stream", (), (), [5, [9, 5, 9], [13, 13]], {}),
    ("one does where the other stream is", (), (0, 1, 2), [[3, 3]], {}),
    ("and none elsewhere", (), (0, 1, 2), [40], {}),
    ("one far ahead, and it goes on as before", TEN, (), [300, [100, 100], [110, 110]], BEHIND),
    ("three ahead, and the next are far too", TEN, (), [170, 180, 190, 130, 140], ALONE),
    ("far behind", TEN, (), [-60, [100, 100]], BEHIND),
    ("very far behind", TEN, (), [-4910, [100, 100]], BEHIND),
    *(
        (
            f"{len(wrong)} very far behind, then some are lost",
            TEN,
            (),
            [*wrong, 130, 140, 150, 160, [170, 130, 140, 150, 160, 170]],
            {"angle_off_time": len(wrong)},
        )
        for wrong in ([-9900], [-9900, -9890])
    ),
    ("a little late", TEN, (), [90, 85, -10], LATE),
    ("a pause, the other one has gone on", TEN, range(0, 600, 10), [[590, 590]], {}),
    *(
        (
            f"a jump to {to}: after four steps",
            TEN,
            (),
            [
                to,
                to + 10,
                to + 20,
                to + 30,
                [to + 40, *range(to, to + 50, 10)],
                [to + 50, to + 50],
            ],
            {},
        )
        for to in (-800, 700)
    ),
    *(
        (
            f"three of a slower publisher, {step} ms",
            range(100),
            (),
            [5000, 5000 + step, 5000 + 2 * step, [100, 100]],
            ALONE,
        )
        for step in (10, 15, 20)
    ),
    ("the largest gap bounds the wait", SLOW, (), [-500, -450, [-400, -500, -450, -400]], {}),
    ("one long step makes no others long", [*TEN, 110, 120], (), [155, [130, 130]], BEHIND),
    (
        "a slower stream does not say how far",
        range(900, 960),
        range(0, 1000, 50),
        [1040, [960, 960]],
        BEHIND,
    ),
    ("a slower rate", TEN, (), [1000, [2000, 1000, 2000], [3000, 3000]], {}),
    ("out of order, both reached", TEN, range(200, 290, 10), [310, [285, 285]], BEHIND),
    (
        "back to the other one's time from a wrong publisher",
        range(10_000, 10_200, 10),
        range(0, 200, 5),
        [191, [10_200, 10_200], [201, 191, 201], 10_210, [211, 211]],
        BEHIND,
    ),
    ("a hole of glitches looks like a pause", TEN, (), [5000, 5010, 5020, 125], ALONE),
    (
        "wrong ones within a pause do not undo its end",
        TEN,
        (),
        [190, 195, 200, 205, 140, 145, 150, 215, 225, [230, 190, 195, 200, 205, 215, 225, 230]],
        LATE,
    ),
]
"""Name, stamps before, stamps of the other stream; then each stamp with those that are believed; what is refused"""


@pytest.mark.parametrize(
    ("before", "others", "script", "refused"),
    [case[1:] for case in BELIEVED],
    ids=[case[0] for case in BELIEVED],
)
def test_accepted_samples(before, others, script, refused):
    stream, other = Stream(before), Stream(others)
    for step in script:
        stamp, *believed = step if isinstance(step, list) else [step]
        assert stream.take(stamp, other) == believed
    assert stream.refused == refused


def test_a_jump_of_both_streams_is_accepted_and_one_wrong_stamp_is_not():
    stream, other = Stream(TEN), Stream(TEN)
    assert (
        stream.take(590, other) == other.take(595, stream) == []
    )  # a driver may have got one stamp wrong for both
    assert stream.take(600, other) == [590, 600]
    assert other.recheck(stream) == [595]
    stream, other = Stream(TEN), Stream(TEN)
    assert stream.take(-800, other) == other.take(-799, stream) == []
    assert stream.take(-790, other) == [-800, -790]
    assert other.recheck(stream, jumped=True) == [-799]
    stream, other = Stream(TEN), Stream(TEN)
    assert stream.take(-800, other) == other.take(-800, stream) == []
    for one, another in ((stream, other), (other, stream)):
        assert one.take(100, another) == [100]
        assert one.refused == BEHIND


def angle(stamp, value=None):
    return AngleSample(round(stamp * MS), stamp if value is None else value)


def load(stamp):
    return LoadSample(round(stamp * MS), stamp, 0.0, "tibia")


def sample_of(word):
    """`a10=7` is an angle of 7 at 10 ms, `a10` one of 10, `l10` a load."""
    stamp, _, value = word[1:].partition("=")
    return angle(float(stamp), float(value or stamp)) if word[0] == "a" else load(float(stamp))


def feed(synchroniser, samples):
    """Push samples in this order, which may be given as words; `.` is the end of the streams."""
    pairs = []
    for one in samples.split() if isinstance(samples, str) else samples:
        sample = sample_of(one) if isinstance(one, str) and one != "." else one
        if isinstance(sample, str):
            pairs += synchroniser.finish_streams()
        elif isinstance(sample, AngleSample):
            pairs += synchroniser.push_angle(sample)
        else:
            pairs += synchroniser.push_load(sample)
    return pairs


FLAGS = {HELD: "H", STALE: "S", RESET: "R", REJECTED: "J"}


def told(pairs):
    """Stamp of the load [ms], angle unless it is equal, and flags of each pair."""
    words = []
    for pair in pairs:
        stamp, flags = (
            pair.load.stamp / MS,
            "".join(letter for bit, letter in FLAGS.items() if pair.status & bit),
        )
        words.append(f"{stamp:g}" + (f"={pair.angle:.9g}" if pair.angle != stamp else "") + flags)
    return " ".join(words)


BEFORE = "a1990 l1990 a2000 l2000 "
PAIRS = {
    "equal stamps": ("a5 l5", "5", {}),
    "the load first": ("l5 a5", "5", {}),
    "between two angles": ("a10=1 l12 a20=2", "12=1.2", {}),
    "before every angle": ("l1 l5 a5", "5J", {"no_angle_before": 1}),
    "at the end": ("a5 l6 l7 .", "6=5H 7=5H", {}),
    "the largest gap": ("a0 l0 l50 a100 l100 l200 .", "0 50 100 200=100H", {}),
    "a gap at the end": ("a0 l0 a50 l50 l200 a300 .", "0 50 200=50HS", {}),
    "doubled and late": (
        "a0 l0 l0 a0 a10 a5 l10 l8",
        "0 10J",
        {"load_not_in_order": 2, "angle_not_in_order": 2},
    ),
    "a loop, angle first": (BEFORE + "a0=7 l0 a10=8 l10", "1990 2000 0=7R 10=8", {}),
    "a loop, load first": (BEFORE + "l0 a0=7 a10=8 l10", "1990 2000 0=7R 10=8", {}),
    "loads jump back alone": (
        BEFORE + "l500 a2010=7 l501 l600",
        "1990 2000 500=7HSR 501=7HS 600=7HS",
        {},
    ),
    "angles jump first": ("a1990 a2000=3 a0 l2005 l0 a10", "2005=3H 0R", {}),
    "and follow": (
        BEFORE + "l500 l600 l610 a620 a630=7 l630",
        "1990 2000 500=2000HSR 600=2000HS 610=2000HS 630=7",
        {},
    ),
}
"""Samples; pairs and refusals that come of them"""


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_of_samples(name):
    samples, pairs, refused = PAIRS[name]
    synchroniser = Synchroniser(PairingSection(max_gap=0.1))
    assert told(feed(synchroniser, samples)) == pairs
    assert synchroniser.refused == refused


def test_heights_and_leg_states_are_interpolated():
    ends = [
        angle(at, 1.0)._replace(height=h, others=others)
        for at, h, *others in ((10, 0.03, 1, 5), (20, 0.04, 2, -5))
    ]
    (between,) = feed(Synchroniser(PairingSection()), [ends[0], load(13), ends[1]])
    assert between.height == pytest.approx(0.033, abs=1e-17)
    assert between.others == pytest.approx((1.3, 2.0), abs=1e-15)


@given(st.integers(0, 10**9))
def test_the_order_of_arrival_does_not_matter(seed):
    angles, loads = [angle(i * 10) for i in range(8)], [load(i) for i in range(70)]
    expected = feed(Synchroniser(PairingSection()), [*angles, *loads])
    mixed, a, b, rng = (
        list[AngleSample | LoadSample](),
        list(angles),
        list(loads),
        random.Random(seed),
    )
    while a or b:
        mixed.append((a if a and (not b or rng.random() < 0.2) else b).pop(0))
    pairs = feed(Synchroniser(PairingSection()), mixed)
    assert told(pairs) == told(expected)
    assert len(pairs) == 70
    recorded = [a for pair in pairs for a in pair.angles]
    assert recorded == angles[: len(recorded)]


def test_a_waiting_force_expires_by_the_callers_clock():
    synchroniser = Synchroniser(PairingSection())
    assert (
        told([*feed(synchroniser, "a5=0.3 l6 l7"), *synchroniser.flush_expired()])
        == "6=0.3H 7=0.3H"
    )
    synchroniser = Synchroniser(PairingSection())
    feed(synchroniser, "a0 l0 a10 l10")
    assert feed(synchroniser, [load(5000)._replace(arrived=3.0), angle(5000, 0.7)]) == []
    assert list(synchroniser.flush_expired(2.9)) == []
    assert told(synchroniser.flush_expired(3.0)) == "5000=0.7S"
    regular = " ".join(f"a{at}=0.3 l{at}" for at in range(0, 100, 10))
    pairs = feed(Synchroniser(PairingSection()), f"{regular} l95 a150=1 .")
    assert told(pairs[9:]) == "90=0.3 95=0.3H"


def test_nothing_grows_while_the_other_stream_is_silent():
    """What waits for a force that does not come is given up, oldest first, and counted; so it is with an angle."""
    synchroniser = Synchroniser(PairingSection(queue=100))
    feed(synchroniser, [angle(i) for i in range(1000)])
    assert (synchroniser.unrecorded_angles, synchroniser.fill) == (900, 1.0)
    (pair,) = feed(synchroniser, [load(999)])
    assert [a.stamp // MS for a in pair.angles] == list(range(900, 1000))
    held = feed(synchroniser, [load(i) for i in range(1000, 1300)])
    assert [pair.load.stamp // MS for pair in held] == list(range(1000, 1200))
    assert {pair.angle for pair in held} == {999.0}
    assert len(synchroniser.waiting_loads) == 100


def test_clearing_drops_old_samples_and_loses_no_force():
    synchroniser = Synchroniser(PairingSection())
    feed(synchroniser, "a9000 l9000 a9010 l9005")
    synchroniser.clear_streams()
    assert [a.stamp // MS for a in synchroniser.all_unpaired] == [9010]  # is still to be recorded
    assert told(feed(synchroniser, "a0 l0 a10 l10")) == "0R 10"  # behind the last pair
    synchroniser = Synchroniser(PairingSection())
    feed(synchroniser, "a0=0 l0 a10=1 l9 .")
    synchroniser.clear_streams()
    pairs = feed(synchroniser, "l12 l13 a20=2 a30=3 l14")
    assert told(pairs) == "12=1.2 13=1.3 14=1.4"
    assert not synchroniser.refused


@pytest.mark.parametrize("ahead", [3_600_000, 500])
def test_an_angle_ahead_from_the_start_is_held_and_flagged(ahead):
    """One clock is wrong: the answer goes with the newest angle, as if it had been set so later."""
    pairs = feed(
        Synchroniser(PairingSection()),
        [s for i in range(0, 200, 5) for s in (angle(i + ahead), load(i))],
    )
    assert len(pairs) >= 38
    assert {pair.status for pair in pairs[2:]} == {HELD | STALE}


@pytest.mark.parametrize("apart", [-500, -200, 200, 500])
def test_a_constant_offset_of_clocks_is_flagged(apart):
    """Stamps of the angles lie apart by more than `pairing.max_gap` from the third second on, except one of them.

    Later they fit again.
    """
    synchroniser, stale = Synchroniser(PairingSection(wait=2.0)), []
    for time in range(0, 8000, 10):
        off = apart if 2000 <= time < 6000 and time != 4000 else 0
        pairs = [*synchroniser.push_angle(angle(time + off)), *synchroniser.push_load(load(time))]
        stale += [(time, pair.status & STALE) for pair in pairs]
    assert not any(flag for time, flag in stale if time < 2000 or time > 7000)
    assert all(flag for time, flag in stale if 2100 <= time < 6000 and not 4000 <= time < 4100)


def test_bursts_are_no_clock_offset():
    synchroniser, bursts = (
        Synchroniser(PairingSection(wait=2.0)),
        [range(begin, begin + 300, 10) for begin in range(0, 6000, 300)],
    )
    pairs = feed(
        synchroniser, [kind(time) for burst in bursts for kind in (angle, load) for time in burst]
    )
    assert [pair.status for pair in pairs] == [0] * 600


@pytest.mark.parametrize("ahead", [-500, -150, -120, 120, 150, 500])
@pytest.mark.parametrize("step", [2, 5, 10])
def test_clocks_that_are_apart_from_the_beginning_are_flagged_from_the_first_answer_on(
    ahead, step
):
    pairs = list[PairedSample]()
    synchroniser = Synchroniser(PairingSection(max_gap=0.1))
    for time in range(1000, 4000, step):
        pairs += synchroniser.push_angle(angle(time + ahead))
        pairs += synchroniser.push_load(load(time))
    assert pairs
    assert all(pair.status & STALE for pair in pairs)


def test_a_clock_that_was_wrong_and_is_set_right_is_no_fault():
    """Its stamps lay apart by less than `max_gap`, so the answers before it are not flagged either."""
    paired = Synchroniser(PairingSection(max_gap=0.1))
    for time in range(1000, 4000, 5):
        list(paired.push_angle(angle(time)))
        list(paired.push_load(load(time - 95 if time < 2200 else time)))
    assert not paired.lasting
    assert not paired.clock_sets.apart


BURST = 250
"""Time [ms] between two bursts"""


@pytest.mark.parametrize("apart", [-300, -200, 200, 300])
@pytest.mark.parametrize("both", [False, True])
def test_bursts_do_not_hide_a_clock_that_is_set(apart, both):
    """The stamps of both meet in a part of each burst, so they do not differ for a second."""
    synchroniser, flags = Synchroniser(PairingSection(wait=2.0)), []
    for begin in range(0, 15000, BURST):
        for one, push in ((angle, synchroniser.push_angle), (load, synchroniser.push_load)):
            for time in range(begin, begin + BURST, 10):
                off = apart if time >= 6000 and (both or one is load) else 0
                pairs = list(push(one(time + off)))
                flags += [(time, pair.status & STALE) for pair in pairs]
    assert not any(flag for time, flag in flags if time < 6000)
    assert all(bool(flag) != both for time, flag in flags if time > 8500)
    assert bool(synchroniser.clock_sets.apart) != both


def test_a_constant_latency_is_reported():
    synchroniser = Synchroniser(PairingSection(angle_delay=0.02))
    for time in range(0, 1000, 10):
        synchroniser.push_load(load(time))
        synchroniser.push_angle(angle(time + 10)._replace(delay=round(20 * MS)))
    assert set(list(synchroniser.clock_sets.leads)[2:]) == {-20 * MS}


SENT = 4.0
"""Duration [s] of the runs below"""


def sent(rate, back, of, disorder=list):
    """Pairs of two streams [Hz]; a clock is set back by a time [s] in the middle, and the angle is the true time."""
    paired, pairs = Synchroniser(PairingSection(max_gap=0.1)), list[PairedSample]()
    for number in disorder(list(range(int(SENT * rate)))):
        time = 10.0 + number / rate
        shifts = {one: back if one in of and time > 12.0 else 0.0 for one in ("angle", "load")}
        stamps = {one: round(1e9 * (time - shift)) for one, shift in shifts.items()}
        pairs += paired.push_angle(AngleSample(stamps["angle"], time))
        pairs += paired.push_load(LoadSample(stamps["load"], 1.0, 0.0, ""))
    return paired, [*pairs, *paired.finish_streams()]


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("seed", range(30))
def test_a_clock_that_is_set_a_little_for_good_is_told_and_flagged(seed, ahead):
    """By less than `max_gap`: the stream goes on after what looks like late samples, or a pause."""
    draw = random.Random(seed)
    rate = draw.choice((100, 200, 500))
    back = draw.uniform(4.0 / rate, 0.095) * (-1.0 if ahead else 1.0)
    of = draw.choice(("angle", "load"))
    paired, pairs = sent(rate, back, of)
    told = 1e-9 * paired.clock_sets.apart
    assert told == pytest.approx(back if of == "angle" else -back, abs=2.0 / rate)
    bits = Status.STALE_INPUT | Status.INPUT_HELD
    flagged = [bool(pair.status & bits) for pair in pairs]
    if of == "angle":  # the other's stamps are the true times
        wrong = [abs(pair.angle - 1e-9 * pair.load.stamp) > 2.5 / rate for pair in pairs]
        assert any(wrong)
        unseen = sum(w and not f for w, f in zip(wrong, flagged, strict=True))
        assert unseen <= (FIRST_JUDGED if ahead else 0)
    assert flagged[-1]
    assert (
        paired.angle_time.holes.missing + paired.load_time.holes.missing == 0
    )  # the step ahead is no hole
    paired.clear_streams()
    assert not paired.clock_sets.apart
    assert not paired.lasting


def test_a_clock_that_is_set_right_again_is_no_fault_any_more():
    paired = Synchroniser(PairingSection(max_gap=0.1))
    lasting = list[int]()
    for time in range(0, 8000, 5):
        list(paired.push_angle(angle(time + (40 if 2000 <= time < 4000 else 0))))
        list(paired.push_load(load(time)))
        lasting.append(paired.lasting)
    assert not any(lasting[:400])
    assert all(lasting[440:800])
    assert not any(lasting[840:])


@pytest.mark.parametrize("seed", range(30))
def test_both_clocks_set_late_packets_and_lost_ones_are_no_such_clock(seed):
    draw = random.Random(seed)

    def disorder(numbers):
        for _ in range(10):
            at, size = draw.randrange(len(numbers) - 20), draw.randint(1, 6)
            moved = numbers[at : at + size]
            del numbers[at : at + size]
            later = at + draw.randint(1, 8)
            numbers[later:later] = moved
            if seed % 2:
                del numbers[at : at + draw.randint(0, 12)]
        return numbers

    assert not sent(200, draw.uniform(-0.09, 0.09), "angle load")[0].lasting
    assert not sent(200, 0.0, "", disorder)[0].clock_sets.apart


@pytest.mark.parametrize("seed", range(10))
def test_samples_that_are_missing_are_counted_and_uneven_steps_are_not(seed):
    """What a full queue has dropped shows in the stamps only; a pause beyond `max_gap` is flagged."""
    draw, paired = random.Random(seed), Synchroniser(PairingSection(max_gap=0.1))
    lost = {number for number in draw.sample(range(100, 2000), 40) if number % 3}
    for number in range(2000):
        stamp = round(5e6 * number + draw.uniform(-5e5, 5e5))
        list(paired.push_angle(AngleSample(stamp, 0.1)))
        if number not in lost:
            list(paired.push_load(LoadSample(stamp, 1.0, 0.0, "")))
    assert paired.load_time.holes.missing == pytest.approx(len(lost), abs=3)
    assert paired.load_time.holes.skipped == 0
    assert paired.angle_time.holes.missing == 0


def missing(stamps):
    """Number of samples that are missing by stamps in milliseconds, in holes and in pauses."""
    time = Synchroniser(PairingSection(max_gap=0.1)).load_time
    for stamp in stamps:
        time.push_sample(LoadSample(round(stamp * MS), 1.0, 0.0, ""), time)
    return time.holes.missing + time.holes.skipped


@pytest.mark.parametrize("jitter", [0.0, 0.05])
@pytest.mark.parametrize("seed", range(5))
def test_all_of_many_losses_are_counted(seed, jitter):
    """At 4 kHz on a busy machine holes of 1 to 20 samples came in clusters, with a few samples between them."""
    draw, number, sent = random.Random(seed), 0, list[int]()
    is_busy = False
    for turn in range(6000):
        sent.append(number)
        is_busy ^= draw.random() < (0.05 if is_busy else 0.01)
        is_hole = 60 < turn < 5900 and is_busy and draw.random() < 0.3
        number += 1 + (min(int(1.0 + draw.expovariate(0.3)), 18) if is_hole else 0)
    counted = missing([5.0 * (one + draw.uniform(-jitter, jitter)) for one in sent])
    assert counted == pytest.approx(number - len(sent), rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_uneven_steps_are_no_losses(seed):
    """Steps that scatter, at random, by a rate that changes, in bursts, or on the grid of a radio."""
    draw = random.Random(seed)
    numbers = range(4000)
    scattered = [5.0 * (number + draw.uniform(-0.2, 0.2)) for number in numbers]
    alone = itertools.accumulate(draw.expovariate(0.2) for _ in numbers)
    waves = itertools.accumulate(5.0 + 3.0 * math.sin(number / 300.0) for number in numbers)
    halves = itertools.accumulate(5.0 * (1 + number // 700 % 2) for number in numbers)
    bursts = [25.0 * (number // 5) + number % 5 for number in numbers]
    grid = [7.5 * math.ceil(number / 1.5) for number in range(0, 8000, 2)]
    thirds = itertools.accumulate(5.0 * (1 + (number % 3 == 0)) for number in numbers)
    for stamps in (scattered, waves, halves, grid, thirds):
        assert missing(stamps) == 0
    assert missing(alone) <= 4
    assert missing(bursts) <= 40  # at their beginning


def test_a_repeated_stamp_after_a_wrong_one_is_late_and_no_jump():
    """It was taken for the next one of a stream that had jumped, although that was seconds behind."""
    synchroniser, pairs = Synchroniser(PairingSection()), list[PairedSample]()
    for number in range(100):
        stamp = {50: -10_000, 51: 245}.get(number, 5 * number)
        pairs += synchroniser.push_angle(angle(stamp))
        if number > 5:
            pairs += synchroniser.push_load(load(5 * (number - 6)))
    assert [pair.status & ~REJECTED for pair in pairs] == [0] * 94
    assert synchroniser.angle_time.jumps == 0


def test_what_is_lost_in_large_holes_is_counted_beside_the_jump():
    paired = Synchroniser(PairingSection(max_gap=0.1))
    for number in [*range(100), *range(160, 260), *range(460, 560)]:
        list(paired.push_angle(AngleSample(number * 5 * MS, 0.1)))
        list(paired.push_load(LoadSample(number * 5 * MS, 1.0, 0.0, "")))
    assert (paired.angle_time.holes.skipped, paired.load_time.holes.skipped) == (
        60 + 200,
        60 + 200,
    )
    assert paired.angle_time.holes.missing == paired.load_time.holes.missing == 0


@pytest.mark.parametrize("seed", range(3))
def test_samples_that_were_refused_as_late_are_not_missing(seed):
    """Those that a network delivers in another order, and those of a clock that stood still."""
    draw, stamps = random.Random(seed), [5.0 * number for number in range(4000)]
    for at in range(100, 3900, 50):
        if draw.random() < 0.5:
            stamps[at] = stamps[at - 1]
        else:
            stamps[at], stamps[at + 1] = stamps[at + 1], stamps[at]
    assert missing(stamps) == 0


@pytest.mark.parametrize(("least", "most", "late"), [(0.1, 3.0, 20.0), (3.5, 5.0, 7.5)])
@pytest.mark.parametrize("seed", range(3))
def test_a_publisher_that_is_late_by_a_few_steps_has_lost_nothing(seed, least, most, late):
    """It makes up for a delay by steps of any length."""
    draw, now, stamps = random.Random(seed), 0.0, list[float]()
    for number in range(8000):
        now = max(5.0 * number, now + draw.uniform(least, most))
        now += draw.uniform(0.0, late) if draw.random() < 0.004 else 0.0
        stamps.append(now)
    assert missing(stamps) <= 1


@pytest.mark.parametrize("rate", [200, 1000])
def test_a_publisher_that_makes_up_for_a_delay_has_lost_nothing(rate):
    """Its stamps are those of a busy computer: late by up to 90 ms, and then in a burst until it has caught up."""
    draw, paired, now = random.Random(rate), Synchroniser(PairingSection(max_gap=0.1)), 0.0
    for number in range(8 * rate):
        now = max(number / rate, now + 5e-5)
        now += draw.uniform(0.0, 0.09) if draw.random() < 2.0 / rate else 0.0
        list(paired.push_angle(AngleSample(round(1e9 * now), 0.1)))
        list(paired.push_load(LoadSample(round(1e9 * now), 1.0, 0.0, "")))
    assert paired.angle_time.holes.missing == paired.load_time.holes.missing
    assert paired.load_time.holes.missing <= 8 * rate // 100
