"""What of the motion is told from the angles: jumps, pauses, slow angles and changes are none."""

from __future__ import annotations

import pytest

from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, walk
from tests.streams.leg import by_stamp, estimates, pipeline, same, take


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


@pytest.mark.parametrize("apart", [20, 50, 70, 90])
def test_the_kinks_between_slow_angles_are_no_motion(apart: int) -> None:
    """Angles so many ms apart are interpolated for the forces between: no estimate is off by more than by no motion.

    And by what interpolation itself does to the angles, which the one without motion has too.
    """
    messages = [one for one in walk(300) if one.topic == FORCE or one.log_time % (apart * MS) == 0]
    slow, whole = by_stamp(take(pipeline(), messages)), by_stamp(take(pipeline(), walk(300)))
    still = by_stamp(take(pipeline(WHOLE_LEG | {"motion_window": 0.0}), messages))
    without = max(abs(still[stamp].axial_force - whole[stamp].axial_force) for stamp in still)
    assert max(abs(slow[stamp].axial_force - whole[stamp].axial_force) for stamp in slow) <= without


def test_another_offset_is_no_motion() -> None:
    pipe, messages = pipeline(), walk(200)
    take(pipe, messages[:200])
    pipe.retune(load_parameters(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2}, LoadParameters))
    found = [estimate for _, estimate in take(pipe, messages[200:])]
    expected = [e for _, e in take(pipeline(WHOLE_LEG | {"hip.offset": 0.2, "knee.offset": 0.2}), messages[200:])]
    assert found == expected


def test_another_constant_counts_from_the_next_estimate_on_and_the_motion_goes_on() -> None:
    changed, messages = WHOLE_LEG | {"person.tone": 0.6}, walk(100)
    pipe = pipeline()
    before = take(pipe, messages[:100])
    pipe.retune(load_parameters(changed, LoadParameters))
    after = take(pipe, messages[100:])
    whole, other = take(pipeline(), messages), take(pipeline(changed), messages)
    assert [*before, *after] == [*whole[:50], *other[50:]]
    assert whole[60] != other[60]


def test_a_stream_at_10_khz_is_answered_as_one_at_1_khz() -> None:
    quick, slow = by_stamp(take(pipeline(), walk(5000, MS // 10))), by_stamp(take(pipeline(), walk(500, MS)))
    assert len(quick) == 5000
    # Once the window is full it sees the same through other samples; 0.2 N apart, of some 3 kN.
    full = [stamp for stamp in slow if stamp >= 50 * MS]
    assert max(abs(quick[stamp].axial_force - slow[stamp].axial_force) for stamp in full) < 1.0
