"""A file that a library's thread writes by name, although its disk may become full."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import IO

BLOCK = 1 << 16
"""Bytes that a pipe holds"""


class PipedFile:
    """A file that is written through a pipe, which takes all data even if the disk is full.

    Rerun's thread for files ends at an error, and waiting for it may last for ever then. A pipe gives it no errors.
    """

    def __init__(self, file: IO[bytes]) -> None:
        """Write to `file`, and close it at the end."""
        self._file = file
        self._source, self._sink = os.pipe()
        self.name = Path(f"/dev/fd/{self._sink}")
        """Name to open for writing, once, before `begin`"""
        self._error: OSError | None = None
        self._thread = Thread(target=self._copy, name="piped file", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Leave the pipe to the writer that has opened `name`: the file is complete when the writer closes it."""
        os.close(self._sink)

    def check(self) -> None:
        """Raise the first error of writing, if there was one.

        Raises:
            OSError: data could not be written.
        """
        if self._error:
            raise self._error

    def close(self) -> None:
        """Wait until all data is written.

        Raises:
            OSError: data could not be written.
        """
        self._thread.join()
        self.check()

    def _copy(self) -> None:
        """Write all data until the writer closes the pipe; after an error, discard it."""
        with os.fdopen(self._source, "rb", buffering=0) as source:
            while data := source.read(BLOCK):
                if not self._error:
                    self._write(data)
        with self._first_error():  # a network disk may report an error only now
            self._file.close()

    def _write(self, data: bytes) -> None:
        """Write data to the file at once."""
        with self._first_error():
            self._file.write(data)
            self._file.flush()

    @contextmanager
    def _first_error(self) -> Iterator[None]:
        """Keep the first error of writing, with the name of the file."""
        try:
            yield
        except OSError as error:
            error.filename = self._file.name
            self._error = self._error or error
