"""Ask for which systems and Pythons everything installs from wheels, without a compiler.

    python -m scripts.resolve

It prints the table of docs/how-to/install.md: `uv pip compile --only-binary :all:` looks it up, and installs nothing.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import tomllib

ROOT = Path(__file__).resolve().parents[1]
UV = Path(sys.prefix, "bin", "uv")
PLATFORMS = {
    "Linux x86-64": "x86_64-manylinux_2_28",
    "Linux aarch64": "aarch64-manylinux_2_28",
    "macOS arm64": "aarch64-apple-darwin",
    "macOS x86-64": "x86_64-apple-darwin",
    "Windows x86-64": "x86_64-pc-windows-msvc",
}
"""uv's names of systems"""
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
LEFT_OUT = ("peers", "peers-built")
"""Extras of the project's own benchmarks"""
SOURCES = ("empy",)
"""What has no wheels anywhere and is plain Python; ROS needs it"""


def requirements(project: dict[str, object]) -> dict[str, list[str]]:
    """Return what is asked for by each extra, "" without one, with what the package itself asks for."""
    extras = project["optional-dependencies"]
    plain = list(project["dependencies"])  # type: ignore[call-overload]
    kept = {name: given for name, given in extras.items() if name not in LEFT_OUT}  # type: ignore[attr-defined]
    return {"": plain, **{name: [*plain, *given] for name, given in kept.items()}}


def resolves(wanted: list[str], platform: str, python: str) -> bool:
    """Return whether all of it has wheels for a platform and a Python."""
    command = [UV, "pip", "compile", "--quiet", "--only-binary", ":all:"]
    for name in SOURCES:
        command += ["--no-binary", name]
    command += ["--python-platform", platform, "--python-version", python, "-"]
    done = subprocess.run(
        command, input="\n".join(wanted), capture_output=True, text=True, check=False
    )
    return done.returncode == 0


def without(wanted: dict[str, list[str]], platform: str, python: str) -> list[str]:
    """Return the extras that do not resolve, "" for the package itself; none is looked up alone if all resolve."""
    together = sorted({one for given in wanted.values() for one in given})
    if resolves(together, platform, python):
        return []
    return [name for name, given in wanted.items() if not resolves(given, platform, python)]


def table() -> str:
    """Return the table: what is missing for each platform and Python; those with the same share a column."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = requirements(project)
    columns: dict[tuple[str, ...], list[str]] = {}
    for python in PYTHONS:
        cells = tuple(cell(without(wanted, name, python)) for name in PLATFORMS.values())
        columns.setdefault(cells, []).append(python)
    head = [f"Python {', '.join(pythons)}" for pythons in columns.values()]
    rows = [f"| {' | '.join(row)} |" for row in zip(PLATFORMS, *columns, strict=True)]
    return "\n".join([f"| | {' | '.join(head)} |", f"|---{'|---' * len(head)}|", *rows])


def cell(missing: list[str]) -> str:
    """Return what a cell says of the extras that are missing."""
    if "" in missing:
        return "nothing"
    return f"all but {', '.join(f'`{one}`' for one in missing)}" if missing else "all"


if __name__ == "__main__":
    print(table())
