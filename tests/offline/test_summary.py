"""What a run amounts to."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.core.types import blank
from knee_contact_ros.offline.summary import Summary, bound, read_summary
from knee_contact_ros.offline.summary_table import show_summary


@pytest.mark.parametrize("errors", [[0.0, 3e-6, 1e-6], [0.0, math.nan, 1e-6], [math.inf, 0.0, math.nan]])
@pytest.mark.parametrize("at_once", [True, False])
def test_an_error_that_is_not_a_number_bounds_nothing(errors: list[float], at_once: bool) -> None:
    rows, summary = blank(3), Summary(700.0)
    rows["error_estimate"], rows["force_error_estimate"] = errors, errors[::-1]
    for part in [rows] if at_once else np.split(rows, 3):
        summary.add(part)
    expected = max(errors) if all(map(math.isfinite, errors)) else math.inf
    assert (summary.largest_error, summary.largest_force_error) == (expected, expected)
    assert bound(np.array(errors)) == expected


def test_a_recording_from_before_the_force_error(old_recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = read_summary(old_recording, 737.068)
    assert (summary.ticks, summary.flagged) == (387, {})
    assert summary.largest_error < 1e-6
    assert [round(peak.contact_force / 737.068, 2) for peak in summary.load_peaks] == [1.72, 2.11, 1.82, 2.19]
    show_summary(summary, {}, {})
    assert "um of depth at most, no bound of force" in capsys.readouterr().out
