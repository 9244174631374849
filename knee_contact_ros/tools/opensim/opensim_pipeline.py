"""Run OpenSim's tools one after another in a copy of the user's folder, each in a process of its own."""

from __future__ import annotations

import shutil
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.offline.gait_files.storage import read_storage, repaired, text_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.terminal import Bar
from knee_contact_ros.tools.opensim.opensim_process import check_opensim, run_step
from knee_contact_ros.tools.opensim.opensim_setups import (
    CHOOSABLE,
    CMC,
    STATIC,
    TOOLS,
    Setup,
    absolute,
    check_inputs,
    common_folder,
    dynamics_setup,
    find_setups,
    reactions_setup,
    static_setup,
)

GB = 10**9
HIDDEN = "/."
"""Part of the paths that are not copied"""
LARGEST = 4 * GB
"""Largest size of a folder that is copied [B]"""
STATIC_RATE = 200.0
"""Rate of static optimization in our set-up files [Hz]: forces are smooth in between, and a row takes some 50 ms"""
RESULTS = ("Kinematics_q", "Kinematics_u", "JointReaction_ReactionLoads", "BodyKinematics_pos_global")
"""Results of the joint reactions' step, in the order of the fields of `Run`"""
WORDS = {
    "scale": "Scaling", "ik": "Inverse kinematics", "rra": "Residual reduction", "cmc": "Computed muscle control",
    "static": "Static optimization", "reactions": "Joint reactions", "dynamics": "Inverse dynamics",
}  # fmt: skip


class Run(NamedTuple):
    """Results of the steps; all paths are in the copy."""

    folder: Path
    """Folder in which the last step ran"""
    muscles: Setup
    """Set-up file of CMC or static optimization"""
    forces: Path
    """Forces of muscles, residual and reserve actuators"""
    model: Path
    kinematics: Path
    speeds: Path
    reactions: Path
    centre_of_mass: Path
    moments: Path
    """Net joint moments; the file is missing if inverse dynamics failed"""
    seconds: dict[str, float]
    """Duration of each step [s]"""
    setups: tuple[Setup, ...]
    """The user's set-up files, as they ran"""


def plan(paths: Sequence[Path], steps: Sequence[str]) -> tuple[Path, list[Setup]]:
    """Choose the folder to copy, and the set-up files of the steps to run, the last one CMC or static optimization.

    Without `steps`, all that have a set-up file are run, but static optimization only if there is no CMC.

    Raises:
        UsageError: a file is missing or cannot be used, or OpenSim is not installed.
    """
    there = find_setups(paths)
    unknown = [step for step in steps if step not in CHOOSABLE]
    if unknown:
        raise UsageError(f"--steps: there is no {unknown[0]}; there are {', '.join(CHOOSABLE)}")
    wanted = list(steps) or [step for step in CHOOSABLE if step in there and (step != STATIC or CMC not in there)]
    if (CMC in wanted) == (STATIC in wanted):
        raise UsageError(f"--steps {','.join(wanted)}: one of cmc and static must be among them, as forces come of it")
    missing = [step for step in wanted if step not in there and not (step == STATIC and CMC in there)]
    if missing:
        raise UsageError(f"--setup {paths[0]}: there is no set-up file for {missing[0]}; there are {', '.join(there)}")
    check_opensim()
    setups = [there[step if step in there else CMC] for step in CHOOSABLE if step in wanted]
    folder = common_folder(setups)
    check_inputs(setups)
    return folder, [s._replace(step=STATIC) if s.step == CMC and STATIC in wanted else s for s in setups]


def run_pipeline(folder: Path, setups: Sequence[Setup], work: Path, bar: Bar) -> Run:
    """Run the steps, joint reactions and inverse dynamics in `work`, a copy of `folder` that does not exist yet.

    Raises:
        UsageError: the folder cannot be copied, or a step has failed: its log is in `work`/logs.
    """
    copy(folder, work)
    seconds: dict[str, float] = {}

    def run(setup: Setup) -> None:
        bar.describe(f"{WORDS[setup.step]} ({len(seconds) + 1} of {len(setups) + 2})")
        begun = time.monotonic()
        run_step(setup, work, bar)
        seconds[setup.step] = time.monotonic() - begun

    own = [setup._replace(path=work / absolute(setup.path).relative_to(folder)) for setup in setups]
    for setup in own[:-1]:
        run(setup)
    last, place = own[-1], own[-1].folder
    if last.step == STATIC and last.tool.tag == TOOLS[CMC]:
        last = own[-1] = static_setup(last, place / "knee_contact_static.xml", rows_between(last))
    run(last)
    forces, states = results_of(last)
    reactions = reactions_setup(last, place / "knee_contact_reactions.xml", states, forces)
    run(reactions)
    made = {name: place / reactions.results() / f"{reactions.name}_{name}.sto" for name in RESULTS}
    stamps = read_storage(made["Kinematics_q"]).stamps / NANOSECONDS
    coordinates = str(made["Kinematics_q"].relative_to(place))
    window = (float(stamps[0]), float(stamps[-1]))
    dynamics = dynamics_setup(last, place / "knee_contact_dynamics.xml", coordinates, window)
    with suppress(UsageError):  # it only serves to judge; where it is missing, that is said
        run(dynamics)
    moments = place / dynamics.results() / "moments.sto"
    kinematics, speeds, loads, centre = made.values()
    model = place / last.text("model_file")
    return Run(place, last, place / forces, model, kinematics, speeds, loads, centre, moments, seconds, tuple(own))


def copy(folder: Path, work: Path) -> None:
    """Copy a folder, make the copy writable even if the original is not, and make a folder for logs in it.

    Raises:
        UsageError: the folder cannot be copied, or is too large.
    """
    visible = (path for path in folder.rglob("[!.]*") if HIDDEN not in str(path.relative_to(folder)))
    size = sum(path.stat().st_size for path in visible if path.is_file())
    if size > LARGEST:
        raise UsageError(f"{folder} has {size / GB:.1f} GB, and up to {LARGEST / GB:g} GB are copied; put less into it")
    try:
        shutil.copytree(folder, work, ignore=shutil.ignore_patterns(".*"), copy_function=shutil.copyfile)
        for path in (work, *work.rglob("*")):
            if path.is_dir():
                path.chmod(path.stat().st_mode | stat.S_IRWXU)
        (work / "logs").mkdir(exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise UsageError(f"cannot copy {folder}: {error}") from None


def rows_between(setup: Setup) -> int:
    """Interval, in rows of the kinematics, at which static optimization has the rate `STATIC_RATE`.

    Raises:
        UsageError: the kinematics cannot be read.
    """
    stamps = read_storage(setup.folder / setup.text("desired_kinematics_file")).stamps
    return max(1, round((len(stamps) - 1) * NANOSECONDS / (float(stamps[-1] - stamps[0]) * STATIC_RATE)))


def results_of(muscles: Setup) -> tuple[str, str | None]:
    """Find the files of forces and of states that the muscles' step wrote, relative to its folder.

    CMC's states are copied with a header that OpenSim can read; static optimization may have none.

    Raises:
        UsageError: a file is not there.
    """
    results, place = Path(muscles.results()), muscles.folder
    if muscles.step == STATIC:
        forces = results / f"{muscles.name}_StaticOptimization_force.sto"
        states = Path(muscles.text("states_file")) if muscles.text("states_file") else None
    else:
        forces, states = results / f"{muscles.name}_Actuation_force.sto", results / f"{muscles.name}_states.sto"
    for name in filter(None, (forces, states)):
        if not (place / name).is_file():
            raise UsageError(f"{muscles.step} has not written {name}; for CMC that needs an Actuation analysis")
    if states is None:
        return str(forces), None
    fixed = states.with_stem(f"{states.stem}_repaired")
    (place / fixed).write_text(repaired(text_of(place / states), place / states), encoding="utf-8")
    return str(forces), str(fixed)
