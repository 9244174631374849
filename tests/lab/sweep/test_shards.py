"""The folder of results: files appear whole, and whatever stands in it twice is united without a loss."""

from __future__ import annotations

import errno
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.lab.run_study import Shards, note_of
from knee_contact_ros.system.errors import IncompleteError, UsageError
from tests.lab.sweep.studies import left_over

some = st.lists(st.sampled_from("abcdef"), min_size=1, max_size=4, unique=True)


def of(keys: list[str], **more: Any) -> pa.Table:
    """A table of some cases."""
    return pa.table({"case": keys} | {name: [value] * len(keys) for name, value in more.items()})


@settings(max_examples=60)
@given(shards=st.lists(st.tuples(some, st.booleans()), min_size=1, max_size=8))
def test_united_each_case_stands_once_and_none_is_lost_nor_its_series(shards: list[tuple[list[str], bool]]) -> None:
    with TemporaryDirectory() as folder:
        ours = Shards(folder)
        for keys, series in shards:
            ours.write(of(keys), of(keys * 2) if series else None)
        ours.unite()
        found = [key for name in ours.names() for key in ours._keys(name)]
        assert sorted(found) == sorted({key for keys, _ in shards for key in keys})
        assert set(ours.finished(series=True)) == {key for keys, series in shards if series for key in keys}
        before = ours.names()
        ours.unite()
        assert ours.names() == before


@pytest.mark.parametrize("at", ["open", "mv"])
@pytest.mark.parametrize(("code", "kind"), [(errno.ENOSPC, IncompleteError), (errno.EACCES, UsageError)])
def test_what_cannot_be_written_is_not_there(
    at: str, code: int, kind: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = Shards(str(tmp_path / "out"))

    def fail(*_: Any, **__: Any) -> None:
        raise OSError(code, "it is so")

    with monkeypatch.context() as patch:
        patch.setattr(ours._files, at, fail)
        with pytest.raises(kind, match="it is so"):
            ours.make(*note_of({"bags": []}))
        assert not (tmp_path / "out").exists()
    ours.make(*note_of({"bags": []}))
    monkeypatch.setattr(ours._files, at, fail)
    with pytest.raises(OSError, match="it is so"):
        ours.write(of(["a"]), None)
    assert left_over(tmp_path) == []
    assert ours.names() == []


def test_in_memory_or_elsewhere_it_is_a_folder_as_well() -> None:
    ours = Shards("memory://cohorts/out")
    ours.make(*note_of({}))
    name = ours.write(of(["a"]), of(["a"]))
    assert ours.holds(name, series=True)
    assert set(Shards("memory://cohorts/out").finished(series=True)) == {"a"}
    ours.unite()
    ours.sweep_up(0.0)
    assert ours.names() == [name]


@pytest.mark.parametrize("url", ["nothing://out", "s3://nobody/out"])
def test_an_address_that_means_nothing_is_named(url: str) -> None:
    with pytest.raises(UsageError, match=f"output {url}: "):
        Shards(url).finished(series=False)
