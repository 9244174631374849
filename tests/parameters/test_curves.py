"""Files that parameters name: the user's are read to a limit, those that a recording names are never opened."""

from __future__ import annotations

import json
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.bags.provenance import provenance_record, read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.parameters.files import LARGEST, MOST_POINTS, load_parameters
from knee_contact_ros.system.errors import UsageError
from tests.helpers.recordings_of import recording_with

PROFILE, TABLE = (
    {"femur.geometry": "profile", "femur.profile": "{path}"},
    {"translation.mechanism": "table", "translation.table": "{path}"},
)
NAMED = {"femur.profile": PROFILE, "translation.table": TABLE,
         "tibia.profile": {"tibia.geometry": "profile", "tibia.profile": "{path}"}}  # fmt: skip


def naming(values: dict[str, str], path: Path | str) -> dict[str, Any]:
    return {name: value.format(path=path) for name, value in values.items()}


@pytest.mark.parametrize("parameter", NAMED)
def test_what_is_no_file_or_too_large_is_refused_by_the_parameter(parameter: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for no_file in (tmp_path / "pipe", "/dev/zero", tmp_path, "a\0b", "~nobody_of_this_name/x.csv"):
        with pytest.raises(UsageError, match=f"parameter {parameter}: cannot read"):
            knee_contact_ros.load_model(naming(NAMED[parameter], no_file))
    path = tmp_path / "curve.csv"
    path.write_text("".join(f"{number * 1e-6:g},0\n" for number in range(MOST_POINTS + 1)))
    words = f"parameter {parameter}: .* has {MOST_POINTS + 1} points; at most {MOST_POINTS} are allowed"
    with pytest.raises(UsageError, match=words):
        knee_contact_ros.load_model(naming(NAMED[parameter], path))
    path.write_text("#" * (LARGEST + 1))
    with pytest.raises(UsageError, match="longer than"):
        knee_contact_ros.load_model(naming(NAMED[parameter], path))


def test_no_file_is_opened_that_a_recording_names(
    right_bag: Path, config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pipe that is opened would never end. Of view and report: `tests/hostile`."""
    recording, pipe = tmp_path / "theirs.mcap", tmp_path / "pipe"
    os.mkfifo(pipe)
    record = provenance_record(load_parameters({}), {}) | {"parameters": json.dumps(naming(PROFILE, pipe))}
    recording_with(recording, right_bag, [("knee_contact", record)])
    how = ["solve", str(recording), "--output", str(tmp_path / "out.mcap")]
    assert main(how) == 2
    assert capsys.readouterr().err == (
        f"knee-contact: {recording} does not hold the file that its parameter femur.profile names ({pipe}): give your "
        "own with -p femur.profile:=FILE, or all parameters with --params\n"
    )
    assert main([*how, "-p", f"femur.profile:={config / 'femur_medial.csv'}"]) == 0


@pytest.mark.parametrize(
    "parameters", ['"/dev/zero"', '["/dev/zero"]', "[" * 100_000, '{"a": ' * 500 + "1" + "}" * 500]
)
def test_parameters_of_a_recording_are_names_and_values(parameters: str, right_bag: Path, tmp_path: Path) -> None:
    """A text or a list would be names of files."""
    record = provenance_record(load_parameters({}), {}) | {"parameters": parameters}
    recording_with(tmp_path / "theirs.mcap", right_bag, [("knee_contact", record)])
    with pytest.raises(
        UsageError, match="its record knee_contact, which has the parameters, is damaged: give --params"
    ):
        read_provenance(tmp_path / "theirs.mcap")


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ([0.0, 0.4], r"touches the tibia at x = 0 to 346 mm .* \(fit-profile --origin\)\?"),
        ([0.1, 0.0], r"touches the tibia at x = -100 to -50 mm .* \(fit-profile --origin\)\?"),
        ([0.01, 0.01], ""),
    ],
)
def test_a_femur_that_leaves_the_plateau_is_told(origin: list[float], words: str, tmp_path: Path) -> None:
    """The arc's centre lies near the femur's origin, or far from it as of a mesh from a scanner."""
    turn = np.linspace(2.2, -0.3, 60)
    path = tmp_path / "curve.csv"
    arc = -0.03 * np.column_stack([np.sin(turn), np.cos(turn)]) - origin
    path.write_text("".join(f"{x:.6f},{y:.6f}\n" for x, y in arc))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        knee_contact_ros.load_model(naming(PROFILE, path))
    assert [bool(re.search(words, str(each.message))) for each in told] == [True] * bool(words)
