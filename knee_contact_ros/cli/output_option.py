"""The kinds of options that name an output: what could not be written, or not as meant, is refused before any work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.system.errors import UsageError


class Output(click.Path):
    """A file or folder to write: its folder is there, as a misspelt one is not made, and its name tells what it is."""

    def __init__(self, *suffixes: str, folder: bool = False) -> None:
        super().__init__(path_type=Path, file_okay=not folder)
        self._suffixes = suffixes

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """The path.

        Raises:
            UsageError: its folder is not there, or its name ends otherwise.
        """
        path = Path(str(super().convert(value, param, ctx)))
        label = param.opts[0] if isinstance(param, click.Option) else "output"
        if self._suffixes and path.suffix.lower() not in self._suffixes:
            raise UsageError(f"{label} {path}: its name must end with {' or '.join(self._suffixes)}")
        try:
            there = path.absolute().parent.is_dir()
        except OSError as error:
            raise UsageError(f"{label} {path}: {error.strerror}") from None
        if not there:
            raise UsageError(f"{label} {path}: there is no folder {path.parent}; make it first")
        return path
