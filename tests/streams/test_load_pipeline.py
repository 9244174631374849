"""From the bytes of a leg's sensors to the joint reaction: answers, levels, axes and frames."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.joint_reaction.estimator import LEVELS, Deviation
from knee_contact_ros.streams.frames import FROM_REP_103, Transform
from knee_contact_ros.streams.messages import (
    JOINT_STATE,
    WRENCH,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import LOAD_RECORDED
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, walk
from tests.streams.leg import estimates, force, once, pipeline, same, state, take

ROUNDING = 1e-8
"""[N] or [N m]: moments of 1e3 N m are rounded by 1e-13 in each of some ten steps, muscles divide them by 0.01 m"""


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
