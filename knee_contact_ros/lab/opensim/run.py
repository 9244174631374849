"""Run OpenSim's tools from the user's set-up files, one after another, each in a process of its own.

The tools run in a copy of the user's folder.
"""

import re
import shutil
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from ...streams.topics import NANOSECONDS
from ...system.errors import UsageError
from ...system.processes import python_module, running
from ...system.progress import Bar
from ..tables import read_storage, repaired
from . import child
from .setups import (
    CMC,
    EXTERNAL_LOADS,
    STATIC,
    TOOLS,
    Setup,
    absolute_path,
    dynamics_setup,
    localised,
    reactions_setup,
    read_xml,
    static_setup,
)

_FAILURE = re.compile(r"error|exception|fail|unable|not found", re.IGNORECASE)
"""Words of a log's line that reports a failure"""
_WARNING = re.compile(r"\s*\[(?:warning|error|critical)\]", re.IGNORECASE)
"""Beginning of a log's line that warns"""
_TOLD = 3
"""Largest number of warnings of a log that are told"""
_MISSING_MESH = re.compile(r"mesh|\.vtp|\.stl|\.obj", re.IGNORECASE)
"""Words of a line that reports that a bone cannot be drawn, which does not matter"""


class OpenSimRun(NamedTuple):
    """Results of the steps; all paths are in the copy."""

    folder: Path
    """Folder in which the last step ran"""
    muscles: Setup
    """Set-up file of CMC or static optimization"""
    forces: Path
    """Forces of muscles, residual and reserve actuators"""
    results: Path
    """Folder of the joint reactions' step"""
    moments: Path
    """Net joint moments; the file is missing if inverse dynamics failed"""
    seconds: dict[str, float]
    """Wall time of each step [s]"""
    setups: tuple[Setup, ...]
    """The user's set-up files as they were run"""
    warned: tuple[str, ...] = ()
    """What the logs of the user's steps warn of, a line each"""

    def result(self, name: str) -> Path:
        """File with a result of the joint reaction step."""
        return self.results / f"knee_contact_{name}.sto"


def run_pipeline(folder: Path, setups: Sequence[Setup], work: Path, bar: Bar) -> OpenSimRun:
    """Copy `folder` to the new folder `work`, and run the steps, joint reactions and inverse dynamics there.

    Raises:
        UsageError: the folder cannot be copied, or a step failed; its log is in `work`/logs.
    """
    _copy_folder(folder, work)
    own = [
        setup._replace(path=work / absolute_path(setup.path).relative_to(folder))
        for setup in setups
    ]
    for setup in own:
        _prepare(setup)
    seconds: dict[str, float] = {}

    def run(setup: Setup) -> None:
        bar.describe(f"{setup.step} ({len(seconds) + 1} of {len(setups) + 2})")
        begun = time.monotonic()
        _run_tool(setup, work / "logs" / f"{setup.step}.log")
        seconds[setup.step] = time.monotonic() - begun

    for setup in own[:-1]:
        run(setup)
    muscles = own[-1] = _for_muscles(own[-1])
    run(muscles)
    logs = [(setup.step, work / "logs" / f"{setup.step}.log") for setup in own]
    warned = tuple(f"OpenSim's {step}: {line}" for step, log in logs for line in warnings_in(log))
    place = muscles.folder
    forces, states = _results_of(muscles)
    reactions = reactions_setup(muscles, place / "knee_contact_reactions.xml", states, forces)
    run(reactions)
    done = OpenSimRun(
        place,
        muscles,
        place / forces,
        place / reactions.results,
        Path(),
        seconds,
        tuple(own),
        warned,
    )
    kinematics = done.result("Kinematics_q")
    times = read_storage(kinematics).stamps / NANOSECONDS
    window = (float(times[0]), float(times[-1]))
    coordinates = str(kinematics.relative_to(place))
    dynamics = dynamics_setup(muscles, place / "knee_contact_dynamics.xml", coordinates, window)
    with suppress(UsageError):  # it only serves to judge; where it is missing, that is said
        run(dynamics)
    return done._replace(moments=place / dynamics.results / "moments.sto")


def _copy_folder(folder: Path, work: Path) -> None:
    """Copy a folder without hidden files, so that the copy can be written to even if the original cannot."""
    hidden = shutil.ignore_patterns(".*")
    try:
        shutil.copytree(folder, work, ignore=hidden, copy_function=shutil.copyfile)
        for path in (work, *(path for path in work.rglob("*") if path.is_dir())):
            path.chmod(0o755)
        (work / "logs").mkdir(exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise UsageError(f"cannot copy {folder}: {error}") from None


def _prepare(setup: Setup) -> None:
    """Write a set-up file, and its external loads, whose names were made relative to their folder."""
    if setup.document is not None and setup.changed:
        ET.ElementTree(setup.document).write(setup.path, "UTF-8", xml_declaration=True)
    loads = setup.folder / setup.text(EXTERNAL_LOADS)
    if loads.is_file():
        document = read_xml(loads)
        if localised(document, loads.parent, ("datafile", "external_loads_model_kinematics_file")):
            ET.ElementTree(document).write(loads, "UTF-8", xml_declaration=True)


def _run_tool(setup: Setup, log: Path) -> None:
    """Run the tool of a set-up file, and refuse a failure."""
    code = run_python(child.__name__, (TOOLS[setup.step], setup.path.name), setup.folder, log)
    if code:
        raise UsageError(
            f"OpenSim's {setup.step} ({setup.path.name}) failed with code {code}: {failure_in(log)}; "
            "--work DIR keeps its log"
        )


def _for_muscles(setup: Setup) -> Setup:
    """Return the set-up of the muscles' step; one for CMC becomes one for static optimization if that is wanted."""
    if setup.step != STATIC or setup.tool.tag != TOOLS[CMC]:
        return setup
    stamps = read_storage(setup.folder / setup.text("desired_kinematics_file")).stamps
    rate = (len(stamps) - 1) * NANOSECONDS / float(stamps[-1] - stamps[0])
    # 200 rows a second: forces are smooth in between, and a row takes about 50 ms.
    interval = max(1, round(rate / 200.0))
    return static_setup(setup, setup.folder / "knee_contact_static.xml", interval)


def run_python(module: str, arguments: Sequence[str], folder: Path, log: Path) -> int:
    """Run a module in its own process and a folder, with its output in `log`; return the exit code."""
    command = python_module(module, *arguments)
    with (
        log.open("wb") as output,
        running(output=output, patience=5.0, cwd=folder, **command) as process,
    ):
        return process.wait()


def warnings_in(log: Path) -> list[str]:
    """Return the lines of a log that warn of something else than bones that cannot be drawn: the first, each once."""
    text = log.read_text(encoding="utf-8", errors="replace")
    lines = dict.fromkeys(line.strip() for line in text.splitlines() if _WARNING.match(line))
    told = [line for line in lines if not _MISSING_MESH.search(line)]
    more = [f"and {len(told) - _TOLD} more (--work DIR keeps its log)"] * (len(told) > _TOLD)
    return told[:_TOLD] + more


def failure_in(log: Path) -> str:
    """Return the last line of a log that reports a failure, or else its last line."""
    text = log.read_text(encoding="utf-8", errors="replace")
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    failures = [line for line in lines if _FAILURE.search(line) and not _MISSING_MESH.search(line)]
    return (failures or lines or ["it said nothing"])[-1]


def _results_of(muscles: Setup) -> tuple[Path, Path | None]:
    """Find the files of forces and states from the muscles' step, relative to its folder.

    CMC's states are copied with a header that OpenSim can read; static optimization may have none.

    Raises:
        UsageError: a file is missing.
    """
    begin = muscles.results / muscles.name
    if muscles.step == STATIC:
        forces = Path(f"{begin}_StaticOptimization_force.sto")
        states = Path(muscles.text("states_file"))
    else:
        forces = Path(f"{begin}_Actuation_force.sto")
        states = Path(f"{begin}_states.sto")
    has_states = states != Path()
    for name in [forces, states] if has_states else [forces]:
        if not (muscles.folder / name).is_file():
            raise UsageError(
                f"{muscles.step} has not written {name}; for CMC that needs an Actuation analysis"
            )
    if not has_states:
        return forces, None
    fixed = states.with_stem(f"{states.stem}_repaired")
    (muscles.folder / fixed).write_text(repaired(muscles.folder / states), encoding="utf-8")
    return forces, fixed
