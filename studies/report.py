"""Write a study's page: Markdown, with the machine, and the command that makes it again."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from tabulate import tabulate


class Section(NamedTuple):
    """A table with its heading and an explanatory text."""

    heading: str
    text: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def machine() -> str:
    """Machine, Python and libraries that the figures were measured with."""
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy"))
    return f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}, {libraries}"


def save(path: Path, title: str, command: str, sections: Sequence[Section], measured_on: str) -> None:
    """Write a study's page of sections to a file."""
    parts = [f"# {title}", f"Made by `{command}` on {measured_on}."]
    for section in sections:
        if section.heading:
            parts.append(f"## {section.heading}")
        parts += [section.text, tabulate(section.rows, section.header, tablefmt="pipe", disable_numparse=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
