"""`solve` and `estimate_load` of Python: the answers of the commands of these names, bit for bit, and their options."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros import Results, UsageError, solve
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS
from knee_contact_ros.offline.estimate_load import ESTIMATE
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from tests.helpers.offline import estimate_load
from tests.helpers.walking import WHOLE_LEG, walk, walking_bag


def told(rows):
    """All that the message tells of answers, as bytes."""
    flat = np.asarray(rows).view(FLAT)
    return [np.ascontiguousarray(flat[name]).tobytes() for name in (*MESSAGE_FIELDS, "stamp")]


WAYS = {
    "nothing": ([], {}),
    "names": (
        ["--params", "osteoarthritis", "--params", "mri_femur"],
        {"params": ["osteoarthritis", "mri_femur.yaml"]},
    ),
    "a nested value": (["-p", "femur.mass:=8.0"], {"values": {"femur": {"mass": 8.0}}}),
}


@pytest.mark.parametrize("way", WAYS)
def test_it_gives_what_the_command_records(way, right_bag, tmp_path):
    arguments, asked = WAYS[way]
    assert main(["solve", str(right_bag), *arguments, "--output", str(tmp_path / "out.mcap")]) == 0
    (tmp_path / "ours").mkdir()
    results = solve(right_bag, output=tmp_path / "ours" / "out.mcap", **asked, compiled=True)
    assert isinstance(results, Results)
    assert told(results) == told(read_answers(tmp_path / "out.mcap"))
    assert (tmp_path / "ours" / "out.mcap").read_bytes() == (tmp_path / "out.mcap").read_bytes()
    assert told(solve(str(right_bag), **asked, compiled=True)) == told(results)
    assert told(solve(tmp_path / "out.mcap", compiled=True)) == told(
        results
    )  # by the parameters in it


def test_a_value_changes_a_recording_and_leaves_the_rest_of_it(right_bag, tmp_path):
    solve(right_bag, "osteoarthritis", output=tmp_path / "first.mcap")
    again = solve(tmp_path / "first.mcap", values={"contact.layer_depth": 0.4e-3})
    assert told(again) == told(
        solve(right_bag, ["osteoarthritis", {"contact.layer_depth": 0.4e-3}])
    )
    healthy = solve(tmp_path / "first.mcap", "healthy")
    assert told(healthy) == told(solve(right_bag))


def test_doubts_are_warnings(right_bag, tmp_path):
    with pytest.raises(UsageError, match="no bag"):
        solve()
    with pytest.raises(UsageError, match=r"its name must end with \.mcap"):
        solve(right_bag, output=tmp_path / "out.csv")
    with pytest.raises(UsageError, match="there is no folder"):
        solve(right_bag, output=tmp_path / "misspelt" / "out.mcap")
    output = tmp_path / "out.mcap"
    solve(right_bag, output=output)
    solve(right_bag, output=output, overwrite=True)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(output.read_bytes()[:50_000])
    with pytest.warns(
        UserWarning, match=r"bag .*cut\.mcap is damaged, and solved as far as it can be read"
    ):
        assert 0 < len(solve(cut, "healthy")) < 387
    with (
        pytest.warns(UserWarning, match=r"^contact.stiffness 2500"),
        pytest.warns(UserWarning, match="^387 of 387 ticks"),
    ):
        solve(right_bag, {"contact.stiffness": 2500.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solve(right_bag)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            {"values": ["contact.damping"]},
            r"values: \['contact.damping'\] is not allowed; a mapping, as {'contact.",
        ),
        ({"remap": "a:=b"}, "remap: 'a:=b' is not allowed; a mapping, as {'joint_states':"),
        ({"remap": {"joint": "/x"}}, r"^remap=\{'joint': '/x'\}: FROM must be joint_states or"),
        ({"params": ""}, "parameters: '' is not allowed; a parameter file's name"),
        ({"params": "osteoarthrits"}, r"\(healthy, .*\); did you mean osteoarthritis\?"),
        (
            {"output": "there.mcap"},
            "there.mcap exists already; choose another name, or overwrite=True$",
        ),
    ],
)
def test_errors_name_arguments_of_python(
    given,
    told,
    right_bag,
    tmp_path,
    monkeypatch,
):
    monkeypatch.chdir(tmp_path)
    Path("there.mcap").touch()
    with pytest.raises(UsageError, match=told):
        solve(right_bag, **given)


def test_a_load_is_what_the_command_estimates(tmp_path):
    bag = walking_bag(tmp_path / "in.mcap", walk())
    each_told = []
    parameters = load_parameters([WHOLE_LEG, {"person.mass": 60.0}], LoadParameters)
    estimate_load(
        bag,
        parameters,
        None,
        keep=lambda answer: each_told.append((answer.sensed.stamp, *answer.estimate)),
    )
    found = knee_contact_ros.estimate_load(
        bag, WHOLE_LEG, {"person.mass": 60.0}, output=tmp_path / "out.mcap"
    )
    assert found.dtype == ESTIMATE
    assert found.tobytes() == np.array(each_told, ESTIMATE).tobytes()
    assert len(solve(tmp_path / "out.mcap")) == len(found)
