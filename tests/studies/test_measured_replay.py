"""The measured knee through the node: what needs no trials and no node. The rest is the study itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from knee_contact_ros.commands.main import main as knee_contact
from knee_contact_ros.offline.notebooks import solve
from studies.measured_replay import disturbed, main, same
from tests.lab.trials import write_trial


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Of a made-up trial."""
    moved, tray, map_file = write_trial(tmp_path)
    files = [str(moved), str(tray), "--map", str(map_file), "--output"]
    assert knee_contact(["import-csv", *files, str(tmp_path / "bag")]) == 0
    return tmp_path / "bag"


def test_without_the_trials_it_says_so_and_writes_nothing(tmp_path: Path) -> None:
    said = CliRunner().invoke(main, [str(tmp_path), "--output", str(tmp_path / "page.md")])
    assert said.exit_code == 0
    assert "nothing to replay" in said.output
    assert not list(tmp_path.iterdir())


def test_a_worse_sensor_is_worse_as_said(bag: Path, tmp_path: Path) -> None:
    good, bad = solve(bag), solve(disturbed(bag, tmp_path / "bad.mcap", noise=0.5, jitter=2.0))
    assert (len(good), len(bad)) == (720, 719)  # the first angle comes after the first force now
    assert same(good, good) == 720
    assert same(good, bad) < 10
    error = np.degrees(bad["flexion_angle"] - good["flexion_angle"][1:])
    assert 0.3 < np.std(error) < 1.5
    assert np.count_nonzero(bad["status"] & 16) > 0  # what is not a number, or late, is refused
    again = solve(disturbed(bag, tmp_path / "again.mcap", noise=0.5, jitter=2.0))
    assert same(bad, again) == 719  # the same seed
