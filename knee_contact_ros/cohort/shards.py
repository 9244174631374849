"""The folder of a study's results: a Parquet dataset of files that appear whole, named by what is in them.

A file whose name begins with an underscore is none of the table's to those who read Parquet: so are files that are not
complete, and so is the folder of whole series. The folder may be any that fsspec knows.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from fsspec.implementations.local import LocalFileSystem

from knee_contact_ros.cohort.keys import shard_name
from knee_contact_ros.cohort.places import reason
from knee_contact_ros.system.errors import IncompleteError, ToldError, UsageError

SERIES = "_series"
UNFINISHED = "_unfinished-"
STUDY = "_study-"
LOCK = "_lock"
RUN = b"knee_contact_run"
"""In the metadata of a file: which run has written it"""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""What is no fault of the user's"""


def note_of(content: Mapping[str, Any]) -> tuple[str, str]:
    """Name and text of the file that says what a study asks."""
    text = json.dumps(content, indent=1, default=str)
    return f"{STUDY}{hashlib.sha256(text.encode()).hexdigest()[:16]}.json", text


class Shards:
    """Files of a study in a folder."""

    def __init__(self, url: str, run: str = "") -> None:
        """A folder, which need not be there; `run` is in the names of what this run has not finished.

        Raises:
            UsageError: its address means nothing.
        """
        try:
            self._files, self._folder = fsspec.core.url_to_fs(url, use_listings_cache=False)
        except Exception as error:  # a boundary: each kind of store has errors of its own
            raise UsageError(f"output {url}: {reason(error)}") from None
        self.url, self._run = url, run

    def make(self, note: str, text: str) -> None:
        """Make the folder, if it is not there, and write down what the study asks.

        Raises:
            UsageError: it cannot be made or written.
            IncompleteError: the disk is full.
        """
        new = not self._files.exists(self._folder)
        try:
            self._files.makedirs(self._folder, exist_ok=True)
            with self._appearing("", note) as file:
                file.write(text.encode())
        except Exception as error:  # a boundary, likewise
            with suppress(Exception):
                if new:
                    self._files.rmdir(self._folder)
            raise self.told(error) from None

    def told(self, error: BaseException) -> ToldError:
        """What is to be said of an error of the folder's."""
        full = isinstance(error, OSError) and error.errno in FULL
        return (IncompleteError if full else UsageError)(f"output {self.url}: {reason(error)}")

    def finished(self, *, series: bool) -> dict[str, str]:
        """The file of each case that is there, with its `series` if these are wanted.

        Raises:
            UsageError: the folder holds something else, or a file is damaged.
        """
        try:
            names = self.names()
            whole = self.names(SERIES) if series else names
        except ToldError:
            raise
        except Exception as error:  # a boundary, likewise
            raise self.told(error) from None
        return {key: name for name in names if name in whole for key in self._keys(name)}

    def rows(self, keys: Sequence[str], columns: Sequence[str]) -> pa.Table:
        """Columns of the cases with these keys, in their order.

        Raises:
            UsageError: the folder holds something else.
            IncompleteError: a case is not there.
        """
        parts = [self._read(name, ["case", *columns]) for name in self.names()]
        found = (
            pa.concat_tables([part for part in parts if part]) if any(parts) else pa.table({"case": pa.array([], "")})
        )
        places = pc.index_in(pa.array(keys, pa.string()), found["case"].combine_chunks())
        if places.null_count:
            raise IncompleteError(f"output {self.url}: {places.null_count} of {len(keys)} cases are not there")
        return found.take(places)

    def names(self, folder: str = "") -> list[str]:
        """Of its shards; or of those of series.

        Raises:
            UsageError: there is something else.
        """
        place = f"{self._folder}/{folder}".rstrip("/")
        if not self._files.exists(place):
            return []
        if not self._files.isdir(place):
            raise UsageError(f"output {self.url}: it is no folder")
        found = (PurePosixPath(name.rstrip("/")).name for name in self._files.ls(place, detail=False))
        names = sorted(name for name in found if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(f"output {self.url}: holds {name}, which is none of a study's results")
        return names

    def _keys(self, name: str) -> list[str]:
        """Of the cases in a shard."""
        table = self._read(name, ["case"])
        keys: list[str] = table["case"].to_pylist() if table else []
        return keys

    def _read(self, name: str, columns: Sequence[str]) -> pa.Table | None:
        """Columns of a shard; None if another client has just put it in order.

        Raises:
            UsageError: it is none.
        """
        try:
            return self._whole(name, columns)
        except FileNotFoundError:
            return None
        except Exception as error:  # a boundary: damaged files raise what they like
            said = reason(error).splitlines()[0]
            raise UsageError(
                f"output {self.url}: {name} is damaged, or none of a study's results ({said}): move it away, and its "
                "cases are computed again"
            ) from None

    def _whole(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """A file's table, from its bytes.

        Arrow's own threads would let go of a Python file after Python has ended, which aborts the process.
        """
        content = self._files.cat_file(f"{self._folder}/{name}")
        return pq.read_table(pa.BufferReader(content), columns=list(columns) if columns else None)

    def holds(self, name: str, *, series: bool) -> bool:
        """Whether a file is there, or, with `series`, both."""
        folders = ("", f"{SERIES}/") if series else ("",)
        return all(self._files.exists(f"{self._folder}/{folder}{name}") for folder in folders)

    def knows(self, note: str) -> bool:
        """Whether a file of `make` is there."""
        return bool(self._files.exists(f"{self._folder}/{note}"))

    def by_whom(self, name: str) -> tuple[bool, int]:
        """Whether this run has written a file, and how many of its cases failed."""
        table = self._whole(name, ["failed"])
        ours = (table.schema.metadata or {}).get(RUN) == self._run.encode()
        return ours, sum(bool(reason) for reason in table["failed"].to_pylist())

    def write(self, table: pa.Table, series: pa.Table | None) -> str:
        """Write a file of the table, and before it one of the series, if there are any; their name.

        Raises:
            OSError: it cannot be written; nothing of it is there then.
        """
        name = shard_name(table["case"].to_pylist())
        if series is not None:
            self._files.makedirs(f"{self._folder}/{SERIES}", exist_ok=True)
            with self._appearing(f"{SERIES}/", name) as file:
                pq.write_table(series, file, compression="zstd")
        table = table.replace_schema_metadata({RUN: self._run})
        with self._appearing("", name) as file:
            pq.write_table(table, file, compression="zstd")
        return name

    @contextmanager
    def _appearing(self, folder: str, name: str) -> Iterator[Any]:
        """A file that gets its name when it is complete, and on the disk."""
        unfinished = f"{self._folder}/{folder}{UNFINISHED}{self._run}-{uuid.uuid4().hex}"
        try:
            with self._files.open(unfinished, "wb") as file:
                yield file
                if isinstance(self._files, LocalFileSystem):
                    file.flush()
                    os.fsync(file.fileno())
            self._files.mv(unfinished, f"{self._folder}/{folder}{name}")
        except BaseException:
            with suppress(Exception):
                self._files.rm(unfinished)
            raise

    def unite(self) -> None:
        """Let each case stand in one file alone: those who shared the folder may have computed some twice."""
        with self._alone() as may:
            places: dict[str, str] = {}
            whole = set(self.names(SERIES))
            for name in sorted(self.names(), key=lambda name: (name not in whole, name)) if may else []:
                keys = self._keys(name)
                own = [key for key in keys if places.get(key, name) == name]
                kept = name if len(own) == len(keys) else self._keep(name, own, series=name in whole)
                places |= dict.fromkeys(own, kept)

    def _keep(self, name: str, keys: list[str], *, series: bool) -> str:
        """Keep some cases of a shard, and no others; the name of the file that they are in."""
        table, of_ticks = self._only("", name, keys), self._only(f"{SERIES}/", name, keys) if series else None
        kept = self.write(table, of_ticks) if keys else ""
        self._files.rm(f"{self._folder}/{name}")
        if series:
            self._files.rm(f"{self._folder}/{SERIES}/{name}")
        return kept

    def _only(self, folder: str, name: str, keys: list[str]) -> pa.Table:
        table = self._whole(f"{folder}{name}")
        return table.filter(pc.is_in(table["case"], value_set=pa.array(keys, pa.string())))

    @contextmanager
    def _alone(self) -> Iterator[bool]:
        """As long as this lasts, no other client puts the folder in order; False: there is no telling."""
        if not isinstance(self._files, LocalFileSystem):
            yield False
            return
        with ExitStack() as opened:
            try:
                file = opened.enter_context(Path(self._folder, LOCK).open("w"))
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:  # read only, or a file system without locks
                yield False
                return
            yield True

    def sweep_up(self, age: float) -> None:
        """Remove what this run has left unfinished, and what others have, older than an `age` [s]."""
        for folder in (self._folder, f"{self._folder}/{SERIES}"):
            with suppress(Exception):
                for told in self._files.ls(folder, detail=True) if self._files.exists(folder) else []:
                    name = PurePosixPath(told["name"]).name
                    old = time.time() - float(told.get("mtime") or time.time()) > age
                    if name.startswith(f"{UNFINISHED}{self._run}-") or (name.startswith(UNFINISHED) and old):
                        self._files.rm(told["name"])
