"""Reading text tables: whatever a file holds, there are columns or one line that says what is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from knee_contact_ros.lab.sensors.channels import TableFormat, TimeColumn
from knee_contact_ros.lab.tables import read_columns
from knee_contact_ros.system.errors import UsageError
from tests.lab.sensors.trials import cells, write_csv

PIECES = [
    b",",
    b";",
    b"\t",
    b"\n",
    b"\r",
    b"\0",
    b'"',
    b"nan",
    b"1e999",
    b"-",
    b"#",
    b"\xff\xfe",
    b"\xe2\x80\xa8",
    b" ",
    b"1,5",
]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(PIECES), st.floats(0.0, 1.0), st.integers(0, 3)), min_size=1, max_size=4))
def test_damage_ends_in_numbers_or_in_one_line(tmp_path: Path, damage: list[tuple[bytes, float, int]]) -> None:
    path = write_csv(tmp_path / "cells.csv", {name: column[:20] for name, column in cells().items()})
    data = path.read_bytes()
    for piece, where, taken in damage:
        at = int(where * len(data))
        data = data[:at] + piece + data[at + taken :]
    path.write_bytes(data)
    told = None
    try:
        table = read_columns(path, ["pm_n", "goniometer_deg"], TimeColumn(column="time_s"), TableFormat())
    except UsageError as error:
        told = str(error)
    if told is None:
        assert table.values.shape == (len(table.stamps), 2)
        assert (np.diff(table.stamps) > 0).all()
    else:
        assert str(path) in told
        assert "\n" not in told


@pytest.mark.parametrize("text", ["1_000", "0x10", "1e5x", "--1", "1.2.3", "1,2,3", "true", "١٢x"])
def test_what_is_no_number_is_told_with_its_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"time;x\n0;1\n1;{text}\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"line 3, column x: .* is no number"):
        read_columns(path, ["x"], TimeColumn(), TableFormat())
