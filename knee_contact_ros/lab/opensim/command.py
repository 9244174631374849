"""The work of `knee-contact import-opensim`: run OpenSim if requested, read one knee or both, write bags, print."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.lab import checks, gait_bag
from knee_contact_ros.lab.gait_bag import Gait, digest
from knee_contact_ros.lab.opensim import leg as legs
from knee_contact_ros.lab.opensim import pipeline, results, setup_files
from knee_contact_ros.lab.opensim.pipeline import Check, Run
from knee_contact_ros.lab.opensim.results import LEFT, RIGHT, Pose, Reaction, Settings, coordinate_of
from knee_contact_ros.lab.tables import Series, read_storage
from knee_contact_ros.lab.tables import Table as StorageTable
from knee_contact_ros.streams.gait_events import LOAD_PEAK, GaitEvents
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import WIDTH, progress, say, shown, warn

LOADS = "external_loads_file"
USUAL_WEIGHT = 737.068
"""Body weight for the search for peaks where no model is given [N]: the default of `body_weight`"""
SHARE = 0.5
"""Share of the axial load that a compartment has by default (`load.share`)"""


class Files(NamedTuple):
    """Files to read."""

    kinematics: Path
    reactions: Path
    speeds: Path | None = None
    model: Path | None = None
    ground: Path | None = None
    """External loads file, or ground reactions with names that tell the foot; None: no leg's sensors are simulated"""
    ground_data: Path | None = None
    """File with the numbers of `ground`"""


def import_opensim(
    side: str, output: Path, overwrite: bool, setups: Sequence[Path], steps: str, work: Path | None, ground: str | None,
    rate: float, angle_sign: str, anyway: bool, **rest: Any,
) -> None:  # fmt: skip
    """Import results of OpenSim, or run OpenSim first; arguments are the options of the command, by name.

    With --setup, OpenSim's tools run in a copy of the set-up files' folder. `both` sides are a bag each.

    Raises:
        UsageError: options exclude each other or are missing, a file or the output cannot be used, or a step has
            failed; nothing is then written.
    """
    files = {name: rest.pop(name) for name in ("kinematics", "reactions", "speeds", "model")}
    settings = Settings(
        **rest, angle_sign=None if angle_sign == "auto" else int(angle_sign), rate=rate or None, anyway=anyway
    )
    chosen, given = tuple(filter(None, steps.split(","))), [f"--{name}" for name, path in files.items() if path]
    if setups:
        if given:
            raise UsageError(f"{given[0]} and --setup exclude each other: OpenSim's run gives its own")
        import_run(setups, chosen, work, settings, outputs(side, output, settings, overwrite), ground)
        return
    if ground is not None:
        if not ground:
            raise UsageError("--ground FILE is missing; only with --setup it is found")
        if not files["model"]:
            raise UsageError("--ground needs --model M.osim, which tells where the ankle is")
        setup_files.check_opensim()
        files |= {"ground": Path(ground), "ground_data": legs.data_file(Path(ground))}
    if chosen or work:
        raise UsageError("--steps and --work need --setup")
    for name in ("kinematics", "reactions"):
        if not files[name]:
            raise UsageError(f"--{name} FILE is missing; or give --setup FOLDER, and OpenSim is run")
    bags = outputs(side, output, settings, overwrite)
    with work_folder(output.parent) as temporary:
        store(Files(**files), settings, bags, temporary, {})


def import_run(
    setups: Sequence[Path], steps: Sequence[str], keep: Path | None, settings: Settings, bags: dict[str, Path],
    ground: str | None,
) -> None:  # fmt: skip
    """Run OpenSim's tools, keep their logs and results in the folder `keep`, if any, and import them.

    With `ground` the leg's sensors are simulated too, from this file of ground reactions or, if empty, the set-up's.
    """
    folder, planned = setup_files.plan(setups, steps)
    if keep and keep.exists():
        raise UsageError(f"--work {keep} exists already; give a new folder")
    if ground:
        legs.data_file(Path(ground))
    elif ground is not None and not planned[-1].text(LOADS):
        raise UsageError(f"--ground: {planned[-1].path} has no {LOADS}; give --ground FILE")
    with work_folder(next(iter(bags.values())).parent) as work:
        with progress("OpenSim") as bar:
            run = pipeline.run_pipeline(folder, planned, (keep or work / "opensim").resolve(), bar)
        found, fault = judge(run)
        files = Files(run.kinematics, run.reactions, run.speeds, run.model)
        if ground is not None:
            loads = Path(ground) if ground else run.folder / run.muscles.text(LOADS)
            files = files._replace(ground=loads, ground_data=legs.data_file(loads, None if ground else run.folder))
        more = {
            "source": f"OpenSim {version('opensim')}",
            "steps": "\n".join(f"{setup.step}: {setup.path.name} {digest(setup.path)}" for setup in run.setups),
            "quality": "\n".join(check.sentence() for check in found) or fault,
        }
        store(files, settings, bags, work, more)
    took = ", ".join(f"{setup_files.WORDS[step].lower()} {seconds:.1f} s" for step, seconds in run.seconds.items())
    Console(width=WIDTH, emoji=False).print(f"OpenSim: {took}", highlight=False, markup=False)
    show_checks(found, fault)


def judge(run: Run) -> tuple[list[Check], str]:
    """Check a run; if that fails return no checks and the reason, as hours of computing are not given up for that."""
    try:
        return pipeline.assess(run), ""
    except UsageError as fault:
        return [], f"Residuals and reserves could not be judged: {fault}"


def outputs(side: str, output: Path, settings: Settings, overwrite: bool) -> dict[str, Path]:
    """Paths of the bags by side: OUTPUT, or OUTPUT_right and OUTPUT_left for both.

    Raises:
        UsageError: a bag exists already, or --joint or --coordinate is given for both sides.
    """
    bags = {side: output}
    if side == "both":
        if settings.joint or settings.coordinate:
            raise UsageError("--joint and --coordinate name one knee's; give --side right or left with them")
        bags = {name: output.with_name(f"{output.name}_{name}") for name in (RIGHT, LEFT)}
    for bag in bags.values():
        gait_bag.check_output(bag, overwrite)
    return bags


def store(files: Files, settings: Settings, bags: Mapping[str, Path], work: Path, more: dict[str, str]) -> None:
    """Read the knees, write their bags by way of the folder `work`, and print summaries; `more` goes to the record."""
    knees = {side: read_knee(side, files, settings, work) for side in bags}
    for side, (gait, weight) in knees.items():
        given = {name: path for name, path in files._asdict().items() if path is not None}
        origin = gait_bag.origin_of("OpenSim results", side, given)
        origin |= {f"column of {what}": name for what, name in gait.columns.items()}
        origin |= {"conversions": "\n".join(gait.notes), "settings": json.dumps(settings._asdict())}
        origin |= gait_bag.QUANTITIES | (gait_bag.LEG_QUANTITIES if gait.ground else {})
        origin |= ({"body_weight": f"{weight:.3f} N"} if weight else {}) | more
        origin |= {"doubts": "\n".join(gait.doubts)} if gait.doubts else {}
        gait_bag.write_bag(gait, work / bags[side].name, origin)
    for bag in bags.values():
        replace(work / bag.name, bag)
    for side, (gait, weight) in knees.items():
        show_knee(gait, weight, files, bags[side])
        warn(gait.doubts)


def read_knee(side: str, files: Files, settings: Settings, work: Path) -> tuple[Gait, float | None]:
    """Read a knee's gait, and with ground reactions that of its leg; and the model's weight [N], if one is given.

    For the leg OpenSim runs in the folder `work`.

    Raises:
        UsageError: a file cannot be used, a column is missing, or unit, sign or frame are wrong or not clear.
    """
    for name in ("start", "end", "rate"):
        value = getattr(settings, name)
        if value is not None and not math.isfinite(value):
            raise UsageError(f"--{name} {value}: it must be a finite number")
    kinematics, reactions = read_storage(files.kinematics), read_storage(files.reactions)
    column = results.angle_column(kinematics, side, settings.coordinate)
    kinematics = kinematics.needed([column], settings.start, settings.end)
    facts = results.read_model(files.model, coordinate_of(column)) if files.model else None
    angle, notes = results.read_angles(kinematics, column, files.speeds, settings, facts.bounds if facts else None)
    degrees = checks.unit_of(kinematics, column, settings.angle_unit) == "deg"
    chosen = results.find_reaction(reactions, side, settings.joint)
    reactions = reactions.needed([chosen.column(axis) for axis in results.AXES], settings.start, settings.end)
    pose, reactions, assumed = _pose(chosen, reactions, kinematics, degrees, angle, files.model, work)
    reaction, of_reaction = results.read_reaction(reactions, chosen, side, pose)
    columns = {"angle": column, "reaction": chosen.column(f"({' '.join(results.AXES)})")}
    notes += of_reaction
    leg = None
    if files.ground and files.ground_data and files.model:
        ground = legs.read_ground(files.ground, files.ground_data, side)
        joints = legs.leg_joints(files.model, side, coordinate_of(column))
        leg = legs.read_leg(ground, kinematics, degrees, files.model, joints, side, work)
        columns["ground force"] = leg.columns
        notes += leg.notes
    ground_force = leg.ground if leg else None
    known = angle.stamps, reaction.stamps
    all_signals = [each for each in (angle, reaction, ground_force) if each]
    window = gait_bag.common_window(*all_signals, start=settings.start, end=settings.end)
    seen, loads = [each.inside(window) if len(each.inside(window).stamps) > 1 else each for each in (angle, reaction)]
    doubtful, unusual = _doubts(seen, loads, files, columns, facts and facts.weight)
    if doubtful and not settings.anyway:
        raise UsageError(f"{doubtful[0]} (--anyway imports it as it is)")
    if settings.rate:
        stamps = gait_bag.grid(window, settings.rate)
        stamps = stamps[np.all([gait_bag.bridged(stamps, each, results.MAX_GAP) for each in known], axis=0)]
        if len(stamps) < 2:
            raise UsageError(
                f"--rate {settings.rate:g}: fewer than two samples lie outside gaps of {results.MAX_GAP} s"
            )
        angle, reaction = angle.at(stamps), reaction.at(stamps)
        ground_force = ground_force and ground_force.at(stamps)
        notes.append(f"{'all' if leg else 'both'} interpolated linearly at {settings.rate:g} Hz")
    else:
        rows = len(reaction.stamps)
        angle, reaction = angle.around(window), gait_bag.within(reaction, window)
        ground_force = ground_force and ground_force.inside(window)
        if outside := rows - len(reaction.stamps):
            notes.append(f"{outside} reactions left out: no angle at their time, or outside --start and --end")
    for name, stamps in zip(("angle", "reaction"), known, strict=True):
        inside = stamps[(stamps >= window[0]) & (stamps <= window[1])]
        notes += gait_bag.gaps(name, inside, results.MAX_GAP)
    angles = {gait_bag.JOINT: angle.with_rate()}
    angles |= {name: getattr(leg, name).at(angle.stamps).with_rate() for name in ("hip", "ankle") if leg}
    gait = Gait(side, angles, reaction, columns, notes, ground_force, (*assumed, *doubtful, *unusual))
    return gait, facts and facts.weight


def _pose(
    chosen: Reaction, reactions: StorageTable, kinematics: StorageTable, degrees: bool, angle: gait_bag.Signal,
    model: Path | None, work: Path,
) -> tuple[Pose | None, StorageTable, list[str]]:  # fmt: skip
    """Pose of the tibia in the frame of a reaction, if that is another one; the rows that have one, and doubts.

    Raises:
        UsageError: it needs a model that is not given, or does not fit.
    """
    if chosen.on_tibia or chosen.on_femur:
        return None, reactions, []
    if model and (find_spec("opensim") or not chosen.in_femur):
        pose, stamps = legs.tibia_in(chosen, kinematics, degrees, model, reactions.stamps, work)
        return pose, reactions.at(stamps), []
    if not chosen.in_femur:
        raise results.needs_model(reactions, chosen)
    inside = reactions.stamps[(reactions.stamps >= angle.stamps[0]) & (reactions.stamps <= angle.stamps[-1])]
    doubt = (
        f"{reactions.path}: the reaction was turned from {chosen.frame} by the flexion angle alone, as of a hinge, and "
        "its torque is about the point that the file has: --model (with the extra opensim) turns it as the model does"
    )
    return results.hinge(angle, inside), reactions.at(inside), [doubt]


def _doubts(
    angle: gait_bag.Signal, reaction: gait_bag.Signal, files: Files, columns: Mapping[str, str], weight: float | None
) -> tuple[list[str], list[str]]:
    """List what is likely a mistake, and what may be one."""
    if min(len(angle.stamps), len(reaction.stamps)) < 2:
        return [], []
    flexion = Series("angle", files.kinematics, columns["angle"], angle.stamps, angle.values[:, 0])
    axial = columns["reaction"].replace(f"({' '.join(results.AXES)})", "fy")
    load = Series("load", files.reactions, axial, reaction.stamps, -reaction.values[:, 1])
    return checks.doubts(flexion, load, None, weight, results.MAX_GAP, mapped=False), checks.unusual(load, weight)


def show_knee(gait: Gait, weight: float | None, files: Files, bag: Path) -> None:
    """Print a knee's columns, spans, range of the angle, load peaks and notes, and where the bag is."""
    low, high = degrees(gait.angle)
    rows = [
        (f"{gait.side} knee", ""),
        ("angle", f"{gait.columns['angle']} of {files.kinematics.name}"),
        ("", f"{gait.angle.span}, {low:.1f} to {high:.1f} deg"),
        ("reaction", f"{gait.columns['reaction']} of {files.reactions.name}"),
        ("", gait.reaction.span),
    ]
    if gait.ground and files.ground_data:
        (low, high), (down, up) = degrees(gait.joints["hip"]), degrees(gait.joints["ankle"])
        rows += [
            ("ground", f"{gait.columns['ground force']} of {files.ground_data.name}"),
            ("", f"{gait.ground.span}, {gait.ground.values[:, 1].max():.1f} N upwards at most"),
            ("hip", f"{low:.1f} to {high:.1f} deg to the vertical"),
            ("ankle", f"{down:.1f} to {up:.1f} deg"),
        ]
    gait_bag.show([*rows, *([("body weight", f"{weight:.1f} N, of the model's mass")] if weight else [])])
    Console(width=WIDTH, emoji=False).print(peak_table(gait, weight), highlight=False)
    for line in (*(f"- {note}" for note in gait.notes), "", f"Bag: {bag}", ""):
        say(line, hang=2)


def degrees(angle: gait_bag.Signal) -> tuple[float, float]:
    """Smallest and largest angle [deg]."""
    values = np.degrees(angle.values[:, 0])
    return float(values.min()), float(values.max())


def peak_table(gait: Gait, weight: float | None) -> Table:
    """Make a table of the local peaks of the axial load, as `pipeline.gait` finds them, and of its largest value."""
    load, stamps = -gait.reaction.values[:, 1], gait.reaction.stamps
    finder = GaitEvents(weight or USUAL_WEIGHT)
    events = finder.add(stamps, np.zeros_like(load), SHARE * load) + finder.finish()
    local = sorted(event.stamp for event in events if event.kind == LOAD_PEAK)
    peaks = {f"peak {n}": int(np.searchsorted(stamps, stamp)) for n, stamp in enumerate(local, start=1)}
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "axial load [N]", f"x {SHARE:g} [N]", *(["x 0.5 [BW]"] if weight else []), "at [s]"):
        table.add_column(shown(heading), justify="right" if heading else "left", no_wrap=True)
    for name, index in (*peaks.items(), ("largest", int(load.argmax()))):
        half = SHARE * load[index]
        in_weights = [f"{half / weight:.2f}"] if weight else []
        table.add_row(name, f"{load[index]:.1f}", f"{half:.1f}", *in_weights, f"{stamps[index] / NANOSECONDS:.3f}")
    return table


def show_checks(found: Sequence[Check], fault: str = "") -> None:
    """Print residuals, reserves and marker errors with their limits and a conclusion, or `fault` if there are none."""
    console = Console(width=WIDTH, emoji=False)
    if fault:
        console.print(fault, soft_wrap=True, highlight=False, markup=False)
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "peak", "RMS", "allowed", "", ""):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for check in found:
        numbers = (f"{check.peak:.3g}", f"{check.rms:.3g}", f"{check.allowed:.3g}")
        table.add_row(shown(check.name), *numbers, check.unit, "" if check.passed else "ABOVE")
    console.print(table, highlight=False)
    above = ", ".join(check.name for check in found if not check.passed)
    text = "Residuals, reserves and markers are within what the literature allows (doi:10.1115/1.4029304)."
    if above:
        text = (
            "Do not trust these results before you know why these are above what the literature allows "
            f"(doi:10.1115/1.4029304): {above}."
        )
    console.print(text, highlight=False, markup=False)
