"""The output folder of a study: a Parquet dataset of files (shards), on this machine or where fsspec reaches.

A shard is named by its cases and appears when it is complete. Names of incomplete files, and of the folder of all
answers, begin with an underscore, which readers of datasets skip.
"""

import errno
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import PurePosixPath
from typing import Any

from ..system.errors import CommandError, IncompleteError, UsageError
from ..system.files import expand_user

SERIES_FOLDER = "_series"
"""Folder of all answers, in a study's folder"""
UNFINISHED = "_unfinished"
"""File that is being written, in a study's folder"""
FULL_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors of writing that are not the user's fault"""


def is_address(place: str) -> bool:
    """Whether a place is an address for fsspec (`s3://...`, `zip://gait.mcap::https://...`), and not a path."""
    return bool(re.search("://|::", place))


def brief_reason(error: BaseException) -> str:
    """Describe an error in a few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


class ShardFolder:
    """Reads and writes the shards in a study's output folder, which need not exist yet."""

    def __init__(self, url: str) -> None:
        """Take a folder.

        Raises:
            UsageError: the address cannot be used.
        """
        import fsspec

        self.url = url
        with self._errors():
            place = url if is_address(url) else str(expand_user(url).absolute())
            self._files, self._folder = fsspec.core.url_to_fs(place, use_listings_cache=False)
            if self._files.isfile(self._folder):
                raise UsageError(f"output {url}: is a file; a folder is needed")

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn errors in reading or writing the folder into one line that names it."""
        try:
            yield
        except CommandError:
            raise
        except Exception as error:  # a boundary: each kind of store has errors of its own
            full = isinstance(error, OSError) and error.errno in FULL_DISK
            kind = IncompleteError if full else UsageError
            raise kind(f"output {self.url}: {brief_reason(error)}") from None

    def shard_names(self, folder: str = "") -> list[str]:
        """Return the names of the shards in the folder of results, or in a folder inside it.

        Raises:
            UsageError: the folder contains something else.
        """
        with self._errors():
            try:
                found = self._files.ls(f"{self._folder}/{folder}".rstrip("/"), detail=False)
            except FileNotFoundError:
                return []
        entries = [PurePosixPath(name.rstrip("/")).name for name in found]
        names = sorted(name for name in entries if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(
                    f"output {self.url}: holds {name}, which is not a result of a study"
                )
        return names

    def read_columns(self, *columns: str) -> Any:
        """Read columns of all finished cases into a data frame, by their keys.

        Raises:
            UsageError: the folder contains something else, or a shard is damaged.
        """
        import pandas as pd
        import pyarrow as pa
        import pyarrow.parquet as pq

        parts = [pd.DataFrame({"case": []})]
        for name in self.shard_names():
            try:
                # From bytes: Arrow's threads would release a Python file after Python's end, and abort.
                content = pa.BufferReader(self._files.cat_file(f"{self._folder}/{name}"))
                # The whole table: its checksums find damage anywhere.
                whole = pq.read_table(content, page_checksum_verification=True)
                parts.append(whole.select(["case", *columns]).to_pandas())
            except Exception as error:  # a boundary: damaged files raise what they like
                why = brief_reason(error).splitlines()[0]
                raise UsageError(
                    f"output {self.url}: {name} is damaged, or is not a result of a study ({why}): move it away, and "
                    "its cases are computed again"
                ) from None
        return pd.concat(parts[1:] or parts).drop_duplicates("case").set_index("case")

    def write_file(self, name: str, content: bytes) -> None:
        """Write a file; it gets its name when it is complete.

        Raises:
            UsageError: the folder cannot be written.
            IncompleteError: the disk is full.
        """
        unfinished = f"{self._folder}/{UNFINISHED}"
        with self._errors():
            try:
                self._files.makedirs(f"{self._folder}/{name}".rpartition("/")[0], exist_ok=True)
                self._files.pipe_file(unfinished, content)
                self._files.mv(unfinished, f"{self._folder}/{name}")
            except BaseException:
                with suppress(Exception):
                    self._files.rm(unfinished)
                raise

    def remove_file(self, name: str) -> None:
        """Remove a file."""
        with self._errors():
            self._files.rm_file(f"{self._folder}/{name}")

    def matching(self, pattern: str) -> list[str]:
        """Return the names of the files in the folder that match a pattern, such as `*.png`."""
        with self._errors():
            found = self._files.glob(f"{self._folder}/{pattern}")
        return [PurePosixPath(path).name for path in found]
