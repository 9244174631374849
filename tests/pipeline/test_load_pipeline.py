"""From the bytes of a leg's sensors to the joint reaction: pairing, levels, axes, frames, jumps, changes, faults."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.core.types import UNUSABLE, Status
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.joint_reaction.levels import LEVELS, Deviation
from knee_contact_ros.messages.answer import Answer
from knee_contact_ros.messages.cdr import (
    JOINT_STATE,
    WRENCH,
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.messages.topics import LOAD_RECORDED
from knee_contact_ros.messages.transforms import Transform
from knee_contact_ros.parameters.load_schema import LOAD_READING
from knee_contact_ros.pipeline.frames import FROM_REP_103
from knee_contact_ros.pipeline.load_pipeline import LoadPipeline
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, ground, joint_state, walk

ROUNDING = 1e-8
"""[N] or [N m]: moments of 1e3 N m are rounded by 1e-13 in each of some ten steps, muscles divide them by 0.01 m"""
POSE = {"hip": 0.3, "knee": 0.5, "ankle": 0.1}


def pipeline(values: Any = None) -> LoadPipeline:
    return LoadPipeline(LOAD_READING.load(WHOLE_LEG if values is None else values))


def take(pipe: LoadPipeline, messages: Iterable[RawMessage]) -> list[tuple[Answer, Estimate]]:
    """What they make possible."""
    found = []
    for message in messages:
        for answer in (pipe.joint_state if message.topic == ANGLES else pipe.force)(message.data):
            assert pipe.estimate
            found.append((answer, pipe.estimate))
    return found


def by_stamp(found: Iterable[tuple[Answer, Estimate]]) -> dict[int, Estimate]:
    return {answer.records[-1][1]: estimate for answer, estimate in found}


def estimates(pipe: LoadPipeline, messages: Iterable[RawMessage]) -> list[Estimate]:
    found = [estimate for _, estimate in take(pipe, messages)]
    for _ in pipe.finish():
        assert pipe.estimate
        found.append(pipe.estimate)
    return found


def state(stamp: int, efforts: tuple[float, ...] = (), **positions: float) -> RawMessage:
    told = JointState(stamp, "", tuple(positions), tuple(positions.values()), (), efforts)
    return RawMessage(ANGLES, stamp, encode_joint_state(told))


def force(stamp: int, wrench: WrenchStamped | None = None, **parts: Any) -> RawMessage:
    told = (wrench or ground(275 * MS))._replace(stamp=stamp, **parts)
    return RawMessage(FORCE, stamp, encode_wrench_stamped(told))


def once(values: Any, efforts: tuple[float, ...] = (), **parts: Any) -> Estimate:
    """The estimate for one pose and one force."""
    (found,) = estimates(pipeline(values), [state(0, efforts, **POSE), force(0, **parts)])
    return found


def same(one: Estimate, other: Estimate, within: float = 0.0) -> bool:
    """Whether two estimates are alike; what is not a number is like itself."""
    return all(a == pytest.approx(b, abs=within, rel=0.0, nan_ok=True) for a, b in zip(one, other, strict=True))


def test_an_answer_holds_what_led_to_it_and_both_messages() -> None:
    messages = walk(2)
    (first, estimate), _ = take(pipeline(), messages)
    topics, stamps, data = zip(*first.records, strict=True)
    assert topics == LOAD_RECORDED
    assert (stamps, data[:2]) == ((0,) * 4, (messages[0].data, messages[1].data))
    assert (first.row, first.size) == (b"", sum(map(len, data)))
    reaction = WRENCH.decode(data[2])
    assert reaction
    told, _ = reaction
    assert told == (0, "tibia", (0.0, -estimate.axial_force, 0.0), (estimate.frontal_moment, 0.0, 0.0))


def test_the_frame_is_the_tibias() -> None:
    ((answer, _),) = take(pipeline({"frame.tibia": "shank_isb"}), [state(0, knee=0.1), force(0)])
    decoded = WRENCH.decode(answer.records[2][2])
    assert decoded
    assert decoded[0].frame_id == "shank_isb"
    assert b"shank_isb\0" in answer.records[3][2]


@pytest.mark.parametrize(("level", "known"), [("ground_force", 0), ("knee_moment", 1), ("ankle_moment", 2)])
def test_a_level_tells_what_it_knows(level: str, known: int) -> None:
    found = once(WHOLE_LEG | {"level": level})
    assert found.level == known
    assert math.isfinite(found.frontal_moment) == (known > 0)
    assert math.isfinite(found.ankle_moment) == (known > 1)
    assert (found.gastrocnemius_force > 0.0) == (known > 1)
    parts = found.resultant_force + found.quadriceps_force + found.hamstrings_force + found.gastrocnemius_force
    assert found.axial_force == pytest.approx(parts, abs=ROUNDING)


def test_the_vertical_force_alone_gives_the_lowest_level_of_the_whole_one() -> None:
    assert once({}) == pytest.approx(once(WHOLE_LEG | {"level": "ground_force"}), abs=0.0, nan_ok=True)


def test_an_actuator_takes_its_part_of_the_moments() -> None:
    """Efforts in the sense of the positions: 20 N m towards extension, 10 N m towards plantarflexion."""
    alone = once(WHOLE_LEG)
    values = WHOLE_LEG | {"knee.assisted": True, "ankle.assisted": True}
    helped = once(values, efforts=(0.0, -20.0, -10.0))
    assert helped.assistance == 20.0
    assert helped.knee_moment == pytest.approx(alone.knee_moment - 20.0, abs=ROUNDING)
    assert helped.ankle_moment == pytest.approx(alone.ankle_moment - 10.0, abs=ROUNDING)
    assert helped.axial_force < alone.axial_force
    assert same(once(values, efforts=(0.0, 0.0, 0.0)), alone)


parts = st.floats(-1e3, 1e3)
vectors = st.tuples(parts, parts, parts)
angles, levers = st.floats(-1.0, 1.0), st.floats(-0.3, 0.3)


@given(vectors, vectors, angles, st.floats(-0.1, 1.9), st.floats(-0.5, 0.5), levers, levers)
def test_axes_and_lever_of_the_sensor_do_not_matter(
    acts: Any, turns: Any, hip: float, knee: float, ankle: float, x: float, y: float
) -> None:
    """One force and one moment at the ankle, told by a sensor there, by one beside it, and by one on the foot."""
    pose = state(0, hip=hip, knee=knee, ankle=ankle)
    # Told from where the ankle is at (x, y): about there, it turns by the moment of a force at the ankle, too.
    beside = (turns[0] + y * acts[2], turns[1] - x * acts[2], turns[2] + x * acts[1] - y * acts[0])
    there, lever = WrenchStamped(0, "p", acts, turns), {"ground.ankle_x": x, "ground.ankle_y": y}
    turn = hip - knee + ankle

    def on_foot(vector: Any) -> Any:
        cosine, sine = math.cos(turn), math.sin(turn)
        return cosine * vector[0] + sine * vector[1], cosine * vector[1] - sine * vector[0], vector[2]

    seen = on_foot(acts), on_foot(turns)
    foot_x, foot_y = (
        cut * math.cos(turn) + sign * other * math.sin(turn) for cut, other, sign in ((x, y, 1), (y, x, -1))
    )
    on_the_foot = {"ground.axes": "foot", "ground.ankle_x": foot_x, "ground.ankle_y": foot_y}
    told = [
        ({}, there),
        (lever, there._replace(torque=beside)),
        ({"ground.axes": "foot"}, there._replace(force=seen[0], torque=seen[1])),
        (on_the_foot, there._replace(force=seen[0], torque=on_foot(beside))),
    ]
    found = [estimates(pipeline(WHOLE_LEG | values), [pose, force(0, wrench)]) for values, wrench in told]
    for (other,) in found[1:]:
        assert same(found[0][0], other, within=ROUNDING)


@given(st.integers(0, 10**9))
@settings(max_examples=20)
def test_the_order_of_arrival_does_not_matter(seed: int) -> None:
    messages = walk(30)
    expected = [answer for answer, _ in take(pipeline(), messages)]
    queues = [[m for m in messages if m.topic == topic] for topic in (ANGLES, FORCE)]
    rng, mixed = random.Random(seed), list[RawMessage]()
    while any(queues):
        mixed.append(rng.choice([queue for queue in queues if queue]).pop(0))
    assert [answer for answer, _ in take(pipeline(), mixed)] == expected


def test_joints_may_change_their_places_between_messages() -> None:
    def reordered(message: RawMessage) -> RawMessage:
        decoded = JOINT_STATE.decode(message.data)
        assert decoded
        told, order = decoded[0], random.Random(message.log_time).sample(range(3), 3)
        names, positions = (tuple(row[i] for i in order) for row in (told.name, told.position))
        return message._replace(data=encode_joint_state(told._replace(name=names, position=positions)))

    messages = walk(30)
    mixed = [reordered(message) if message.topic == ANGLES else message for message in messages]
    assert estimates(pipeline(), mixed) == estimates(pipeline(), messages)


def test_between_two_angles_all_that_is_known_of_the_leg_is_on_a_line() -> None:
    values = WHOLE_LEG | {"knee.assisted": True, "motion_window": 0.0}
    ends = [
        state(0, (0.0, -4.0), hip=0.1, knee=0.2, ankle=0.0),
        state(4 * MS, (0.0, -8.0), hip=0.5, knee=0.4, ankle=0.2),
    ]
    (between,) = estimates(pipeline(values), [ends[0], force(MS), ends[1]])
    on_it = state(MS, (0.0, -5.0), hip=0.2, knee=0.25, ankle=0.05)
    (there,) = estimates(pipeline(values), [on_it, force(MS)])
    assert between.assistance == 5.0
    assert same(between, there, within=ROUNDING)


def test_forces_in_the_plates_own_frame_are_turned() -> None:
    """A treadmill whose z is up and whose x is forward, and the same by its name alone."""
    messages = walk(20)

    def rep_103(message: RawMessage) -> RawMessage:
        decoded = WRENCH.decode(message.data)
        assert decoded
        told = decoded[0]
        vectors = (told.force, told.torque)
        turned, about = ((x, -z, y) for x, y, z in vectors)
        told = told._replace(frame_id="treadmill", force=turned, torque=about)
        return message._replace(data=encode_wrench_stamped(told))

    theirs = [rep_103(message) if message.topic == FORCE else message for message in messages]
    expected = estimates(pipeline(), messages)
    pipe = pipeline(WHOLE_LEG | {"frame.ground": "treadmill_isb"})
    found = estimates(pipe, theirs)
    assert len(found) == 20
    assert all(same(one, other, within=ROUNDING) for one, other in zip(found, expected, strict=True))
    named = pipeline(WHOLE_LEG | {"frame.ground": "ground"})
    assert named.frame.learn([Transform("treadmill", "ground", (0.0, 0.0, 0.0), FROM_REP_103)]) == []
    assert estimates(named, theirs) == found
    unknown = pipeline(WHOLE_LEG | {"frame.ground": "ground"})
    assert estimates(unknown, theirs) == []
    assert unknown.synchroniser.refused == {"frame_unknown": 20}
    assert "ground_reaction_force is in frame 'treadmill'" in unknown.last_refusal


def test_what_is_recorded_is_turned_and_gives_the_same_again() -> None:
    turning = WHOLE_LEG | {"frame.ground": "treadmill_isb"}
    records = [
        record for answer, _ in take(pipeline(turning), walk(20, frame="treadmill")) for record in answer.records
    ]
    recorded = [
        RawMessage(f"/{topic}", stamp, data) for topic, stamp, data in records if f"/{topic}" in (ANGLES, FORCE)
    ]
    again = [record for answer, _ in take(pipeline(turning), recorded) for record in answer.records]
    assert again == records


def test_a_stamp_that_jumps_back_has_the_motion_seen_anew() -> None:
    pipe, still = pipeline(), pipeline(WHOLE_LEG | {"motion_window": 0.0})
    first = estimates(pipe, walk(60))
    assert not same(first[-1], estimates(still, walk(60))[-1], within=1.0)  # it was moving
    again = estimates(pipe, walk(60))
    assert [estimate.status for estimate in again] == [Status.TIME_RESET] + [0] * 59
    assert [estimate._replace(status=0) for estimate in again] == first


def test_a_reset_has_the_motion_seen_anew() -> None:
    pipe, messages = pipeline(), walk(90)
    take(pipe, messages[:120])
    pipe.reset()
    found = estimates(pipe, messages[120:])
    assert found[0].status == Status.TIME_RESET
    expected = estimates(pipeline(), messages[120:])
    assert [estimate._replace(status=0) for estimate in found] == expected


@pytest.mark.parametrize(("pause", "given_up"), [(90, True), (90, False), (300, True), (300, False)])
def test_a_pause_of_the_angles_is_no_motion(pause: int, given_up: bool) -> None:
    """Where they go on they are elsewhere, and nothing has jumped there; forces are given up meanwhile, or wait."""
    messages, silence = walk(200), range(300 * MS, (300 + pause) * MS)
    pipe, found = pipeline(), dict[int, Estimate]()
    for message in messages:
        if message.topic == ANGLES and message.log_time in silence:
            continue
        found |= by_stamp(take(pipe, [message]))
        if given_up and message.log_time in silence:  # as the node does when a force has waited for long enough
            for pair in pipe.synchroniser.give_up():
                pipe.compute(pair)
                assert pipe.estimate
                found[pair.load.stamp] = pipe.estimate
    kind = Status.INPUT_HELD if given_up else Status.STALE_INPUT
    flagged = [stamp for stamp, estimate in found.items() if estimate.status & kind]
    expected = range(300 * MS, silence.stop, 5 * MS) if given_up or pause > 100 else range(0)
    assert flagged == list(expected)
    whole = by_stamp(take(pipeline(), messages))
    still = by_stamp(take(pipeline(WHOLE_LEG | {"motion_window": 0.0}), messages))
    inertia = max(abs(whole[stamp].axial_force - still[stamp].axial_force) for stamp in whole)
    # From then on at most as far off as one that sees no motion; 15 times as far if the pause is taken for one.
    after = [stamp for stamp in found if stamp >= silence.stop]
    assert {found[stamp].status for stamp in after} == {0}
    assert max(abs(found[stamp].axial_force - whole[stamp].axial_force) for stamp in after) <= inertia


def test_another_offset_is_no_motion() -> None:
    pipe, messages = pipeline(), walk(200)
    take(pipe, messages[:200])
    pipe.retune(LOAD_READING.load(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2}))
    found = [estimate for _, estimate in take(pipe, messages[200:])]
    expected = [e for _, e in take(pipeline(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2}), messages[200:])]
    assert found == expected


def test_another_constant_counts_from_the_next_estimate_on_and_the_motion_goes_on() -> None:
    changed, messages = WHOLE_LEG | {"person.tone": 0.6}, walk(100)
    pipe = pipeline()
    before = take(pipe, messages[:100])
    pipe.retune(LOAD_READING.load(changed))
    after = take(pipe, messages[100:])
    whole, other = take(pipeline(), messages), take(pipeline(changed), messages)
    assert [*before, *after] == [*whole[:50], *other[50:]]
    assert whole[60] != other[60]


@pytest.mark.parametrize(
    ("values", "deviation"),
    [
        ({}, LEVELS["ground_force"].error.uncalibrated),
        ({"calibrated": True}, LEVELS["ground_force"].error.calibrated),
        ({"standard_deviation": 0.1}, Deviation(0.1, 0.0)),
    ],
)
def test_how_sure_an_estimate_is(values: dict[str, Any], deviation: Deviation) -> None:
    found = once(values | {"person.mass": 50.0})
    assert found.standard_deviation == pytest.approx(deviation.at(found.axial_force, 50.0 * 9.80665), rel=1e-15)
    assert found.calibrated == ("calibrated" in values)


def test_status_bits_are_those_of_the_contact() -> None:
    pipe = pipeline({"pairing.max_gap": 0.02})
    bad = RawMessage(ANGLES, 0, b"\0\1\0\0 this is none")
    stream = [state(0, knee=0.1), force(0), bad, state(5 * MS, knee=0.1), force(5 * MS)]
    stream += [state(50 * MS, knee=0.1), force(50 * MS), force(52 * MS)]
    found = estimates(pipe, stream)
    assert [each.status for each in found] == [0, Status.INPUT_REJECTED, Status.STALE_INPUT, Status.INPUT_HELD]
    assert pipe.synchroniser.refused == {"undecodable": 1}


def test_efforts_that_come_and_go_are_refused_and_said() -> None:
    """An actuator of which nothing is known is not one that does nothing."""
    values, efforts = WHOLE_LEG | {"knee.assisted": True}, (0.0, -20.0, 0.0)
    stream = []
    for number in range(6):
        stamp = number * 5 * MS
        stream += [state(stamp, efforts if number % 2 == 0 else (), **POSE), force(stamp)]
    pipe = pipeline(values)
    found = estimates(pipe, stream)
    assert pipe.synchroniser.refused == {"joint_missing": 3}
    assert {estimate.assistance for estimate in found} == {20.0}
    assert len(found) == 6
    assert [bool(each.status & Status.INPUT_REJECTED) for each in found] == [False, True, False, True, False, True]


def test_a_force_twice_is_answered_once() -> None:
    pipe = pipeline()
    messages = [message for message in walk(10) for _ in range(2)]
    found = estimates(pipe, messages)
    assert len(found) == 10
    assert pipe.synchroniser.refused == {"angle_not_in_order": 10, "load_not_in_order": 10}


small: Any = st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-310, 2.2e-308, 1e-30])


@given(st.tuples(small, small, small), st.tuples(small, small, small), small, small, small)
def test_numbers_that_are_hardly_any_give_estimates(
    acts: Any, turns: Any, hip: float, knee: float, ankle: float
) -> None:
    stream = []
    for number in range(20):
        stamp = number * 5 * MS
        stream += [state(stamp, hip=hip, knee=-knee if number % 2 else knee, ankle=ankle)]
        stream += [force(stamp, WrenchStamped(0, "p", acts, turns))]
    found = estimates(pipeline(), stream)
    assert len(found) == 20
    assert all(map(math.isfinite, found[-1]))


extreme = st.floats(-1e5, 1e5)
wide = st.floats(-100.0, 100.0)


@given(st.tuples(extreme, extreme, extreme), st.tuples(extreme, extreme, extreme), wide, wide, wide)
def test_whatever_is_taken_gives_a_finite_estimate(
    acts: Any, turns: Any, hip: float, knee: float, ankle: float
) -> None:
    stream = []
    for number in range(8):
        stamp, sign = number * MS, -1.0 if number % 2 else 1.0
        stream += [state(stamp, hip=sign * hip, knee=sign * knee, ankle=ankle)]
        stream += [force(stamp, WrenchStamped(0, "p", acts, turns))]
    for estimate in estimates(pipeline(WHOLE_LEG | {"motion_window": 0.01}), stream):
        assert all(map(math.isfinite, estimate))
        assert min(estimate.quadriceps_force, estimate.hamstrings_force, estimate.gastrocnemius_force) >= 0.0


def restarting(seed: int, topic: str) -> list[tuple[float, RawMessage]]:
    """A sensor's messages, each with when it comes: it pauses now and then, and its clock goes back, or far ahead."""
    rng, stamp, clock, messages = random.Random(f"{seed} {topic}"), 0, 0, list[tuple[float, RawMessage]]()
    step = rng.choice([1, 5, 10]) * MS
    for _ in range(150):
        walking = encode_joint_state(joint_state(stamp)) if topic == ANGLES else encode_wrench_stamped(ground(stamp))
        messages.append((clock, RawMessage(topic, stamp, walking)))
        stamp, clock = stamp + step, clock + step
        if rng.random() < 0.02:
            stamp = rng.choice([0, stamp + 500 * MS, max(0, stamp - 300 * MS), 10**15])
        if rng.random() < 0.01:
            clock += rng.choice([50, 200, 900]) * MS
    return messages


@given(st.integers(0, 10**9))
@settings(max_examples=25)
def test_whatever_sensors_do_an_estimate_that_is_usable_has_the_angle_of_its_stamp(seed: int) -> None:
    """The leg walks by its stamps, so each of them has one angle, whichever start of a sensor it comes from."""
    pipe, found, before = pipeline({}), list[tuple[int, Estimate]](), 0.0
    for clock, message in sorted(restarting(seed, ANGLES) + restarting(seed, FORCE), key=lambda one: one[0]):
        found += by_stamp(take(pipe, [message])).items()
        for pair in pipe.synchroniser.give_up() if clock - before > 100 * MS else ():  # as the node does
            pipe.compute(pair)
            assert pipe.estimate
            found.append((pair.load.stamp, pipe.estimate))
        before = clock
    assert found
    for stamp, estimate in found:
        if not estimate.status & UNUSABLE:
            # A straight line over 0.1 s is off by at most (0.1 s)^2 / 8 times 0.3 (2 pi / 1.1 s)^2: 0.0122 rad
            assert estimate.flexion_angle == pytest.approx(joint_state(stamp).position[1], abs=0.0125)


def test_a_stream_at_10_khz_is_answered_as_one_at_1_khz() -> None:
    quick, slow = by_stamp(take(pipeline(), walk(5000, MS // 10))), by_stamp(take(pipeline(), walk(500, MS)))
    assert len(quick) == 5000
    # Once the window is full it sees the same through other samples; 0.2 N apart, of some 3 kN.
    full = [stamp for stamp in slow if stamp >= 50 * MS]
    assert max(abs(quick[stamp].axial_force - slow[stamp].axial_force) for stamp in full) < 1.0
