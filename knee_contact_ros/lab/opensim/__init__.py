"""The work of `knee-contact import-opensim`: run OpenSim if requested, read one or both knees, write bags, print."""

import json
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...streams.topics import NET_LOAD
from ...system.errors import UsageError
from ...system.files import is_file, require
from ...system.output_files import work_folder
from ...system.progress import progress
from ...system.terminal import say
from .. import checks, gait_bag
from ..events import with_events
from ..gait_bag import ImportedGait, digest
from ..tables import Table, TimeSeries, read_storage
from . import leg as legs
from . import results, run
from .quality import DO_NOT_TRUST, assess, verdict
from .results import (
    LEFT,
    RIGHT,
    ImportSettings,
    JointReaction,
    TibiaPose,
    coordinate_of,
)
from .setups import EXTERNAL_LOADS, data_file, plan


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


def run_import_opensim(
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
    events: str,
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
    settings = ImportSettings(**rest, angle_sign=sign, rate=rate or None, anyway=anyway)
    chosen = [step for step in steps.split(",") if step]
    if setup:
        if given := [f"--{name}" for name, path in own.items() if path]:
            raise UsageError(
                f"{given[0]} and --setup cannot be given together: OpenSim's run makes its own"
            )
    else:
        _check_without_setup(own, bool(chosen or work), ground)
    if ground:
        require("opensim", "opensim")
        own |= {"ground": Path(ground), "ground_data": data_file(Path(ground))}
    if side == "both" and events and not is_file(Path(events)):
        raise UsageError(
            "--events with times belongs to one leg; give --side right or left with it"
        )
    bags = _bags_by_side(side, output, settings, overwrite)
    record: dict[str, str] = {}
    lines: list[str] = []
    with work_folder(output.parent) as temporary:
        if setup:
            folder = (work or temporary / "opensim").resolve()
            own, record, lines = _run_tools(setup, chosen, folder, ground)
        files = Files(**own)
        gaits = {
            bag: with_events(read_knee(name, files, settings, temporary), events, anyway)
            for name, bag in bags.items()
        }
        warnings = [line for line in lines if line.startswith(DO_NOT_TRUST)]
        gaits = {
            bag: gait._replace(doubts=[*gait.doubts, *warnings]) for bag, gait in gaits.items()
        }
        used = {name: path for name, path in own.items() if path}
        record = {"settings": json.dumps(settings._asdict())} | record
        gait_bag.store(gaits, "OpenSim results", used, record, temporary)
    for line in lines:
        if line not in warnings:  # which are told with the doubts
            say(line, hang=2 if line.startswith("-") else 0)


def _check_without_setup(own: dict[str, Any], has_options: bool, ground: str | None) -> None:
    """Refuse options that only a run of OpenSim's tools uses, and missing files."""
    if ground and not own["model"]:
        raise UsageError("--ground needs --model M.osim, to find the ankle")
    if ground == "":
        raise UsageError("--ground FILE is missing; it is found only with --setup")
    if has_options:
        raise UsageError("--steps and --work need --setup")
    for name in ("kinematics", "reactions"):
        if not own[name]:
            raise UsageError(
                f"--{name} FILE is missing; or give --setup FOLDER, and OpenSim is run"
            )


def _run_tools(
    setup: Sequence[Path], steps: Sequence[str], work: Path, ground: str | None
) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Run OpenSim's tools, with logs and results in the new folder `work`.

    With `ground` the leg's sensors are simulated too, from this file of ground reactions or, if empty, from the
    set-up's.

    Returns:
        The files as in `Files`, entries for the metadata record, and lines to print on time and quality.
    """
    folder, planned = plan(setup, steps)
    if work.exists():
        raise UsageError(f"--work {work} exists already; give a new folder")
    if ground == "" and not planned[-1].text(EXTERNAL_LOADS):
        raise UsageError(
            f"--ground: {planned[-1].path} has no {EXTERNAL_LOADS}; give --ground FILE"
        )
    with progress("OpenSim") as bar:
        done = run.run_pipeline(folder, planned, work, bar)
    try:
        quality = verdict(assess(done))
    except UsageError as error:  # hours of computing are not given up for that
        quality = [f"Residuals and reserves could not be judged: {error}"]
    own: dict[str, Any] = {
        "kinematics": done.result("Kinematics_q"),
        "speeds": done.result("Kinematics_u"),
        "reactions": done.result("JointReaction_ReactionLoads"),
        "model": done.folder / done.muscles.text("model_file"),
    }
    if ground:
        own |= {"ground": Path(ground), "ground_data": data_file(Path(ground))}
    elif ground is not None:
        loads = done.folder / done.muscles.text(EXTERNAL_LOADS)
        own |= {"ground": loads, "ground_data": data_file(loads, done.folder)}
    ran = [f"{setup.step}: {setup.path.name} {digest(setup.path)}" for setup in done.setups]
    record = {
        "source": f"OpenSim {version('opensim')}",
        "steps": "\n".join(ran),
        "quality": "\n".join(quality),
    }
    took = ", ".join(f"{step} {seconds:.1f} s" for step, seconds in done.seconds.items())
    return own, record, [f"OpenSim: {took}", *done.warned, *quality]


def _bags_by_side(
    side: str, output: Path, settings: ImportSettings, overwrite: bool
) -> dict[str, Path]:
    """Return the paths of the bags by side: OUTPUT, or OUTPUT_right and OUTPUT_left for both.

    Raises:
        UsageError: a bag exists already, or --joint or --coordinate is given with both sides.
    """
    bags = {side: output}
    if side == "both":
        bags = {name: output.with_name(f"{output.name}_{name}") for name in (RIGHT, LEFT)}
        if settings.joint or settings.coordinate:
            raise UsageError(
                "--joint and --coordinate belong to one knee; give --side right or left with them"
            )
    for bag in bags.values():
        gait_bag.check_bag_output(bag, overwrite)
    return bags


def read_knee(side: str, files: Files, settings: ImportSettings, work: Path) -> ImportedGait:
    """Read a knee's gait, and with ground reactions its leg's sensors; for these OpenSim runs in the folder `work`.

    Raises:
        UsageError: a file cannot be used, a column is missing, or a unit, sign or frame is wrong or unclear.
    """
    start, end = settings.start, settings.end
    kinematics = read_storage(files.kinematics)
    reactions = read_storage(files.reactions)
    column = results.angle_column(kinematics, side, settings.coordinate)
    coordinate = coordinate_of(column)
    kinematics = kinematics.needed([column], start, end)
    weight, bounds = results.read_model(files.model, coordinate) if files.model else (None, None)
    weight = settings.body_weight or weight
    angle, notes = results.read_angles(kinematics, column, files.speeds, settings, bounds)
    degrees = checks.angle_unit_of(kinematics, column, settings.angle_unit) == "deg"
    chosen = results.find_reactions(reactions, side, settings.joint)
    needed = [each.column(axis) for each in chosen for axis in results.AXES]
    reactions = reactions.needed(needed, start, end)
    poses, reactions, doubts = _poses(
        chosen, reactions, kinematics, degrees, angle, files.model, work
    )
    parts = list(zip(chosen, poses, strict=True))
    reaction, of_reaction = results.read_reaction(reactions, parts, side)
    notes += of_reaction
    names = " + ".join(each.column(f"({' '.join(results.AXES)})") for each in chosen)
    kind = NET_LOAD if settings.net else "load"
    columns = {
        "angle": f"{column} of {files.kinematics.name}",
        kind: f"{names} of {files.reactions.name}",
    }
    joints = {gait_bag.JOINT: [angle]}
    wrenches = {kind: reaction}
    if files.ground and files.ground_data and files.model:
        ground = legs.read_ground(files.ground, files.ground_data, side)
        of_leg = legs.leg_joints(files.model, side, coordinate)
        angles, wrenches["ground_force"], leg_notes = legs.read_leg(
            ground, kinematics, degrees, files.model, of_leg, work
        )
        joints |= {name: [each] for name, each in angles.items()}
        columns |= dict.fromkeys(angles, "by OpenSim")
        columns["ground_force"] = f"{ground.columns} of {files.ground_data.name}"
        notes += leg_notes
    stamps = [angle.stamps, *(each.stamps for each in wrenches.values())]
    window = gait_bag.common_window(*stamps, start=start, end=end)
    flexion = angle.around(window)
    force = reaction.around(window)
    up = " + ".join(each.column("fy") for each in chosen)
    load = TimeSeries("load", files.reactions, up, force.stamps, -force.values[:, 1])
    knee = TimeSeries("angle", files.kinematics, column, flexion.stamps, flexion.values[:, 0])
    checks.refuse(checks.impossible(knee, load, mapped=False))
    likely = [*kinematics.doubts, *reactions.doubts]
    judged = None if settings.net else load
    likely += checks.gait_doubts(knee, judged, None, weight, results.MAX_GAP, mapped=False)
    if settings.net:
        about = load._replace(columns=" + ".join(each.column("mz") for each in chosen))
        moment = about._replace(values=force.values[:, 5])
        likely += checks.net_doubts(load, moment, None, weight)
    checks.refuse(likely, settings.anyway)
    rate, gap = settings.rate, results.MAX_GAP
    gait = gait_bag.sampled(side, joints, wrenches, rate=rate, max_gap=gap, start=start, end=end)
    doubts += [
        *likely,
        *(checks.unusual(load, weight) if judged else []),
        *checks.convention_doubts(gait, weight),
    ]
    return gait._replace(columns=columns, notes=notes + gait.notes, doubts=doubts, weight=weight)


def _poses(
    chosen: Sequence[JointReaction],
    reactions: Table,
    kinematics: Table,
    degrees: bool,
    angle: gait_bag.Signal,
    model: Path | None,
    work: Path,
) -> tuple[Sequence[TibiaPose | None], Table, list[str]]:
    """Find the tibia in the frames of reactions, if these are not the tibia's; also the rows with a pose, and doubts.

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
        known = reactions.rows(np.isin(reactions.stamps, found[0][1]))
        return [pose for pose, _ in found], known, []
    if first.rank != 2:
        raise results.needs_model(reactions, first)
    stamps = reactions.stamps
    inside = reactions.rows((stamps >= angle.stamps[0]) & (stamps <= angle.stamps[-1]))
    doubt = (
        f"{reactions.path}: the reaction was turned from {first.frame} by the flexion angle alone, as of a hinge, and "
        "its torque is about the point that the file has: --model (with the extra opensim) turns it as the model does"
    )
    return [results.tibia_on_hinge(angle, inside.stamps)], inside, [doubt]
