"""What `solve` makes of recordings of drawn runs: the bits of the node, also its flags of clocks and publishers."""

import random

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.provenance import provenance_record, read_provenance
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import recorded_topics
from studies.drawn_runs import differences

STEP, AHEAD, TICKS = 10_000_000, 500_000_000, 300
"""Interval of the samples [ns], time by which the angles' clock is ahead [ns], and number of forces"""


@pytest.mark.parametrize("seed", range(0, 200, 20))
def test_live_and_offline_are_equal_in_drawn_runs(tmp_path, seed):
    for each in range(seed, seed + 20):
        folder = tmp_path / str(each)
        folder.mkdir()
        assert not differences(random.Random(each), folder), each


def test_forces_before_all_angles_are_answered_as_live(tmp_path):
    """The node held the last angle for 50 forces, and flagged the clocks; offline these forces had no answer."""
    pipeline, leg = ContactPipeline(Parameters(), compiled=False), DrawnLeg()
    with BagWriter(tmp_path / "live.mcap") as bag:
        topics = {topic: f"/{topic}" for topic in recorded_topics(False)}
        writer = AnswerWriter(bag, provenance_record(Parameters()), topics)
        for stamp in range(10**12, 10**12 + TICKS * STEP, STEP):
            state = JointState(stamp + AHEAD, "", ("knee",), (0.4,), (), ())
            wrench = WrenchStamped(stamp, "tibia", (0.0, -1400.0, 0.0), (0.0, 0.0, 0.0))
            pushed = (
                (pipeline.push_joint_state, encode_joint_state(state)),
                (pipeline.push_force, encode_wrench_stamped(wrench)),
            )
            for push, data in pushed:
                answers = list(push(data))
                while pipeline.notes:
                    writer.write_note(*pipeline.notes.pop(0))
                for answer in answers:
                    writer.write_answer(leg.records_with_leg(answer))
        writer.write_ending(pipeline.ending())
    with Bag(tmp_path / "live.mcap") as bag:
        basis = read_provenance(bag)
        assert basis is not None
        solve(bag, basis, tmp_path / "again.mcap", compiled=False)
    live, again = (read_answers(tmp_path / f"{name}.mcap") for name in ("live", "again"))
    fields = list(MESSAGE_FIELDS)
    assert np.array_equal(live.view(FLAT)[fields], again.view(FLAT)[fields])
    held = Status.INPUT_HELD | Status.STALE_INPUT
    assert (live["status"][: AHEAD // STEP] & held == held).all()
    assert (live["status"] & Status.STALE_INPUT != 0).all()
