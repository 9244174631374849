"""`knee_contact_ros.estimate_load`: the numbers of the command, in a notebook."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.offline.notebooks import DTYPE
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from tests.helpers.walking import WHOLE_LEG, walk, walking_bag


def test_it_gives_what_the_command_computes(tmp_path: Path) -> None:
    bag = walking_bag(tmp_path / "in.mcap", walk())
    told = []
    parameters = load_parameters([WHOLE_LEG, {"person.mass": 60.0}], LoadParameters)
    estimate_load(bag, parameters, None, lambda *_: None, keep=lambda stamp, each: told.append((stamp, *each)))
    found = knee_contact_ros.estimate_load(bag, WHOLE_LEG, {"person.mass": 60.0}, output=tmp_path / "out.mcap")
    assert found.dtype == DTYPE
    assert found.tobytes() == np.array(told, DTYPE).tobytes()
    assert len(knee_contact_ros.solve(tmp_path / "out.mcap")) == len(found)


def test_what_is_wrong_is_said_in_python(tmp_path: Path) -> None:
    bag = walking_bag(tmp_path / "in.mcap", walk())
    with pytest.raises(knee_contact_ros.UsageError, match=r"did you mean person\.mass"):
        knee_contact_ros.estimate_load(bag, values={"persn.mass": 60.0})
    with pytest.raises(knee_contact_ros.UsageError, match=r"remap: .* is not allowed; a mapping"):
        knee_contact_ros.estimate_load(bag, remap=["joint_states"])  # type: ignore[arg-type]
    with pytest.raises(knee_contact_ros.UsageError, match="is no input; FROM must be joint_states or ground_reaction"):
        knee_contact_ros.estimate_load(bag, remap={"joint_reaction_force": "/force"})
