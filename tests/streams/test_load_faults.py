"""What sensors get wrong: it is flagged or refused, and no estimate is a wrong number without a word."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.model.types import UNUSABLE, Status
from knee_contact_ros.streams.messages import WrenchStamped, encode_joint_state, encode_wrench_stamped
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, ground, joint_state, walk
from tests.streams.leg import POSE, by_stamp, estimates, force, pipeline, state, take


@pytest.mark.parametrize(
    "wrong",
    [{"positions": {"knee": 25.0 / 6.0}}, {"force": (0.0, -400.0, 0.0)}, {"force": (0.0, 9000.0, 0.0)}],
    ids=["degrees", "upside down", "another person"],
)
def test_what_no_leg_does_is_flagged(wrong: dict[str, Any]) -> None:
    pose = POSE | wrong.pop("positions", {})
    pipe = pipeline()
    found = estimates(pipe, [state(0, **pose), force(0, **wrong), state(5 * MS, **POSE), force(5 * MS)])
    assert [estimate.status for estimate in found] == [Status.IMPLAUSIBLE, 0]


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
