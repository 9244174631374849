"""The search for the dearest tick keeps to its motions and to the budget."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros import load_model
from studies.worst_tick import FASTEST, STRONGEST, search


def test_a_search_finds_dearer_ticks_than_gait_and_none_beyond_the_budget():
    knee = replace(load_model("mri_femur", compiled=True), budget=300)
    found = search(knee, 0.005, 20, seed=1)
    costs = [one.evaluations for one in found]
    assert costs == sorted(costs)
    assert 150 < costs[-1] <= 300
    for one in found:
        assert np.abs(np.diff(one.samples[:, 1])).max() <= 0.005 * FASTEST * (1 + 1e-9)
        assert one.samples[:, 2].max() <= STRONGEST
        assert one.seconds > 0.0
