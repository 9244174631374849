"""What `solve` makes of recordings of drawn runs: the bits of the node, also its flags of clocks and publishers."""

import random

import pytest

from studies.drawn_runs import differences


@pytest.mark.parametrize("seed", range(0, 200, 20))
def test_live_and_offline_are_equal_in_drawn_runs(tmp_path, seed):
    for each in range(seed, seed + 20):
        folder = tmp_path / str(each)
        folder.mkdir()
        assert not differences(random.Random(each), folder), each
