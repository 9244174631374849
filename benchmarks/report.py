"""Pages of benchmarks and studies: Markdown, with the machine, and the command that makes them again."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple

from tabulate import tabulate


class Section(NamedTuple):
    """A table with its heading and an explanatory text."""

    heading: str
    text: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def installed_version(distribution: str) -> str:
    """Version of a distribution; empty if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def processor() -> str:
    """Name of the processor, or at least its architecture."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = {
        name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)
    }
    family = (
        f"family {named['cpu family']} model {named['model']}" if "cpu family" in named else ""
    )
    return " ".join(filter(None, (named.get("model name", platform.machine()), family)))


def machine(*distributions: str) -> str:
    """Describe processor, system, Python, versions of installed distributions, and time."""
    versions = [
        f"{name} {found}"
        for name in ("numpy", "scipy", *distributions)
        if (found := installed_version(name))
    ]
    system = f"{os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"
    now = datetime.now().astimezone()
    return f"{', '.join([processor(), system, *versions])}; {now:%Y-%m-%d %H:%M}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a table in Markdown."""
    return tabulate(rows, header, tablefmt="pipe", disable_numparse=True)


def words(path: Path) -> dict[str, str]:
    """Texts of a file by the names of its sections (`## name`), to be filled in with `str.format`."""
    _, *parts = re.split(r"^## (\w+)\n", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {name: text.strip() for name, text in zip(parts[::2], parts[1::2], strict=True)}


def save(
    path: Path, title: str, command: str, sections: Sequence[Section], measured_on: str
) -> None:
    """Write a page of sections to a file."""
    parts = [f"# {title}", f"Made by `{command}` on {measured_on}."]
    for section in sections:
        parts += [f"## {section.heading}" if section.heading else "", section.text]
        parts.append(table(section.header, section.rows) if section.header else "")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(part for part in parts if part) + "\n", encoding="utf-8")
