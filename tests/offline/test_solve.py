"""The offline path on the real gait: the paper's numbers, and the same bits as the Python calls."""

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.offline.summary import read_summary
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import EACH_TICK, types_of
from knee_contact_ros.system.errors import UsageError
from tests.helpers.offline import solve

OUTPUTS = types_of(EACH_TICK)


def make_bag(path, rows, joint="knee", heights=None):
    """A bag of (stamp [ns], angle [rad], axial force [N]) and, as a second joint, femoral heights [m]."""
    with BagWriter(path) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for i, (stamp, angle, force) in enumerate(rows):
            names, positions = (joint,), (angle,)
            if heights is not None:
                names, positions = (*names, "knee_height"), (*positions, heights[i])
            state = JointState(stamp, "tibia_r", names, positions, (), ())
            wrench = WrenchStamped(stamp, "tibia_r", (0.0, -force, 0.0), (0.0, 0.0, 0.0))
            bag.write_message("/joint_states", stamp, encode_joint_state(state))
            bag.write_message("/joint_reaction_force", stamp, encode_wrench_stamped(wrench))
    return path


@pytest.mark.parametrize(
    ("files", "depth"),
    [
        (["healthy.yaml"], 0.747e-3),
        (["osteoarthritis.yaml"], 0.538e-3),
        (["healthy.yaml", "mri_femur.yaml"], 0.747e-3),
        (["osteoarthritis.yaml", "mri_femur.yaml"], 0.538e-3),
    ],
)
def test_the_second_stance_has_the_papers_peaks(config, right_bag, tmp_path, files, depth):
    parameters = load_parameters([config / name for name in files])
    summary = solve(right_bag, parameters, tmp_path / "out.mcap")
    assert (summary.ticks, summary.refused.total(), summary.flagged.total()) == (387, 0, 0)
    peaks = read_summary(tmp_path / "out.mcap", parameters.body_weight).load_peaks
    in_body_weights = [round(peak.load / parameters.body_weight, 2) for peak in peaks]
    assert in_body_weights == [1.72, 2.11, 1.81, 2.19]
    assert [round(peak.stamp / 1e9, 3) for peak in peaks] == [0.785, 1.205, 2.015, 2.43]
    # Contact force and load differ by the femur's inertia, 2.2 N at most on gait.
    assert all(abs(peak.contact_force - peak.load) < 3.0 for peak in peaks)
    assert round(peaks[-1].penetration_depth, 6) == depth
    assert round(summary.peaks["penetration_depth"].penetration_depth, 6) == depth


def test_a_bag_with_heights_drives_the_displacement(tmp_path):
    rows = [(i * 5_000_000, 0.1 + 0.01 * i, 800.0) for i in range(20)]
    heights = 0.034 - 6e-4 - 1e-4 * np.sin(np.arange(20.0))
    bag = make_bag(tmp_path / "in.mcap", rows, heights=heights)
    parameters = load_parameters({"drive": "displacement", "contact.law": "two_layer_elastic"})
    assert solve(bag, parameters, tmp_path / "out.mcap").ticks == 20
    answers = [
        m.message
        for m in read_bag(tmp_path / "out.mcap", {"/knee_contact": OUTPUTS["/knee_contact"]})
    ]
    assert [answer.femoral_height for answer in answers] == heights.tolist()
    law = knee_contact_ros.load_model(parameters).law
    expected = [law.static_force(0.034 - height) for height in heights]
    assert [answer.contact_force for answer in answers] == pytest.approx(
        expected, rel=1e-15
    )  # the same formula
    assert {answer.load for answer in answers} == {400.0}
    with pytest.raises(UsageError, match="no joint 'knee_height'; it has knee"):
        solve(make_bag(tmp_path / "without.mcap", rows), parameters, tmp_path / "o" / "out.mcap")
