"""What the figures were measured on."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


def describe(distributions: Iterable[str]) -> str:
    """Processor, system, Python, and the versions of these distributions where they are installed."""
    versions = [f"{name} {found}" for name in distributions if (found := installed_version(name))]
    parts = (
        processor(),
        f"{os.cpu_count()} cores",
        platform.system(),
        f"Python {platform.python_version()}",
        *versions,
    )
    return ", ".join(parts)


def business() -> str:
    """How busy the machine has been in the last minute, where the system tells."""
    if not hasattr(os, "getloadavg"):
        return "load average unknown"
    return f"load average before the start {os.getloadavg()[0]:.2f}"


def installed_version(distribution: str) -> str:
    """The version of a distribution; empty if it is not installed."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def processor() -> str:
    """The processor's name, or at least its kind."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    fields = dict(line.split(":", 1) for line in lines if ":" in line)
    named = {name.strip(): value.strip() for name, value in fields.items()}
    family = f"family {named['cpu family']} model {named['model']}" if "cpu family" in named else ""
    return " ".join(filter(None, (named.get("model name", platform.machine()), family)))
