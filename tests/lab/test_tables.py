"""Tables: whatever a file holds, there are columns or one line that says what is wrong."""

import io
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from knee_contact_ros.lab.headers import TableFormat, each_line, header_of
from knee_contact_ros.lab.tables import (
    TimeColumn,
    read_columns,
    read_storage,
    repaired,
)
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import write_storage
from tests.lab.trials import cells, write_csv

TIME = np.array([0.0, 0.1, 0.2, 0.3])
VALUES = np.array([1.0, -2.0, 3.5, 4.25])
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


def columns_of(path, names, time="time", decimal="auto"):
    """Columns of a text table over time."""
    form = TableFormat(decimal=decimal)
    return read_columns(
        header_of(path, [time, *names], form), names, TimeColumn(column=time), form
    )


def test_of_rows_at_one_time_the_last_counts(tmp_path):
    # RRA's last two rows are 3e-14 s apart, the reactions' ones not at all: one nanosecond holds both.
    time = np.array([0.0, 0.1, 0.1, 0.2, 0.2 + 2.7e-14])
    table = read_storage(write_storage(tmp_path / "q.sto", time, {"a": np.arange(5.0)}))
    assert table.column("a").tolist() == [0.0, 2.0, 4.0]
    assert table.duplicates == 2


@pytest.mark.parametrize("stray", ["time\nheader\n", "time\nendheader\n"])
def test_a_stray_empty_header_is_passed_over_and_repaired(tmp_path, stray):
    path = write_storage(tmp_path / "states.sto", TIME, {"/a/value": VALUES}, "no")
    names_and_rows = path.read_text().split("endheader\n")[1]
    path.write_text(
        f"UNKNOWN\nversion=1\nnRows=0\nnColumns=1\ninDegrees=no\nendheader\n{stray}{names_and_rows}"
    )
    assert read_storage(path).names == ("/a/value",)
    text = repaired(path)
    assert text.count("endheader") == 1
    assert "nRows=4\nnColumns=2\n" in text
    path.write_text(text)
    assert read_storage(path).column("/a/value").tolist() == VALUES.tolist()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("endheader", "", "no line endheader"),
        ("time\t", "t\t", "first column is t, and must be time"),
        ("\ta\tb", "\ta", "has 3 columns, and the names are 2"),
        ("-2.000000000000", "two", r"column a is nan at 0\.1 s"),
        ("-2.000000000000", "1,760", r"column a is nan at 0\.1 s"),
        ("0.100000000000", "0,100", "column time is nan s in row 2; it must be a time"),
        ("time\ta\tb", "time\ta\ta", "has 2 columns a; their names must differ"),
        ("version=1", "version=1\nDataType=Vec3", "holds Vec3"),
        ("0.100000000000", "0.250000000000", "goes back from 0.25 to 0.2 s"),
        ("0.100000000000", "nan", "column time is nan s in row 2"),
        ("version=1", "\0", "is not a text file"),
        (None, "x\nendheader\ntime\ta\n", "no rows"),
        (None, None, "No such file"),
    ],
)
def test_other_files_are_no_storage_files(tmp_path, old, new, says):
    path = write_storage(tmp_path / "bad.sto", TIME, {"a": VALUES, "b": VALUES})
    if new is None:
        path.unlink()
    else:
        path.write_text(path.read_text().replace(old, new, 1) if old else new)
    with pytest.raises(UsageError, match=says) as refused:
        read_storage(path).column("a")
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    ("names", "rows"),
    [
        ("time\ta\tb", "0.0\t1.5\t2\n0.1\t-1250\t3"),
        ("time\tEMG of right vastus\ta", "0.0\t7\t1.5\n0.1\t8\t-1250"),
        ("time\ta\tb", "0,0\t1,5\t2\n0,1\t-1250\t3"),
        ("time\tb\ta", "0,000\t1,500\t1,5\n0,100\t1,500\t-1250"),
        ("time,a,b", "0.0,1.5,2\n0.1,-1250,3"),
        *[
            ("time\tb\ta", f"0.0\t{nan}\t1.5\n0.1\t2\t-1250")
            for nan in (
                "-nan(ind)",
                "1.#QNAN",
                "1.#INF",
                "-1.#IND00",
                "NaN(ind)",
                "no value",
            )
        ],
    ],
)
def test_the_ways_in_which_storage_files_are_written(tmp_path, names, rows):
    """Also what is not a number in a column that is not asked for."""
    path = tmp_path / "q.mot"
    path.write_text(f"Coordinates\nversion=1\ninDegrees=yes\nendheader\n{names}\n{rows}\n")
    table = read_storage(path)
    assert table.column("a").tolist() == [1.5, -1250.0]
    assert table.stamps.tolist() == [0, 100_000_000]


DIGITS = ("0,02;8,856;91,0", "0,04;9,812;1.150", "0,06;11,385;1.281,5", "0,08;12,581;875,25")
"""Rows of a table with decimal commas, and points between thousands"""
SWAP = str.maketrans(",.", ".,")


@pytest.mark.parametrize(
    ("mark", "decimal", "rows"),
    [
        (";", ",", DIGITS),
        ("\t", ".", [row.translate(SWAP).replace(";", "\t") for row in DIGITS]),
        (",", ".", [row.translate(SWAP).replace(";", '","').join('""') for row in DIGITS]),
    ],
)
def test_thousands_marks_are_read_where_the_decimal_mark_is_stated(tmp_path, mark, decimal, rows):
    path = tmp_path / "a.csv"
    path.write_text("\n".join([mark.join(("time", "angle", "load")), *rows]) + "\n")
    table = columns_of(path, ["angle", "load"], decimal=decimal)
    assert table.column("load").tolist() == [91.0, 1150.0, 1281.5, 875.25]
    assert table.column("angle").tolist() == [8.856, 9.812, 11.385, 12.581]


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(
        st.tuples(st.sampled_from(PIECES), st.floats(0.0, 1.0), st.integers(0, 3)),
        min_size=1,
        max_size=4,
    )
)
def test_damage_ends_in_numbers_or_in_one_line(tmp_path, damage):
    path = write_csv(
        tmp_path / "cells.csv", {name: column[:20] for name, column in cells().items()}
    )
    data = path.read_bytes()
    for piece, where, taken in damage:
        at = int(where * len(data))
        data = data[:at] + piece + data[at + taken :]
    path.write_bytes(data)
    told = None
    try:
        table = columns_of(path, ["pm_n", "goniometer_deg"], "time_s")
    except UsageError as error:
        told = str(error)
    if told is None:
        assert table.values.shape == (len(table.stamps), 2)
        assert (np.diff(table.stamps) > 0).all()
    else:
        assert str(path) in told
        assert "\n" not in told


@pytest.mark.parametrize(
    ("rows", "decimal", "says"),
    [
        (
            DIGITS,
            "auto",
            r"line 3, column load: the point of '1\.150' may be a decimal or a thousands mark; say",
        ),
        (
            ["0.02\t8.5\t91", "0.04\t9.5\t1,150"],
            "auto",
            "line 3, column load: the comma of '1,150' may be",
        ),
        (
            ["0;1;91", "1;2;950", "2;3;975", "3;4;1.150", "4;5;1.350", "5;6;1.287"],
            "auto",
            "the point of '1.150'",
        ),
        (
            ["0,02;8;1.15", "0,04;9;91"],
            ",",
            r"'1\.15' is not a number; table\.decimal \(.* says which",
        ),
        (["0.02\t8\t1,5", "0.04\t9\t91"], ".", r"'1,5' is not a number"),
        (
            ['0.02,8,"1,150"', "0.04,9,91"],
            "auto",
            r"'1,150' is not a number; table\.decimal",
        ),
    ],
)
def test_a_cell_with_a_mark_of_two_meanings_is_named(tmp_path, rows, decimal, says):
    path, mark = tmp_path / "a.csv", next(mark for mark in ";\t," if mark in rows[0])
    path.write_text("\n".join([mark.join(("time", "angle", "load")), *rows]) + "\n")
    with pytest.raises(UsageError, match=says):
        columns_of(path, ["load"], decimal=decimal)


@pytest.mark.parametrize("text", ["1_000", "0x10", "1,2,3", "١٢x"])
def test_a_cell_without_a_number_is_named_with_its_line(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_text(f"time;x\n0;1\n1;{text}\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"line 3, column x: .* is not a number"):
        columns_of(path, ["x"])


def test_lines_take_no_more_memory_than_their_text():
    """`io.StringIO` takes four bytes for each character: an hour at 1 kHz took a gigabyte."""
    text = "0.25,1.75\r\n" * 10**6
    tracemalloc.start()
    number = sum(line == "0.25,1.75\n" for line in each_line(text))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert number == 10**6
    assert most < 1.2 * len(text)


@pytest.mark.parametrize(
    "text", ["a\r\nb\rc\n", "", "\ud800\n\x85\u2028\x0b\n", "a\n\r\nb", "ä\r"]
)
def test_lines_end_as_in_any_system(text):
    assert list(each_line(text)) == list(io.StringIO(text, newline=None))
