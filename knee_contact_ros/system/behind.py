"""Calls a function in a background thread while the caller continues."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any


class Behind:
    """Background thread that makes one call at a time, in order; a context manager that ends with the thread."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "behind")
        self._last: Future[Any] | None = None

    def do(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function in the thread, after waiting for the previous call; an error of that one is raised here."""
        self.wait()
        self._last = self._thread.submit(function, *arguments)

    def wait(self) -> None:
        """Wait for the last call; an error of it is raised here."""
        last, self._last = self._last, None
        if last:
            last.result()

    def __enter__(self) -> Behind:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown()
