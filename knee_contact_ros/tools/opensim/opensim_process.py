"""Run a step of OpenSim in a process of its own, follow its progress by its log, and end it when we end."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.extras import require
from knee_contact_ros.system.processes import kept, python_module
from knee_contact_ros.system.terminal import Bar
from knee_contact_ros.tools.opensim import opensim_step
from knee_contact_ros.tools.opensim.opensim_setups import TOOLS, Setup

EXTRA = "opensim"
PERIOD = 0.2
"""Period of the checks on a running step [s]"""
PATIENCE = 5.0
"""Time that a step has to end [s]"""
TAIL = 4096
"""Number of bytes at the end of a log in which its last time is looked for"""
TIMES = re.compile(rb"\bt(?:ime)? = ([0-9.eE+-]+)")
MESHES = re.compile(r"mesh|\.vtp|\.stl|\.obj", re.IGNORECASE)
FAILED = re.compile(r"error|exception|fail|unable|not found", re.IGNORECASE)


def check_opensim() -> None:
    """Check that OpenSim is installed.

    Raises:
        UsageError: it is not installed.
    """
    require(EXTRA, "opensim")


def run_step(setup: Setup, work: Path, bar: Bar) -> None:
    """Run the tool of a set-up file in that file's folder, with its output in `work`/logs.

    Raises:
        UsageError: it has failed.
    """
    log = work / "logs" / f"{setup.step}.log"
    window = times_of(setup)
    arguments = (TOOLS[setup.step], setup.path.name)
    code = run_python(opensim_step.__name__, arguments, setup.folder, log, lambda: bar(*progress_of(log, window)))
    if code:
        raise UsageError(
            f"OpenSim's {setup.step} ({setup.path.name}) failed with code {code}: {last_words(log)}; "
            "--work DIR keeps its log"
        )


def run_python(
    module: str, arguments: Sequence[str], folder: Path, log: Path, look: Callable[[], None] = lambda: None
) -> int:
    """Run a module in a process of its own, in a folder, with its output in `log`; return its exit code.

    While it runs, `look` is called every `PERIOD`.
    """
    command = python_module(module, *arguments)
    with log.open("wb") as output, kept(output=output, patience=PATIENCE, cwd=folder, **command) as process:
        while process.poll() is None:
            look()
            with suppress(subprocess.TimeoutExpired):
                process.wait(PERIOD)
    return process.returncode


def times_of(setup: Setup) -> tuple[float, float]:
    """First and last time of a step [s]; both 0 if its set-up file has none."""
    texts = setup.text("time_range").split() or [setup.text("initial_time"), setup.text("final_time")]
    try:
        return float(texts[0]), float(texts[1])
    except (ValueError, IndexError):
        return 0.0, 0.0


def progress_of(log: Path, window: tuple[float, float]) -> tuple[int, int]:
    """Progress of a step in thousandths, with their number, by the last time in its log."""
    with log.open("rb") as file:
        file.seek(max(file.seek(0, 2) - TAIL, 0))
        times = TIMES.findall(file.read())
    if not times or window[1] <= window[0]:
        return 0, 1000
    with suppress(ValueError):
        return max(0, min(999, round(1000 * (float(times[-1]) - window[0]) / (window[1] - window[0])))), 1000
    return 0, 1000


def last_words(log: Path) -> str:
    """Last line of a log that reports a failure, or else its last line."""
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    telling = [line for line in lines if FAILED.search(line) and not MESHES.search(line)]
    return (telling or lines or ["it said nothing"])[-1]
