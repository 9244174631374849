"""What answers cost, counted and not timed: evaluations of the law, and calls. A change that costs more fails.

The limits are what was counted when they were set, and a fiftieth more. One that is lowered or raised says so here.
"""

import sys

import numpy as np
import pytest

from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.system.files import share_folder
from tests.helpers.bags import raw_messages
from tests.helpers.offline import solve

BAG = share_folder() / "bags" / "gait2354_right"
ALLOWED = 1.02
EVALUATIONS = {
    "healthy": 7165,
    "osteoarthritis": 9726,
    "osteoarthritis_as_printed": 28218,
    "mri_knee": 7349,
    "both_compartments": 14330,
}
"""Contact law evaluations of the shipped gait's 387 ticks, by parameter file; as printed, arthritis took 15582 before
its undamped layer was known for 30 s and not 1, mri_knee 7157 before knots counted in the estimate (8afde34)"""
CALLS = 141
"""Calls of functions, Python's and C's, from the bytes of an angle and a force to those of the answer; 136
before a doubtful load and a clock that is wrong for good were flagged (9f2c254 to 1a670c1)"""


@pytest.mark.parametrize("name", EVALUATIONS)
def test_a_gait_takes_no_more_evaluations(name):
    counted: list[int] = []

    def keep(block):
        counted.extend(int(part["evaluations"].sum()) for part in block.rows)

    solve(BAG, load_parameters(["healthy", name]), None, keep=keep)
    assert 0.5 * EVALUATIONS[name] < sum(counted) <= ALLOWED * EVALUATIONS[name]


def test_a_live_sample_takes_no_more_calls():
    stream = ContactPipeline(load_parameters("healthy"), compiled=True)
    leg = DrawnLeg()
    calls: list[int] = []

    def on_event(_frame, event, _argument):
        calls[-1] += event in ("call", "c_call")

    for message in raw_messages(BAG):
        calls.append(0)
        is_force = message.topic.endswith("force")
        push = stream.push_force if is_force else stream.push_joint_state
        sys.setprofile(on_event)
        try:
            for answer in push(message.data):
                answer.rows_with_latency(0.0)
                leg.records_with_leg(answer)
        finally:
            sys.setprofile(None)
    pairs = np.array(calls[200:600]).reshape(-1, 2).sum(axis=1)  # an angle and a force each
    assert 0.5 * CALLS < np.median(pairs) <= ALLOWED * CALLS
