"""Description of the machine on which figures were measured."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def describe(distributions: Iterable[str]) -> str:
    """Describe processor, system, Python, and the versions of those of these distributions that are installed."""
    versions = [f"{name} {installed}" for name in distributions if (installed := installed_version(name))]
    parts = (
        processor(),
        f"{os.cpu_count()} cores",
        platform.system(),
        f"Python {platform.python_version()}",
        *versions,
    )
    return ", ".join(parts)


def business() -> str:
    """Describe the load of the machine in the last minute."""
    return f"load average before the start {os.getloadavg()[0]:.2f}"


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
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    named = {name.strip(): value.strip() for name, value in fields.items()}
    family = f"family {named['cpu family']} model {named['model']}" if "cpu family" in named else ""
    return " ".join(filter(None, (named.get("model name", platform.machine()), family)))
