"""What a run amounts to."""

import numpy as np

from knee_contact_ros.commands.tables import show_summary
from knee_contact_ros.model.types import blank_answers
from knee_contact_ros.offline.summary import Summary


def test_peaks_do_not_depend_on_the_blocks(
    capsys,
):
    rows = blank_answers(40_000)
    rows["stamp"] = np.arange(40_000) * 1_000_000
    rows["load"] = 1200.0 * np.abs(np.sin(np.pi * rows["stamp"] * 1e-9)) + 10.0 * (
        rows["stamp"] > 20e9
    )
    rows["contact_force"], rows["penetration_depth"] = rows["load"] + 1.0, 1e-6 * rows["load"]
    found = []
    for parts in (1, 7, 400):
        summary = Summary(700.0)
        for part in np.array_split(rows, parts):
            summary.add_answers(part)
        summary.complete()
        found.append(summary.load_peaks)
    assert found[0] == found[1] == found[2]
    assert [peak.stamp for peak in found[0]] == [
        500_000_000 + 1_000_000_000 * number for number in range(40)
    ]
    show_summary(summary, {}, {})
    told = capsys.readouterr().out
    assert "mean peak     1205.0   1.72              1206.0   1.72        1.205" in told
    assert "peaks            40 of the load" in told
    assert "peak 1 " not in told


def test_stamps_of_today_leave_the_table_whole(capsys):
    rows, begin = blank_answers(2_000), 1_764_027_108 * 1_000_000_000
    rows["stamp"] = begin + np.arange(2_000) * 1_000_000
    rows["load"] = 1200.0 * np.abs(np.sin(np.pi * 1e-3 * np.arange(2_000)))
    rows["contact_force"], rows["penetration_depth"] = rows["load"], 1e-6 * rows["load"]
    summary = Summary(700.0)
    summary.add_answers(rows)
    summary.complete()
    show_summary(summary, {}, {})
    told = capsys.readouterr().out
    assert " peak 1      1200.0   1.71              1200.0   1.71        1.200   +0.500" in told
    assert " peak 2      1200.0   1.71              1200.0   1.71        1.200   +1.500" in told
    assert "2000 in 2.00 s from 1764027108.000 s on" in told
    assert max(map(len, told.splitlines())) <= 80


def test_largest_values_of_different_moments_have_no_moment(
    capsys,
):
    rows = blank_answers(3)
    rows["stamp"] = [0, 1_000_000_000, 2_000_000_000]
    rows["load"], rows["contact_force"], rows["penetration_depth"] = (
        [1.0, 2.0, 3.0],
        [3.0, 2.0, 1.0],
        [1e-3, 0.0, 0.0],
    )
    summary = Summary(700.0)
    summary.add_answers(rows)
    summary.complete()
    show_summary(summary, {}, {})
    (largest,) = (line for line in capsys.readouterr().out.splitlines() if "largest" in line)
    assert largest.split() == ["largest", "3.0", "0.00", "3.0", "0.00", "1.000"]
