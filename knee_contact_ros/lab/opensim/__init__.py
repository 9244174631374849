"""The work of `knee-contact import-opensim`: run OpenSim if requested, read one or both knees, write bags, print."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab import checks, gait_bag
from knee_contact_ros.lab.gait_bag import Gait, digest
from knee_contact_ros.lab.opensim import leg as legs
from knee_contact_ros.lab.opensim import results, run
from knee_contact_ros.lab.opensim.results import (
    LEFT,
    RIGHT,
    Pose,
    Reaction,
    Settings,
    coordinate_of,
)
from knee_contact_ros.lab.tables import Series, read_storage
from knee_contact_ros.lab.tables import Table as StorageTable
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require
from knee_contact_ros.system.output_files import work_folder
from knee_contact_ros.system.progress import progress
from knee_contact_ros.system.terminal import say

LOADS = "external_loads_file"


class Files(NamedTuple):
    """Files to read."""

    kinematics: Path
    reactions: Path
    speeds: Path | None = None
    model: Path | None = None
    ground: Path | None = None
    """External loads file, or ground reactions with columns named by foot; None: do not simulate a leg's sensors"""
    ground_data: Path | None = None
    """File with the numbers of `ground`"""


def import_opensim(
    side: str,
    output: Path,
    overwrite: bool,
    setup: Sequence[Path],
    steps: str,
    work: Path | None,
    ground: str | None,
    rate: float,
    angle_sign: str,
    anyway: bool,
    **rest: Any,
) -> None:
    """Import results of OpenSim, or run OpenSim first; arguments are the options of the command, by name.

    With --setup, OpenSim's tools run in a copy of the set-up files' folder. With `both`, each side becomes a bag.

    Raises:
        UsageError: options are missing or exclude each other, a file or the output cannot be used, or a step failed.
            Nothing is written then.
    """
    own = {name: rest.pop(name) for name in ("kinematics", "reactions", "speeds", "model")}
    sign = None if angle_sign == "auto" else int(angle_sign)
    settings = Settings(**rest, angle_sign=sign, rate=rate or None, anyway=anyway)
    chosen, given = (
        tuple(filter(None, steps.split(","))),
        [f"--{name}" for name, path in own.items() if path],
    )
    if setup and given:
        raise UsageError(
            f"{given[0]} and --setup cannot be given together: OpenSim's run makes its own"
        )
    if ground and not setup and not own["model"]:
        raise UsageError("--ground needs --model M.osim, to find the ankle")
    if ground == "" and not setup:
        raise UsageError("--ground FILE is missing; it is found only with --setup")
    if not setup and (chosen or work):
        raise UsageError("--steps and --work need --setup")
    for name in ("kinematics", "reactions"):
        if not setup and not own[name]:
            raise UsageError(
                f"--{name} FILE is missing; or give --setup FOLDER, and OpenSim is run"
            )
    if ground:
        require("opensim", "opensim")
        own |= {"ground": Path(ground), "ground_data": run.data_file(Path(ground))}
    bags, more, lines = outputs(side, output, settings, overwrite), dict[str, str](), list[str]()
    with work_folder(output.parent) as temporary:
        if setup:
            folder = (work or temporary / "opensim").resolve()
            own, more, lines = run_tools(setup, chosen, folder, ground)
        gaits = {
            bag: read_knee(name, Files(**own), settings, temporary) for name, bag in bags.items()
        }
        used = {name: path for name, path in own.items() if path}
        more = {"settings": json.dumps(settings._asdict())} | more
        gait_bag.store(gaits, "OpenSim results", used, more, temporary)
    for line in lines:
        say(line, hang=2 * line.startswith("-"))


def run_tools(
    setup: Sequence[Path], steps: Sequence[str], work: Path, ground: str | None
) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Run OpenSim's tools, with logs and results in the new folder `work`.

    With `ground` the leg's sensors are simulated too, from this file of ground reactions or, if empty, from the
    set-up's.

    Returns:
        The files as in `Files`, entries for the metadata record, and lines to print on time and quality.
    """
    folder, planned = run.plan(setup, steps)
    if work.exists():
        raise UsageError(f"--work {work} exists already; give a new folder")
    if ground == "" and not planned[-1].text(LOADS):
        raise UsageError(f"--ground: {planned[-1].path} has no {LOADS}; give --ground FILE")
    with progress("OpenSim") as bar:
        done = run.run_pipeline(folder, planned, work, bar)
    try:
        quality = run.verdict(run.assess(done))
    except UsageError as error:  # hours of computing are not given up for that
        quality = [f"Residuals and reserves could not be judged: {error}"]
    results = {
        "kinematics": "Kinematics_q",
        "speeds": "Kinematics_u",
        "reactions": "JointReaction_ReactionLoads",
    }
    own: dict[str, Any] = {name: done.result(file) for name, file in results.items()}
    own["model"] = done.folder / done.muscles.text("model_file")
    if ground is not None:
        loads = Path(ground) if ground else done.folder / done.muscles.text(LOADS)
        own |= {
            "ground": loads,
            "ground_data": run.data_file(loads, None if ground else done.folder),
        }
    more = {
        "source": f"OpenSim {version('opensim')}",
        "steps": "\n".join(
            f"{setup.step}: {setup.path.name} {digest(setup.path)}" for setup in done.setups
        ),
        "quality": "\n".join(quality),
    }
    took = ", ".join(f"{step} {seconds:.1f} s" for step, seconds in done.seconds.items())
    return own, more, [f"OpenSim: {took}", *quality]


def outputs(side: str, output: Path, settings: Settings, overwrite: bool) -> dict[str, Path]:
    """Paths of the bags by side: OUTPUT, or OUTPUT_right and OUTPUT_left for both.

    Raises:
        UsageError: a bag exists already, or --joint or --coordinate is given with both sides.
    """
    both = side == "both"
    if both and (settings.joint or settings.coordinate):
        raise UsageError(
            "--joint and --coordinate belong to one knee; give --side right or left with them"
        )
    bags = (
        {name: output.with_name(f"{output.name}_{name}") for name in (RIGHT, LEFT)}
        if both
        else {side: output}
    )
    for bag in bags.values():
        gait_bag.check_output(bag, overwrite)
    return bags


def read_knee(side: str, files: Files, settings: Settings, work: Path) -> Gait:
    """Read a knee's gait, and with ground reactions its leg's sensors; for these OpenSim runs in the folder `work`.

    Raises:
        UsageError: a file cannot be used, a column is missing, or a unit, sign or frame is wrong or unclear.
    """
    start, end = settings.start, settings.end
    kinematics, reactions = read_storage(files.kinematics), read_storage(files.reactions)
    column = results.angle_column(kinematics, side, settings.coordinate)
    kinematics = kinematics.needed([column], start, end)
    weight, bounds = (
        results.read_model(files.model, coordinate_of(column)) if files.model else (None, None)
    )
    angle, notes = results.read_angles(kinematics, column, files.speeds, settings, bounds)
    degrees = checks.unit_of(kinematics, column, settings.angle_unit) == "deg"
    chosen = results.find_reactions(reactions, side, settings.joint)
    reactions = reactions.needed(
        [each.column(axis) for each in chosen for axis in results.AXES], start, end
    )
    poses, reactions, doubts = _poses(
        chosen, reactions, kinematics, degrees, angle, files.model, work
    )
    reaction, of_reaction = results.read_reaction(
        reactions, list(zip(chosen, poses, strict=True)), side
    )
    notes += of_reaction
    columns = {
        "angle": f"{column} of {files.kinematics.name}",
        "load": f"{' + '.join(each.column(results.ALL) for each in chosen)} of {files.reactions.name}",
    }
    joints, wrenches = {gait_bag.JOINT: [angle]}, {"load": reaction}
    if files.ground and files.ground_data and files.model:
        ground = legs.read_ground(files.ground, files.ground_data, side)
        names = legs.leg_joints(files.model, side, coordinate_of(column))
        angles, wrenches["ground_force"], of_leg = legs.read_leg(
            ground, kinematics, degrees, files.model, names, work
        )
        joints |= {name: [each] for name, each in angles.items()}
        columns |= dict.fromkeys(angles, "by OpenSim")
        columns["ground_force"] = f"{ground.columns} of {files.ground_data.name}"
        notes += of_leg
    window = gait_bag.common_window(
        angle.stamps, *(each.stamps for each in wrenches.values()), start=start, end=end
    )
    flexion, force = (each.around(window) for each in (angle, reaction))
    up = " + ".join(each.column("fy") for each in chosen)
    load = Series("load", files.reactions, up, force.stamps, -force.values[:, 1])
    seen = Series("angle", files.kinematics, column, flexion.stamps, flexion.values[:, 0])
    checks.refuse(checks.impossible(seen, load, mapped=False))
    likely = [*kinematics.doubts, *reactions.doubts]
    likely += checks.doubts(seen, load, None, weight, results.MAX_GAP, mapped=False)
    checks.refuse(likely, settings.anyway)
    rate, gap = settings.rate, results.MAX_GAP
    gait = gait_bag.sampled(side, joints, wrenches, rate=rate, max_gap=gap, start=start, end=end)
    doubts += [*likely, *checks.unusual(load, weight)]
    return gait._replace(columns=columns, notes=notes + gait.notes, doubts=doubts, weight=weight)


def _poses(
    chosen: Sequence[Reaction],
    reactions: StorageTable,
    kinematics: StorageTable,
    degrees: bool,
    angle: gait_bag.Signal,
    model: Path | None,
    work: Path,
) -> tuple[list[Pose | None], StorageTable, list[str]]:
    """Poses of the tibia in the frames of reactions, if these are not the tibia's; the rows with a pose, and doubts.

    Raises:
        UsageError: a model is needed but not given, or does not fit.
    """
    first = chosen[0]
    if all(each.rank < 2 for each in chosen):
        return [None] * len(chosen), reactions, []
    if model and (find_spec("opensim") or first.rank != 2):
        found = [
            legs.tibia_in(each, kinematics, degrees, model, reactions.stamps, work)
            for each in chosen
        ]
        return (
            [pose for pose, _ in found],
            reactions.rows(np.isin(reactions.stamps, found[0][1])),
            [],
        )
    if first.rank != 2:
        raise results.needs_model(reactions, first)
    inside = reactions.stamps[
        (reactions.stamps >= angle.stamps[0]) & (reactions.stamps <= angle.stamps[-1])
    ]
    doubt = (
        f"{reactions.path}: the reaction was turned from {first.frame} by the flexion angle alone, as of a hinge, and "
        "its torque is about the point that the file has: --model (with the extra opensim) turns it as the model does"
    )
    return (
        [results.hinge(angle, inside)],
        reactions.rows(np.isin(reactions.stamps, inside)),
        [doubt],
    )
