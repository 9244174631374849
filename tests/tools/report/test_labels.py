"""How runs of a report are named: of what is gathered, without pictures."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from knee_contact_ros.commands.main import main
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.tools.report.data import tables
from knee_contact_ros.tools.report.runs import ReportOptions, Run, collect
from tests.offline.test_solve import silent


def gathered(files: Sequence[Path], folder: Path, *compare: Path) -> list[Run]:
    """The runs of a report, without its pictures."""
    (folder / "work").mkdir()
    options = ReportOptions(files, [], [share_folder() / "config" / "healthy.yaml"], False, compare)
    return collect(options, folder / "work", lambda _what: silent)


def test_files_of_one_name_are_told_apart(bags: tuple[Path, Path], tmp_path: Path) -> None:
    runs = gathered([bags[0], bags[0]], tmp_path)
    assert [run.label for run in runs] == ["gait2354_right (1)", "gait2354_right (2)"]
    assert {row["run"] for row in csv.DictReader(io.StringIO(tables(runs)["peaks.csv"]))} == {
        "gait2354_right (1)",
        "gait2354_right (2)",
    }


def test_files_of_one_name_are_told_apart_also_when_their_laws_differ(
    bags: tuple[Path, Path], config: Path, tmp_path: Path
) -> None:
    recordings = [tmp_path / folder / "knee.mcap" for folder in ("first", "second")]
    for recording, file in zip(recordings, ("healthy", "osteoarthritis"), strict=True):
        recording.parent.mkdir()
        assert main(["solve", str(bags[0]), "--params", file, "--output", str(recording)]) == 0
    runs = gathered(recordings, tmp_path, config / "osteoarthritis.yaml")
    assert [run.label.split(",")[0] for run in runs] == ["knee (1)", "knee (1)", "knee (2)", "knee (2)"]
    assert len({run.label for run in runs}) == 4
