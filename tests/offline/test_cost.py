"""What answers cost, counted and not timed: evaluations of the law; `costs.yaml` has the numbers."""

import pytest

from knee_contact_ros.system.files import share_folder
from tests.helpers.costs import COSTS
from tests.helpers.offline import solve

BAG = share_folder() / "bags" / "gait2354_right"


@pytest.mark.parametrize("name", COSTS["evaluations"])
def test_a_gait_takes_no_more_evaluations(name):
    counted = []

    def keep(block):
        counted.extend(int(part["evaluations"].sum()) for part in block.rows)

    solve(BAG, ["healthy", name], None, keep=keep)
    assert sum(counted) == pytest.approx(COSTS["evaluations"][name], rel=0.02)
