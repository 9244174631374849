"""From the bytes of a leg's sensors to the joint reaction: answers, levels, motion, faults, an estimate's bytes."""

import math
from typing import Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st
from knee_contact_ros.msg import LoadEstimate
from rclpy.serialization import deserialize_message

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS, LoadEstimateFields
from knee_contact_ros.model.types import UNUSABLE, Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.load_pipeline import LoadPipeline, encode_estimate
from knee_contact_ros.streams.messages import (
    WRENCH,
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import (
    LOAD_ESTIMATE,
    MESSAGE_TYPES,
    deserialize,
    typestore,
)
from tests.helpers.answers import answers_to
from tests.helpers.messages import PlainMessages, header
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, ground, walk

POSE = {"hip": 0.3, "knee": 0.5, "ankle": 0.1}


def pipeline(values=None):
    return LoadPipeline(load_parameters(WHOLE_LEG if values is None else values, LoadParameters))


def take(pipe, messages):
    """What they make possible."""
    return list(answers_to(pipe, messages))


def by_stamp(answers):
    return {answer.sensed.stamp: answer.estimate for answer in answers}


def estimates(pipe, messages):
    answers = [*take(pipe, messages), *pipe.finish_streams()]
    return [answer.estimate for answer in answers]


def state(stamp, efforts=(), **positions):
    told = JointState(stamp, "", tuple(positions), tuple(positions.values()), (), efforts)
    return RawMessage(ANGLES, stamp, encode_joint_state(told))


def force(stamp, wrench=None, **parts):
    told = (wrench or ground(275 * MS))._replace(stamp=stamp, **parts)
    return RawMessage(FORCE, stamp, encode_wrench_stamped(told))


def once(values, efforts=(), **parts):
    """The estimate for one pose and one force."""
    (found,) = estimates(pipeline(values), [state(0, efforts, **POSE), force(0, **parts)])
    return found


def same(one, other, within=0.0):
    """Whether two estimates are alike; what is not a number is like itself."""
    return all(
        a == pytest.approx(b, abs=within, rel=0.0, nan_ok=True)
        for a, b in zip(one, other, strict=True)
    )


ROUNDING = 1e-8
"""[N] or [N m]: moments of 1e3 N m are rounded by 1e-13 in each of some ten steps, muscles divide them by 0.01 m"""


def test_the_reaction_is_in_the_tibia_frame_that_is_asked_for():
    answer, _ = take(pipeline(WHOLE_LEG | {"frame.tibia": "shank_isb"}), walk(2))
    estimate = answer.estimate
    assert WRENCH.read_message(answer.reaction, "")[0] == (
        0,
        "shank_isb",
        (0.0, -estimate.axial_force, 0.0),
        (estimate.frontal_moment, 0.0, 0.0),
    )


def test_an_actuator_takes_its_part_of_the_moments():
    """Efforts in the sense of the positions: 20 N m towards extension, 10 N m towards plantarflexion."""
    alone = once(WHOLE_LEG)
    values = WHOLE_LEG | {"knee.assisted": True, "ankle.assisted": True}
    helped = once(values, efforts=(0.0, -20.0, -10.0))
    assert helped.assistance == 20.0
    assert helped.knee_moment == pytest.approx(alone.knee_moment - 20.0, abs=ROUNDING)
    assert helped.ankle_moment == pytest.approx(alone.ankle_moment - 10.0, abs=ROUNDING)
    assert helped.axial_force < alone.axial_force
    assert same(once(values, efforts=(0.0, 0.0, 0.0)), alone)


def test_a_jump_back_and_a_reset_restart_the_motion_filter():
    pipe, still = pipeline(), pipeline(WHOLE_LEG | {"motion_window": 0.0})
    first = estimates(pipe, walk(60))
    assert not same(first[-1], estimates(still, walk(60))[-1], within=1.0)  # it was moving
    again = estimates(pipe, walk(60))
    assert [estimate.status for estimate in again] == [Status.TIME_RESET] + [0] * 59
    assert [estimate._replace(status=0) for estimate in again] == first
    pipe, messages = pipeline(), walk(90)
    take(pipe, messages[:120])
    pipe.reset()
    found = estimates(pipe, messages[120:])
    assert found[0].status == Status.TIME_RESET
    expected = estimates(pipeline(), messages[120:])
    assert [estimate._replace(status=0) for estimate in found] == expected


@pytest.mark.parametrize(
    ("pause", "given_up"), [(90, True), (90, False), (300, True), (300, False)]
)
def test_a_pause_of_the_angles_is_no_motion(pause, given_up):
    """Where they go on they are elsewhere, and nothing has jumped there; forces are given up meanwhile, or wait."""
    messages, silence = walk(200), range(300 * MS, (300 + pause) * MS)
    pipe, found = pipeline(), dict[int, LoadEstimateFields]()
    for message in messages:
        if message.topic == ANGLES and message.log_time in silence:
            continue
        found |= by_stamp(take(pipe, [message]))
        if (
            given_up and message.log_time in silence
        ):  # as the node does when a force has waited for long enough
            found |= by_stamp(pipe.flush_expired(math.inf))
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
    assert (
        max(abs(found[stamp].axial_force - whole[stamp].axial_force) for stamp in after) <= inertia
    )


@pytest.mark.parametrize("apart", [20, 90])
def test_the_kinks_between_slow_angles_are_no_motion(apart):
    """Angles so many ms apart are interpolated for the forces between: no estimate is off by more than by no motion.

    And by what interpolation itself does to the angles, which the one without motion has too.
    """
    messages = [one for one in walk(300) if one.topic == FORCE or one.log_time % (apart * MS) == 0]
    slow, whole = by_stamp(take(pipeline(), messages)), by_stamp(take(pipeline(), walk(300)))
    still = by_stamp(take(pipeline(WHOLE_LEG | {"motion_window": 0.0}), messages))
    without = max(abs(still[stamp].axial_force - whole[stamp].axial_force) for stamp in still)
    assert (
        max(abs(slow[stamp].axial_force - whole[stamp].axial_force) for stamp in slow) <= without
    )


def test_a_changed_offset_is_no_motion():
    pipe, messages = pipeline(), walk(200)
    take(pipe, messages[:200])
    pipe.retune(
        load_parameters(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2}, LoadParameters)
    )
    found = [answer.estimate for answer in take(pipe, messages[200:])]
    turned = pipeline(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2})
    assert found == [answer.estimate for answer in take(turned, messages[200:])]


def test_a_changed_constant_counts_from_the_next_estimate():
    changed, messages = WHOLE_LEG | {"person.tone": 0.6}, walk(100)
    pipe = pipeline()
    before = take(pipe, messages[:100])
    pipe.retune(load_parameters(changed, LoadParameters))
    after = take(pipe, messages[100:])
    whole, other = take(pipeline(), messages), take(pipeline(changed), messages)
    assert before == whole[:50]
    assert whole[60] != other[60]
    off = [
        one.estimate.axial_force - there.estimate.axial_force
        for one, there in zip(after, other[50:], strict=True)
    ]
    assert 1.0 < abs(off[0]) < abs(whole[50].estimate.axial_force - other[50].estimate.axial_force)
    fading = [off[0] * math.exp(-0.005 * number / 0.025) for number in range(len(off))]
    assert off == pytest.approx(
        fading, abs=ROUNDING
    )  # the muscles go on from the forces that they had


small: Any = st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-310, 2.2e-308, 1e-30])
extreme, wide = st.floats(-1e5, 1e5) | small, st.floats(-100.0, 100.0) | small


@given(
    st.tuples(extreme, extreme, extreme), st.tuples(extreme, extreme, extreme), wide, wide, wide
)
def test_any_accepted_samples_give_a_finite_estimate(acts, turns, hip, knee, ankle):
    stream = []
    for number in range(8):
        stamp, sign = number * MS, -1.0 if number % 2 else 1.0
        stream += [state(stamp, hip=sign * hip, knee=sign * knee, ankle=ankle)]
        stream += [force(stamp, WrenchStamped(0, "p", acts, turns))]
    for estimate in estimates(pipeline(WHOLE_LEG | {"motion_window": 0.01}), stream):
        assert all(map(math.isfinite, estimate._replace(expected_force=0.0)))
        assert (
            min(estimate.quadriceps_force, estimate.hamstrings_force, estimate.gastrocnemius_force)
            >= 0.0
        )


TYPE = MESSAGE_TYPES[LOAD_ESTIMATE]
KINDS = {"float": st.floats(), "int": st.integers(0, 255), "bool": st.booleans()}
any_estimates = st.builds(
    LoadEstimateFields,
    **{name: KINDS[kind.__name__] for name, kind in get_type_hints(LoadEstimateFields).items()},
)
frames = st.text(max_size=17).filter(lambda text: "\x00" not in text)
"""Of any length; a text of ROS's ends with a zero"""
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def fields_of(message):
    """What a message says behind its header; what is not a number is like itself."""
    return [repr(getattr(message, name)) for name in LoadEstimateFields._fields]


@given(stamps, frames, any_estimates)
def test_the_bytes_are_those_of_rosbags_and_ros(stamp, frame, estimate):
    plain = typestore().types[TYPE](
        header=header(PlainMessages, stamp, frame), **estimate._asdict()
    )
    data = encode_estimate(stamp, frame, estimate)
    assert data == bytes(typestore().serialize_cdr(plain, TYPE))
    for read in (deserialize(data, LOAD_ESTIMATE), deserialize_message(data, LoadEstimate)):
        assert fields_of(read) == fields_of(estimate)
        assert (
            read.header.frame_id,
            read.header.stamp.sec * 10**9 + read.header.stamp.nanosec,
        ) == (frame, stamp)


def test_constants_are_those_of_the_package():
    for name, way in LOAD_LEVELS.items():
        assert getattr(LoadEstimate, name.upper()) == way.level
    known = [bit for bit in Status if hasattr(LoadEstimate, bit.name or "")]
    assert [getattr(LoadEstimate, bit.name or "") for bit in known] == known
    assert sum(known) & UNUSABLE == LoadEstimate.UNUSABLE
    fields = [name for name in LoadEstimate.get_fields_and_field_types() if name != "header"]
    assert fields == list(LoadEstimateFields._fields)
