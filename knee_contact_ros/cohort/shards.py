"""The folder of a study's results: a Parquet dataset of files that appear whole, named by what is in them.

A file whose name begins with an underscore is none of the table's to those who read Parquet: so are files that are not
complete, and so is the folder of whole series. The folder may be any that fsspec knows.
"""

from __future__ import annotations

import json
import time
import uuid
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import PurePosixPath
from typing import Any

import fsspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from knee_contact_ros.system.errors import IncompleteError, UsageError

SERIES = "_series"
UNFINISHED = "_unfinished-"
STUDY = "_study.json"
"""What the study asked, the last time"""


class Shards:
    """Files of a study in a folder."""

    def __init__(self, url: str) -> None:
        """A folder; made if it is not there.

        Raises:
            UsageError: it cannot be, or its address means nothing.
        """
        try:
            self._files, self._folder = fsspec.core.url_to_fs(url)
            self._files.makedirs(self._folder, exist_ok=True)
        except (ValueError, ImportError, OSError) as error:
            raise UsageError(f"output {url}: {_reason(error)}") from None
        self.url = url

    def finished(self) -> set[str]:
        """Keys of the cases that are there.

        Raises:
            UsageError: the folder holds something else.
        """
        found = self._table(["case"])
        return set(found["case"].to_pylist()) if found else set()

    def rows(self, keys: Sequence[str], columns: Sequence[str]) -> pa.Table:
        """Columns of the cases with these keys, in their order.

        Raises:
            UsageError: the folder holds something else.
            IncompleteError: a case is not there.
        """
        found = self._table(["case", *columns])
        if found is None:
            raise IncompleteError(f"output {self.url}: no case is there")
        places = pc.index_in(pa.array(keys, pa.string()), found["case"].combine_chunks())
        if places.null_count:
            raise IncompleteError(f"output {self.url}: {places.null_count} of {len(keys)} cases are not there")
        return found.take(places)

    def _table(self, columns: Sequence[str]) -> pa.Table | None:
        """Columns of all cases that are there, if there are any."""
        self._files.invalidate_cache()
        names = [name for name in self._names() if name.endswith(".parquet")]
        try:
            return ds.dataset(names, filesystem=self._files, format="parquet").to_table(columns) if names else None
        except (pa.ArrowException, OSError, KeyError) as error:
            raise UsageError(f"output {self.url}: not the results of a study: {_reason(error)}") from None

    def _names(self) -> list[str]:
        return sorted(
            name
            for name in self._files.ls(self._folder, detail=False)
            if not PurePosixPath(name).name.startswith(("_", "."))
        )

    def refuse_others(self) -> None:
        """Refuse a folder with files of others.

        Raises:
            UsageError: there are some.
        """
        others = [name for name in self._names() if not PurePosixPath(name).name.startswith("cases-")]
        if others:
            raise UsageError(
                f"output {self.url}: holds {PurePosixPath(others[0]).name}, which is none of a study's results"
            )

    def holds(self, name: str) -> bool:
        """Whether a file is there."""
        return bool(self._files.exists(f"{self._folder}/{name}"))

    def write(self, name: str, table: pa.Table, series: pa.Table | None) -> None:
        """Write a file of the table, and before it one of the series, if there are any."""
        if series is not None:
            self._files.makedirs(f"{self._folder}/{SERIES}", exist_ok=True)
            self._put(f"{SERIES}/", name, series)
        self._put("", name, table)

    def _put(self, folder: str, name: str, table: pa.Table) -> None:
        unfinished = f"{self._folder}/{folder}{UNFINISHED}{uuid.uuid4().hex}"
        try:
            with self._files.open(unfinished, "wb") as file:
                pq.write_table(table, file, compression="zstd")
            self._files.mv(unfinished, f"{self._folder}/{folder}{name}")
        except BaseException:
            with suppress(OSError):
                self._files.rm(unfinished)
            raise

    def note(self, content: Mapping[str, Any]) -> None:
        """Write down what the study asks."""
        with self._files.open(f"{self._folder}/{STUDY}", "w") as file:
            json.dump(content, file, indent=1, default=str)

    def sweep_up(self, age: float) -> None:
        """Remove what killed workers have left unfinished, older than an `age` [s]."""
        for folder in (self._folder, f"{self._folder}/{SERIES}"):
            if not self._files.exists(folder):
                continue
            for told in self._files.ls(folder, detail=True):
                left = PurePosixPath(told["name"]).name.startswith(UNFINISHED)
                if left and time.time() - float(told.get("mtime") or time.time()) > age:
                    with suppress(OSError):
                        self._files.rm(told["name"])


def _reason(error: BaseException) -> str:
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
