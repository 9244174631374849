"""OpenSim's storage files: what is read of them, and one line for what cannot be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.tables import read_storage, repaired
from knee_contact_ros.system.errors import UsageError
from tests.lab.opensim.storages import write_storage

TIME = np.array([0.0, 0.1, 0.2, 0.3])
VALUES = np.array([1.0, -2.0, 3.5, 4.25])


def test_a_file_is_read(tmp_path: Path) -> None:
    storage = read_storage(write_storage(tmp_path / "q.sto", TIME, {"a": VALUES, "b": -VALUES}, "yes"))
    assert storage.names == ("a", "b")
    assert storage.stamps.tolist() == [0, 100_000_000, 200_000_000, 300_000_000]
    assert storage.column("b").tolist() == (-VALUES).tolist()
    assert (storage.degrees, storage.duplicates) == (True, 0)


@pytest.mark.parametrize(("header", "degrees"), [("yes", True), ("no", False), (None, None)])
def test_the_header_says_degrees_or_nothing(tmp_path: Path, header: str | None, degrees: bool | None) -> None:
    assert read_storage(write_storage(tmp_path / "q.sto", TIME, {"a": VALUES}, header)).degrees is degrees


def test_of_rows_at_one_time_the_last_counts(tmp_path: Path) -> None:
    # RRA's last two rows are 3e-14 s apart, the reactions' ones not at all: one nanosecond holds both.
    time = np.array([0.0, 0.1, 0.1, 0.2, 0.2 + 2.7e-14])
    storage = read_storage(write_storage(tmp_path / "q.sto", time, {"a": np.arange(5.0)}))
    assert storage.column("a").tolist() == [0.0, 2.0, 4.0]
    assert storage.duplicates == 2


@pytest.mark.parametrize("stray", ["time\nheader\n", "time\nendheader\n"])
def test_a_stray_empty_header_is_passed_over_and_repaired(tmp_path: Path, stray: str) -> None:
    path = write_storage(tmp_path / "states.sto", TIME, {"/a/value": VALUES}, "no")
    whole = path.read_text()
    names_and_rows = whole[whole.index("endheader\n") + len("endheader\n") :]
    path.write_text(f"UNKNOWN\nversion=1\nnRows=0\nnColumns=1\ninDegrees=no\nendheader\n{stray}{names_and_rows}")
    assert read_storage(path).names == ("/a/value",)
    text = repaired(path.read_text(), path)
    assert text.count("endheader") == 1
    assert "nRows=4\nnColumns=2\n" in text
    path.write_text(text)
    assert read_storage(path).column("/a/value").tolist() == VALUES.tolist()


def broken(path: Path, old: str, new: str) -> Path:
    write_storage(path, TIME, {"a": VALUES, "b": VALUES})
    path.write_text(path.read_text().replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("endheader", "", "no line endheader"),
        ("time\t", "t\t", "first column is t, and must be time"),
        ("\ta\tb", "\ta", "2 column names, but 3 columns"),
        ("-2.000000000000", "two", "cannot be read.*two"),
        ("version=1", "version=1\nDataType=Vec3", "holds Vec3"),
        ("0.100000000000", "0.250000000000", "goes back from 0.25 to 0.2 s"),
        ("0.100000000000", "nan", "a time is not a number"),
    ],
)
def test_what_is_no_storage_file_is_refused_in_a_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = broken(tmp_path / "bad.sto", old, new)
    with pytest.raises(UsageError, match=says) as refused:
        read_storage(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_nothing_binary_nothing_missing_nothing_empty(tmp_path: Path) -> None:
    binary = tmp_path / "walk.c3d"
    binary.write_bytes(b"\x02\x50\0\0\0")
    with pytest.raises(UsageError, match="it is not text"):
        read_storage(binary)
    with pytest.raises(UsageError, match="No such file"):
        read_storage(tmp_path / "missing.sto")
    empty = tmp_path / "empty.sto"
    empty.write_text("x\nendheader\ntime\ta\n")
    with pytest.raises(UsageError, match="no rows"):
        read_storage(empty)


def test_a_value_that_is_not_finite_is_named_with_its_time(tmp_path: Path) -> None:
    storage = read_storage(broken(tmp_path / "q.sto", "-2.000000000000", "nan"))
    with pytest.raises(UsageError, match=r"column a is nan at 0\.1 s"):
        storage.column("a")
    assert storage.column("b").tolist() == VALUES.tolist()
