"""Joint states that are spread over messages: taken together, and named where one never comes."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.joints import SpreadJoints
from knee_contact_ros.streams.load_pipeline import LoadPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    RefusedSampleError,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)

STEP = 5_000_000
GAP = 100_000_000
LEG = {"hip.joint_name": "hip", "ankle.joint_name": "ankle"}
POSE = {"hip": 0.1, "knee": 0.4, "ankle": -0.1}


def state(stamp, **positions):
    return JointState(stamp, "", tuple(positions), tuple(positions.values()), (), ())


def force(stamp):
    return encode_wrench_stamped(
        WrenchStamped(stamp, "ground", (0.0, 400.0, 0.0), (0.0, 0.0, 0.0))
    )


def answers_of(pipeline, messages):
    """Answers to joint states, and to forces at stamps [ns]."""
    answers = []
    for each in messages:
        if isinstance(each, int):
            answers += pipeline.push_force(force(each))
        else:
            answers += pipeline.push_joint_state(encode_joint_state(each))
    return [*answers, *pipeline.finish_streams()]


@pytest.mark.parametrize("order", list(itertools.permutations(POSE)))
def test_each_driver_may_publish_its_own_joint(order):
    def spread(i):
        parts = [
            state(STEP * i + 1000 * k, **{joint: POSE[joint] + 0.001 * i})
            for k, joint in enumerate(order)
        ]
        return [*parts, STEP * i + 3000]

    messages = [message for i in range(200) for message in spread(i)]
    load = LoadPipeline(load_parameters(LEG, LoadParameters))
    estimates = answers_of(load, messages)
    contact = ContactPipeline(load_parameters({}), compiled=False)
    contacts = answers_of(contact, messages)
    for pipeline, answers in ((load, estimates), (contact, contacts)):
        assert [each.pair.status for each in answers] == [0] * 199 + [4]  # the last one waits
        assert pipeline.refused == 0
    last = estimates[-2].sensed.joints
    moved = 0.198 + 0.001 * 3000 / STEP  # where the knee is at the force
    assert (last.flexion, last.hip) == pytest.approx((0.4 + moved, 0.1 + moved), abs=1e-6)


def test_one_message_of_all_gives_the_same_as_several_at_one_stamp():
    whole, several = list[JointState | int](), list[JointState | int]()
    for i in range(100):
        pose = {joint: angle + 0.002 * i for joint, angle in POSE.items()}
        whole += [state(STEP * i, **pose), STEP * i]
        several += [*(state(STEP * i, **{joint: pose[joint]}) for joint in pose), STEP * i]
    one, other = (
        answers_of(LoadPipeline(load_parameters(LEG, LoadParameters)), each)
        for each in (whole, several)
    )
    assert [each.message for each in one] == [each.message for each in other]


def test_a_joint_that_never_comes_is_named():
    joints = SpreadJoints(("knee", "hip"), GAP)
    for i in range(GAP // STEP + 1):
        assert joints.join(state(i * STEP, knee=0.1)) is None
        assert joints.join(state(i * STEP, ankle=0.1)) is None
    with pytest.raises(RefusedSampleError, match="has no joint 'hip'; it has knee, ankle"):
        joints.join(state(GAP + STEP, knee=0.1))
    assert joints.join(state(GAP + STEP, hip=0.2, wrist=0.0)) == state(GAP, knee=0.1, hip=0.2)
    assert joints.join(state(10 * GAP, wrist=0.0)) is None  # it is another joint's


def test_joints_whose_clocks_differ_are_refused():
    joints = SpreadJoints(("knee", "hip"), GAP)
    joints.join(state(0, knee=0.1))
    with pytest.raises(RefusedSampleError, match=r"messages 0.101 s apart, above pairing.max_gap"):
        joints.join(state(GAP + 1_000_000, hip=0.1))


@given(
    st.lists(st.sets(st.sampled_from(["knee", "hip", "ankle", "wrist"]), min_size=1), max_size=30)
)
def test_no_value_is_used_twice_or_taken_from_another_joint(parts):
    joints, used = SpreadJoints(("knee", "hip"), GAP), set[float]()
    for i, names in enumerate(parts):
        message = state(
            i, **{name: i + {"knee": 0.1, "hip": 0.2}.get(name, 0.9) for name in sorted(names)}
        )
        joined = joints.join(message)
        if joined:
            assert [round(value % 1.0, 6) for value in joined.position] == [0.1, 0.2]
            assert joined.stamp == math.floor(joined.position[0])
            assert not used & set(joined.position)
            used |= set(joined.position)
