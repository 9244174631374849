"""The folder of a study's results: a Parquet dataset of files (shards) that appear whole, named by their content.

Readers of Parquet datasets pass over names that begin with an underscore: so do incomplete files begin, and the folder
of all answers. The folder may lie wherever fsspec can write.
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
"""Key in the metadata of a shard for the name of the run that has written it"""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors that are no fault of the user's"""


def note_of(content: Mapping[str, Any]) -> tuple[str, str]:
    """Give the name and the text of the note: a copy of the study's content in the folder of its results."""
    text = json.dumps(content, indent=1, default=str)
    return f"{STUDY}{hashlib.sha256(text.encode()).hexdigest()[:16]}.json", text


class Shards:
    """Reads and writes the shards in the folder of a study's results."""

    def __init__(self, url: str, run: str = "") -> None:
        """Take a folder, which need not exist yet.

        Args:
            url: Path or address of the folder.
            run: Name of this run, which is in the names of its unfinished files and in the metadata of its shards.

        Raises:
            UsageError: the address cannot be used.
        """
        try:
            self._files, self._folder = fsspec.core.url_to_fs(url, use_listings_cache=False)
        except Exception as error:  # a boundary: each kind of store has errors of its own
            raise UsageError(f"output {url}: {reason(error)}") from None
        self.url, self._run = url, run

    def make(self, note: str, text: str) -> None:
        """Make the folder, if it does not exist, and write the note (`note_of`) into it.

        Raises:
            UsageError: the folder cannot be made or written.
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
            raise self.error_of(error) from None

    def error_of(self, error: BaseException) -> ToldError:
        """Give the error to raise for one that came with reading or writing the folder."""
        full = isinstance(error, OSError) and error.errno in FULL
        return (IncompleteError if full else UsageError)(f"output {self.url}: {reason(error)}")

    def finished(self, *, series: bool) -> set[str]:
        """Give the keys of all finished cases; with `series`, only of those whose answers are kept, too.

        Raises:
            UsageError: the folder holds something else, or a shard is damaged.
        """
        try:
            names = self.names()
            whole = self.names(SERIES) if series else names
        except ToldError:
            raise
        except Exception as error:  # a boundary, likewise
            raise self.error_of(error) from None
        return {key for name in names if name in whole for key in self._keys(name)}

    def rows(self, keys: Sequence[str], columns: Sequence[str]) -> pa.Table:
        """Read columns of the cases with these keys, in the order of the keys.

        Raises:
            UsageError: the folder holds something else.
            IncompleteError: a case is missing.
        """
        parts = [self._read(name, ["case", *columns]) for name in self.names()]
        table = (
            pa.concat_tables([part for part in parts if part]) if any(parts) else pa.table({"case": pa.array([], "")})
        )
        places = pc.index_in(pa.array(keys, pa.string()), table["case"].combine_chunks())
        if places.null_count:
            raise IncompleteError(f"output {self.url}: {places.null_count} of {len(keys)} cases are not there")
        return table.take(places)

    def names(self, folder: str = "") -> list[str]:
        """Names of the shards in the folder of results, or in a folder inside it.

        Raises:
            UsageError: the folder holds something else.
        """
        place = f"{self._folder}/{folder}".rstrip("/")
        if not self._files.exists(place):
            return []
        if not self._files.isdir(place):
            raise UsageError(f"output {self.url}: it is no folder")
        entries = (PurePosixPath(name.rstrip("/")).name for name in self._files.ls(place, detail=False))
        names = sorted(name for name in entries if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(f"output {self.url}: holds {name}, which is none of a study's results")
        return names

    def _keys(self, name: str) -> list[str]:
        """Keys of the cases in a shard."""
        table = self._read(name, ["case"])
        keys: list[str] = table["case"].to_pylist() if table else []
        return keys

    def _read(self, name: str, columns: Sequence[str]) -> pa.Table | None:
        """Read columns of a shard; None if another client has just removed it.

        Raises:
            UsageError: it is damaged, or no shard.
        """
        try:
            return self._whole(name, columns)
        except FileNotFoundError:
            return None
        except Exception as error:  # a boundary: damaged files raise what they like
            why = reason(error).splitlines()[0]
            raise UsageError(
                f"output {self.url}: {name} is damaged, or none of a study's results ({why}): move it away, and its "
                "cases are computed again"
            ) from None

    def _whole(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a shard from its bytes: Arrow's threads would release a Python file after Python's end, and abort."""
        content = self._files.cat_file(f"{self._folder}/{name}")
        return pq.read_table(pa.BufferReader(content), columns=list(columns) if columns else None)

    def holds(self, name: str, *, series: bool) -> bool:
        """Whether a shard exists, and with `series` also the one with all answers."""
        folders = ("", f"{SERIES}/") if series else ("",)
        return all(self._files.exists(f"{self._folder}/{folder}{name}") for folder in folders)

    def has_note(self, note: str) -> bool:
        """Whether the folder has the note that `make` writes."""
        return bool(self._files.exists(f"{self._folder}/{note}"))

    def by_whom(self, name: str) -> tuple[bool, int]:
        """Give whether this run has written a shard, and how many of its cases failed."""
        table = self._whole(name, ["failed"])
        ours = (table.schema.metadata or {}).get(RUN) == self._run.encode()
        return ours, sum(map(bool, table["failed"].to_pylist()))

    def write(self, table: pa.Table, series: pa.Table | None) -> str:
        """Write a shard of the table, after one with all answers if there is a `series`; return the name of both.

        Raises:
            OSError: they cannot be written; a shard that could not be completed does not appear.
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
        """Open a file that gets its name when it is complete, and on the disk."""
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
        """Remove cases that are in several shards from all but one: clients that share the folder write such ones."""
        with self._locked() as locked:
            places: dict[str, str] = {}
            whole = set(self.names(SERIES))
            for name in sorted(self.names(), key=lambda name: (name not in whole, name)) if locked else []:
                keys = self._keys(name)
                own = [key for key in keys if places.get(key, name) == name]
                kept = name if len(own) == len(keys) else self._keep(name, own, series=name in whole)
                places |= dict.fromkeys(own, kept)

    def _keep(self, name: str, keys: list[str], *, series: bool) -> str:
        """Replace a shard by one with some of its cases, and return the new name."""
        table, answers = self._only("", name, keys), self._only(f"{SERIES}/", name, keys) if series else None
        kept = self.write(table, answers) if keys else ""
        self._files.rm(f"{self._folder}/{name}")
        if series:
            self._files.rm(f"{self._folder}/{SERIES}/{name}")
        return kept

    def _only(self, folder: str, name: str, keys: list[str]) -> pa.Table:
        table = self._whole(f"{folder}{name}")
        return table.filter(pc.is_in(table["case"], value_set=pa.array(keys, pa.string())))

    @contextmanager
    def _locked(self) -> Iterator[bool]:
        """Keep other clients from uniting the folder for the time of the context; False if it cannot be locked."""
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
        """Remove the unfinished files of this run, and those of other runs that are older than an `age` [s]."""
        for folder in (self._folder, f"{self._folder}/{SERIES}"):
            with suppress(Exception):
                for entry in self._files.ls(folder, detail=True) if self._files.exists(folder) else []:
                    name = PurePosixPath(entry["name"]).name
                    old = time.time() - float(entry.get("mtime") or time.time()) > age
                    if name.startswith(f"{UNFINISHED}{self._run}-") or (name.startswith(UNFINISHED) and old):
                        self._files.rm(entry["name"])
