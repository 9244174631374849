"""A file that another thread of this process writes by name, and whose disk may be full."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import IO

BLOCK = 1 << 16
"""[B] that a pipe holds"""


class PipedFile:
    """A file that is written through a pipe, which takes all that comes also when the disk does not.

    Rerun's thread for files ends at an error, and who waits for it then may wait for ever. A pipe gives it no errors.
    """

    def __init__(self, file: IO[bytes]) -> None:
        """Write to `file`, and close it at last."""
        self._file = file
        self._source, self._sink = os.pipe()
        self.name = Path(f"/dev/fd/{self._sink}")
        """What to open for writing, once, before `begin`"""
        self._error: OSError | None = None
        self._thread = Thread(target=self._copy, name="piped file", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """Leave the pipe to who has opened `name`: the file is whole when that is closed."""
        os.close(self._sink)

    def check(self) -> None:
        """Tell what is wrong.

        Raises:
            OSError: something could not be written.
        """
        if self._error:
            raise self._error

    def close(self) -> None:
        """Wait until all that came is written.

        Raises:
            OSError: something was not.
        """
        self._thread.join()
        self.check()

    def _copy(self) -> None:
        """Write what comes until the other end is closed; after an error only take it."""
        with os.fdopen(self._source, "rb", buffering=0) as source:
            while data := source.read(BLOCK):
                if not self._error:
                    self._write(data)
        with self._first_error():  # a disk in the network may tell only now
            self._file.close()

    def _write(self, data: bytes) -> None:
        with self._first_error():
            self._file.write(data)
            self._file.flush()

    @contextmanager
    def _first_error(self) -> Iterator[None]:
        """Keep what goes wrong first."""
        try:
            yield
        except OSError as error:
            error.filename = self._file.name
            self._error = self._error or error
