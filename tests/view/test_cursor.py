"""The moment that a viewer shows first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.messages.answer import Answer
from knee_contact_ros.results.columns import DATES_FROM
from knee_contact_ros.view.cursor import peak_of
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.plots import FORCES, KNEE, LOAD_PLACE
from tests.helpers.answers import rows_of
from tests.view.scenes import at, written

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


def test_the_largest_load_is_found_in_a_file(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    whole = rows_of(answers)
    assert KNEE[1].path == FORCES
    assert KNEE[1].series[LOAD_PLACE].name == "load [BW]"
    parts = [whole[:200], whole[200:]]
    assert peak_of(written(tmp_path / "knee.rrd", drawing, parts)) == (2_430_000_000, False)
    today = at(whole, DATES_FROM * 5 + whole["stamp"])
    assert peak_of(written(tmp_path / "today.rrd", drawing, [today])) == (DATES_FROM * 5 + 2_430_000_000, True)


def test_of_the_same_load_the_largest_force_is_found_and_nothing_counts_as_more(
    knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path
) -> None:
    drawing, answers = knee
    level = rows_of(answers).copy()
    level["load"] = 350.0  # as where the height drives
    assert peak_of(written(tmp_path / "level.rrd", drawing, [level])) == (
        int(level["stamp"][level["contact_force"].argmax()]),
        False,
    )
    missing = rows_of(answers).copy()
    missing["load"][:100] = np.nan
    assert peak_of(written(tmp_path / "missing.rrd", drawing, [missing])) == (2_430_000_000, False)
