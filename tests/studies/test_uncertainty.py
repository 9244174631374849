"""A small version of the study of uncertainty: samples of all inputs agree with the linear propagation."""

import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.lab.uncertainty import read_uncertain_gait
from knee_contact_ros.parameters.files import load_parameters
from studies.uncertainty import SMALL, sampled


def test_small_deviations_are_linear(right_bag):
    with Bag(right_bag) as bag:
        gait = read_uncertain_gait(bag, load_parameters("healthy"), SMALL, compiled=True)
    linear = gait.propagate()
    ((depth, force),) = sampled(gait, linear, 100)
    # The standard deviation of 100 samples is known to 7 %.
    at = int(linear.medial.rows["load"].argmax())
    assert depth.deviation[at] == pytest.approx(linear.medial.depth[at], rel=0.2)
    assert force.deviation[at] == pytest.approx(linear.medial.force[at], rel=0.2)
    assert 0.85 < depth.inside.mean() <= 1.0
