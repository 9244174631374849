"""The kinds of options that name an output: what could not be written, or not as meant, is refused before any work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from knee_contact_ros.system.output_files import checked_output


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
        label = param.opts[0] if isinstance(param, click.Option) else "output"
        return checked_output(Path(str(super().convert(value, param, ctx))), label, *self._suffixes)
