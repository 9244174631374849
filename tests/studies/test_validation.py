"""docs/validation.md says what the code gives, where the measurements are; and the command without them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests import ROOT

pytest.importorskip("tabulate", reason="the studies' tables")

from benchmarks.report import save
from studies.validation.__main__ import main
from studies.validation.data import Measured, is_there, read
from studies.validation.sections import COMMAND, TITLE, errors_of, found_in, left_out, peaks, sections

PAGE = ROOT / "docs" / "validation.md"


@pytest.fixture(scope="module")
def trials(reference_data: Path) -> list[Measured]:
    folder = reference_data / "instrumented_knee"
    if not is_there(folder):
        pytest.skip("the measurements of the instrumented knee are not on this machine")
    return read(folder)


def test_without_the_measurements_nothing_is_made(tmp_path: Path) -> None:
    for arguments in ([], ["--data", str(tmp_path)]):
        result = CliRunner(env={"INSTRUMENTED_KNEE": ""}).invoke(main, [*arguments, "--folder", str(tmp_path)])
        assert result.exit_code == 0
        assert "nothing is made" in result.output
    assert not list(tmp_path.iterdir())


def test_the_page_is_what_the_code_gives(trials: list[Measured], tmp_path: Path) -> None:
    first = PAGE.read_text(encoding="utf-8").splitlines()[2]
    save(tmp_path / "page.md", TITLE, COMMAND, sections(trials), first.split(" on ", 1)[1].rstrip("."))
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == PAGE.read_text(encoding="utf-8")


def test_a_table_of_the_other_trial_keeps_what_was_asked(trials: list[Measured]) -> None:
    assert max(left_out(trials)) <= 90.0 / 654.3


def test_events_are_near_those_of_the_plates(trials: list[Measured]) -> None:
    treadmill = trials[1]
    for found, plate in zip(found_in(treadmill).values(), treadmill.contacts(), strict=True):
        seen = [time for time in plate if time < treadmill.time[-1]]
        errors = errors_of(found, seen)
        assert len(errors) == len(seen)
        assert max(map(abs, errors)) < 0.04


def test_peaks_of_a_stance_by_hand() -> None:
    time = np.arange(100) * 0.01
    medial = np.where(time < 0.5, 100.0 - 400.0 * np.abs(time - 0.3), 80.0 - 400.0 * np.abs(time - 0.7))
    plate = np.where((time > 0.105) & (time < 0.895), 700.0, 0.0)
    none = np.zeros(100)
    knee = Measured("made up", time, none, 2.0 * medial, medial, none, none, time, plate)
    moved = 5.0 + np.roll(medial, 3)
    found = peaks(knee, moved)
    assert [round(each.error, 6) for each in found] == [5.0, 5.0]
    assert [round(each.late, 6) for each in found] == [0.03, 0.03]
    assert [len(times) for times in knee.contacts()] == [1, 1]
