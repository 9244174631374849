"""Something that is done in a thread of its own while its caller goes on."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any


class Behind:
    """One thing at a time, in the order in which they are given; at the end the thread has ended."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "behind")
        self._last: Future[Any] | None = None

    def do(self, what: Callable[..., object], *arguments: Any) -> None:
        """Have it done; whatever the one before has raised is raised here."""
        self.wait()
        self._last = self._thread.submit(what, *arguments)

    def wait(self) -> None:
        """Until all is done; whatever it has raised is raised here."""
        last, self._last = self._last, None
        if last:
            last.result()

    def __enter__(self) -> Behind:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._thread.shutdown()
