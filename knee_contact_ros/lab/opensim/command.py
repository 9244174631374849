"""The work of `knee-contact import-opensim`: run OpenSim if requested, read one knee or both, write bags, print."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros import __version__
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.lab.gait_bag import (
    LEG_QUANTITIES,
    QUANTITIES,
    Angles,
    Leg,
    Reactions,
    check_output,
    common_window,
    cut,
    digest,
    leg_at,
    resample,
    with_rate,
    write_bag,
)
from knee_contact_ros.lab.opensim.leg import LegGait, data_file, leg_joints, read_ground, read_leg
from knee_contact_ros.lab.opensim.pipeline import WORDS, Check, Run, assess, check_opensim, plan, run_pipeline
from knee_contact_ros.lab.opensim.results import (
    AXES,
    DEGREES,
    LEFT,
    RIGHT,
    Settings,
    angle_column,
    coordinate_of,
    find_reaction,
    read_angles,
    read_model,
    read_wrenches,
    unit_of,
)
from knee_contact_ros.lab.tables import Stamps, Storage, read_storage
from knee_contact_ros.streams.gait_events import LOAD_PEAK, GaitEvents
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import WIDTH, progress, say, shown


@dataclass(frozen=True)
class Files:
    """Files to read."""

    kinematics: Path
    reactions: Path
    speeds: Path | None = None
    model: Path | None = None
    ground: Path | None = None
    """External loads file, or ground reactions with names that tell the foot; None: no leg's sensors are simulated"""
    ground_data: Path | None = None
    """File with the numbers of `ground`"""


class KneeGait(NamedTuple):
    """Gait of a knee, with its origin."""

    side: str
    angles: Angles
    reactions: Reactions
    columns: dict[str, str]
    """Names of the columns, by quantity"""
    notes: tuple[str, ...]
    """What was converted or left out, as sentences"""
    body_weight: float | None
    """Weight of the model [N]; None: no model is given"""
    leg: Leg | None = None
    """Measurements of the leg's simulated sensors; None: no ground reactions are given"""


def read_knee(side: str, files: Files, settings: Settings, work: Path | None = None) -> KneeGait:
    """Read a knee's gait, and with ground reactions that of its leg, for which OpenSim runs in the folder `work`.

    Raises:
        UsageError: a file cannot be used, a column is missing, or unit, sign or frame are wrong or not clear.
    """
    for name in ("start", "end", "rate"):
        value = getattr(settings, name)
        if value is not None and not math.isfinite(value):
            raise UsageError(f"--{name} {value}: it must be a finite number")
    kinematics, reactions = read_storage(files.kinematics), read_storage(files.reactions)
    column = angle_column(kinematics, side, settings.coordinate)
    facts = read_model(files.model, coordinate_of(column)) if files.model else None
    angles, angle_notes = read_angles(kinematics, column, files.speeds, settings, facts.bounds if facts else None)
    chosen = find_reaction(reactions, side, settings.joint)
    wrenches, wrench_notes = read_wrenches(reactions, chosen, side)
    leg = read_sensors(kinematics, column, side, files, settings, work) if files.ground else None
    ground_stamps = leg.leg.ground.stamps if leg else None
    window = common_window(angles, wrenches, settings.start, settings.end, ground_stamps)
    rows = len(wrenches.stamps)
    if settings.rate:
        angles, wrenches = resample(angles, wrenches, window, settings.rate)
        window_notes = [f"{'all' if leg else 'both'} interpolated linearly at {settings.rate:g} Hz"]
    else:
        angles, wrenches = cut(angles, wrenches, window)
        outside = rows - len(wrenches.stamps)
        left_out = f"{outside} reactions left out: no angle at their time, or outside --start and --end"
        window_notes = [left_out] if outside > 0 else []
    columns = {"angle": column, "reaction": chosen.prefix + f"({' '.join(AXES)})"}
    columns |= {"ground force": leg.columns} if leg else {}
    return KneeGait(
        side,
        with_rate(angles),
        wrenches,
        columns,
        (*angle_notes, *wrench_notes, *(leg.notes if leg else ()), *window_notes),
        facts.mass * GRAVITY if facts else None,
        leg_within(leg.leg, angles.stamps, window, settings) if leg else None,
    )


def read_sensors(
    kinematics: Storage, column: str, side: str, files: Files, settings: Settings, work: Path | None
) -> LegGait:
    """Simulate the leg's sensors; `column` is that of the knee's angle in the kinematics.

    Raises:
        UsageError: OpenSim is not installed or fails, or a file cannot be used or does not fit the others.
    """
    assert files.ground is not None  # noqa: S101  (the caller has looked)
    if files.model is None:
        raise UsageError("--ground needs --model M.osim, which tells where the ankle is")
    if work is None:
        raise UsageError("ground reactions need a folder to work in")
    ground = read_ground(files.ground, files.ground_data or data_file(files.ground), side)
    joints = leg_joints(files.model, side, coordinate_of(column))
    degrees = unit_of(kinematics, column, settings.angle_unit) == DEGREES
    return read_leg(ground, kinematics, degrees, files.model, joints, work)


def leg_within(leg: Leg, stamps: Stamps, window: tuple[int, int], settings: Settings) -> Leg:
    """Interpolate a leg at the stamps of the knee's angles, shape (n,); without a rate, ground forces keep theirs."""
    own = leg.ground.stamps
    return leg_at(leg, stamps, stamps if settings.rate else own[(own >= window[0]) & (own <= window[1])])


BOTH = "both"
LOADS = "external_loads_file"
RUN = "opensim"
"""Name of the run's folder in the work folder"""


class Pipeline(NamedTuple):
    """Steps of OpenSim to run."""

    setups: tuple[Path, ...]
    """Set-up files, or the folder that has them"""
    steps: tuple[str, ...]
    """Names of steps; empty: all that have a set-up file"""
    work: Path | None
    """Folder in which to keep logs and all results; None: they are not kept"""


def import_opensim(side: str, options: dict[str, Any], output: Path, overwrite: bool) -> None:
    """Import results of OpenSim, or run OpenSim first; `options` are the other options of the command, by name.

    Raises:
        UsageError: options exclude each other or are missing, or `import_run` or `import_results` raises it.
    """
    rest = options | {"rate": options["rate"] or None}
    pipeline = Pipeline(rest.pop("setups"), tuple(filter(None, rest.pop("steps").split(","))), rest.pop("work"))
    results = {name: rest.pop(name) for name in ("kinematics", "reactions", "speeds", "model")}
    ground = rest.pop("ground")
    sign = rest.pop("angle_sign")
    settings = Settings(**rest, angle_sign=None if sign == "auto" else int(sign))
    given = [f"--{name}" for name, path in results.items() if path is not None]
    if pipeline.setups:
        if given:
            raise UsageError(f"{given[0]} and --setup exclude each other: OpenSim's run gives its own")
        import_run(side, pipeline, settings, output, overwrite, ground)
        return
    if ground is not None:
        results |= ground_files(ground, results["model"])
    if pipeline.steps or pipeline.work:
        raise UsageError("--steps and --work need --setup")
    for name in ("kinematics", "reactions"):
        if results[name] is None:
            raise UsageError(f"--{name} FILE is missing; or give --setup FOLDER, and OpenSim is run")
    import_results(side, Files(**results), settings, output, overwrite)


def ground_files(ground: str, model: Path | None) -> dict[str, Path]:
    """Ground reactions that --ground names, and the file with their numbers, by the names of the fields of `Files`.

    Raises:
        UsageError: no file or no model is given, a file cannot be used, or OpenSim is not installed.
    """
    if not ground:
        raise UsageError("--ground FILE is missing; only with --setup it is found")
    if model is None:
        raise UsageError("--ground needs --model M.osim, which tells where the ankle is")
    check_opensim()
    return {"ground": Path(ground), "ground_data": data_file(Path(ground))}


def ground_of_run(ground: str, run: Run) -> dict[str, Path]:
    """Ground reactions that --ground names, or else external loads of a run, by the names of the fields of `Files`.

    Raises:
        UsageError: a file cannot be used.
    """
    loads = Path(ground) if ground else run.folder / run.muscles.text(LOADS)
    return {"ground": loads, "ground_data": data_file(loads, None if ground else run.folder)}


def import_run(
    side: str, pipeline: Pipeline, settings: Settings, output: Path, overwrite: bool, ground: str | None = None
) -> None:
    """Run OpenSim's tools in a copy of the set-up files' folder, and import their results.

    With `ground` the leg's sensors are simulated too, from this file of ground reactions or, if empty, the set-up's.

    Raises:
        UsageError: a file or the output cannot be used, or a step has failed; no bag is then written.
    """
    bags = outputs(side, output, settings, overwrite)
    folder, setups = plan(pipeline.setups, pipeline.steps)
    if pipeline.work and pipeline.work.exists():
        raise UsageError(f"--work {pipeline.work} exists already; give a new folder")
    if ground:
        data_file(Path(ground))
    elif ground is not None and not setups[-1].text(LOADS):
        raise UsageError(f"--ground: {setups[-1].path} has no {LOADS}; give --ground FILE")
    with work_folder(output.parent) as work:
        with progress("OpenSim") as bar:
            run = run_pipeline(folder, setups, (pipeline.work or work / RUN).resolve(), bar)
        checks, fault = judge(run)
        of_ground = ground_of_run(ground, run) if ground is not None else {}
        files = Files(run.kinematics, run.reactions, run.speeds, run.model, **of_ground)
        more = {"source": f"OpenSim {version('opensim')}", **run_record(run, checks, fault)}
        store([read_knee(name, files, settings, work) for name in bags], files, settings, bags, work, more)
    show_steps(run)
    show_checks(checks, fault)


def judge(run: Run) -> tuple[list[Check], str]:
    """Check a run; if that fails return no checks and the reason, as hours of computing are not given up for that."""
    try:
        return assess(run), ""
    except UsageError as fault:
        return [], f"Residuals and reserves could not be judged: {fault}"


def run_record(run: Run, checks: Sequence[Check], fault: str) -> dict[str, str]:
    """Entries of the metadata record on a run: its steps with their set-up files, and its checks."""
    steps = [f"{setup.step}: {setup.path.name} {digest(setup.path)}" for setup in run.setups]
    return {"steps": "\n".join(steps), "quality": "\n".join(check.sentence() for check in checks) or fault}


def import_results(side: str, files: Files, settings: Settings, output: Path, overwrite: bool) -> None:
    """Write the bag of a knee, or with the side `both` a bag for each, and print a summary.

    Raises:
        UsageError: a file or the output cannot be used; nothing is then written.
    """
    bags = outputs(side, output, settings, overwrite)
    with work_folder(output.parent) as work:
        knees = [read_knee(name, files, settings, work) for name in bags]
        store(knees, files, settings, bags, work, {})


def store(
    knees: Sequence[KneeGait],
    files: Files,
    settings: Settings,
    bags: Mapping[str, Path],
    work: Path,
    more: dict[str, str],
) -> None:
    """Write bags by way of the folder `work`, and print a summary; `more` is added to the metadata record."""
    for knee in knees:
        origin = origin_record(knee, files, settings, more)
        write_bag(knee.side, knee.angles, knee.reactions, work / bags[knee.side].name, origin, leg=knee.leg)
    for bag in bags.values():
        replace(work / bag.name, bag)
    for knee in knees:
        show_knee(knee, files, bags[knee.side])


def origin_record(gait: KneeGait, files: Files, settings: Settings, more: dict[str, str]) -> dict[str, str]:
    """Content of the bag's metadata record; nothing in it depends on where or when it is written."""
    record = {"package": f"knee_contact_ros {__version__}", "source": "OpenSim results", "side": gait.side}
    for name, path in asdict(files).items():
        if path is not None:
            record |= {name: path.name, f"{name}_sha256": digest(path)}
    record |= {f"column of {what}": name for what, name in gait.columns.items()}
    record |= {"conversions": "\n".join(gait.notes), "settings": json.dumps(asdict(settings)), **QUANTITIES}
    if gait.leg:
        record |= LEG_QUANTITIES
    if gait.body_weight:
        record["body_weight"] = f"{gait.body_weight:.3f} N"
    return record | more


def outputs(side: str, output: Path, settings: Settings, overwrite: bool) -> dict[str, Path]:
    """Paths of the bags by side: OUTPUT, or OUTPUT_right and OUTPUT_left for both.

    Raises:
        UsageError: a bag exists already, or --joint or --coordinate is given for both sides.
    """
    if side == BOTH and (settings.joint or settings.coordinate):
        raise UsageError("--joint and --coordinate name one knee's; give --side right or left with them")
    bags = {side: output}
    if side == BOTH:
        bags = {name: output.with_name(f"{output.name}_{name}") for name in (RIGHT, LEFT)}
    for bag in bags.values():
        check_output(bag, overwrite)
    return bags


USUAL_WEIGHT = 737.068
"""Body weight for the search for peaks where no model is given [N]: the default of `body_weight`"""
SHARE = 0.5
"""Share of the axial load that a compartment has by default (`load.share`)"""


def show_knee(knee: KneeGait, files: Files, bag: Path) -> None:
    """Print a knee's columns, spans, range of the angle, load peaks and notes, and where the bag is."""
    console = Console(width=WIDTH, emoji=False)
    degrees = np.degrees(knee.angles.angle)
    rows = Table(box=None, show_header=False, pad_edge=False)
    rows.add_column(no_wrap=True)
    rows.add_column(overflow="fold")
    rows.add_row(f"{knee.side} knee", "")
    rows.add_row("angle", shown(f"{knee.columns['angle']} of {files.kinematics.name}"))
    rows.add_row("", f"{span(knee.angles.stamps)}, {degrees.min():.1f} to {degrees.max():.1f} deg")
    rows.add_row("reaction", shown(f"{knee.columns['reaction']} of {files.reactions.name}"))
    rows.add_row("", span(knee.reactions.stamps))
    if knee.leg:
        add_leg(rows, knee, knee.leg, files)
    if knee.body_weight:
        rows.add_row("body weight", f"{knee.body_weight:.1f} N, of the model's mass")
    console.print(rows, highlight=False)
    console.print(peak_table(knee), highlight=False)
    for line in (*(f"- {note}" for note in knee.notes), "", f"Bag: {bag}", ""):
        say(line, hang=2)


def add_leg(rows: Table, knee: KneeGait, leg: Leg, files: Files) -> None:
    """Add rows on the leg's simulated sensors."""
    hip, ankle = (np.degrees(angles.angle) for angles in (leg.hip, leg.ankle))
    rows.add_row("ground", shown(f"{knee.columns['ground force']} of {(files.ground_data or files.reactions).name}"))
    rows.add_row("", f"{span(leg.ground.stamps)}, {leg.ground.force[:, 1].max():.1f} N upwards at most")
    rows.add_row("hip", f"{hip.min():.1f} to {hip.max():.1f} deg to the vertical")
    rows.add_row("ankle", f"{ankle.min():.1f} to {ankle.max():.1f} deg")


def span(stamps: Stamps) -> str:
    """Text with the number of rows and their first and last time."""
    return f"{len(stamps)} rows, {stamps[0] / NANOSECONDS:.3f} to {stamps[-1] / NANOSECONDS:.3f} s"


def peak_table(knee: KneeGait) -> Table:
    """Make a table of the local peaks of the axial load, and of its largest value."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    weight = knee.body_weight
    for heading in ("", "axial load [N]", f"x {SHARE:g} [N]", *(["x 0.5 [BW]"] if weight else []), "at [s]"):
        table.add_column(shown(heading), justify="right" if heading else "left", no_wrap=True)
    for name, index in peaks(knee).items():
        load = -float(knee.reactions.force[index, 1])
        in_weights = [f"{SHARE * load / weight:.2f}"] if weight else []
        at = f"{knee.reactions.stamps[index] / NANOSECONDS:.3f}"
        table.add_row(name, f"{load:.1f}", f"{SHARE * load:.1f}", *in_weights, at)
    return table


def peaks(knee: KneeGait) -> dict[str, int]:
    """Indices of the local peaks of the load, as `pipeline.gait` finds them, and of the largest load, by name."""
    load, stamps = -knee.reactions.force[:, 1], knee.reactions.stamps
    finder = GaitEvents(knee.body_weight or USUAL_WEIGHT)
    events = finder.add(stamps, np.zeros_like(load), SHARE * load) + finder.finish()
    local = sorted(event.stamp for event in events if event.kind == LOAD_PEAK)
    numbered = {f"peak {n}": int(np.searchsorted(stamps, stamp)) for n, stamp in enumerate(local, start=1)}
    return numbered | {"largest": int(load.argmax())}


def show_steps(run: Run) -> None:
    """Print the duration of each step of a run."""
    console = Console(width=WIDTH, emoji=False)
    took = ", ".join(f"{WORDS[step].lower()} {seconds:.1f} s" for step, seconds in run.seconds.items())
    console.print(f"OpenSim: {took}", highlight=False, markup=False)


def show_checks(checks: Sequence[Check], fault: str = "") -> None:
    """Print residuals, reserves and marker errors with their limits and a conclusion, or `fault` if there are none."""
    console = Console(width=WIDTH, emoji=False)
    if fault:
        console.print(fault, soft_wrap=True, highlight=False, markup=False)
        return
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "peak", "RMS", "allowed", "", ""):
        table.add_column(heading, justify="right" if heading else "left", overflow="fold")
    for check in checks:
        verdict = "" if check.passed else "ABOVE"
        numbers = (f"{check.peak:.3g}", f"{check.rms:.3g}", f"{check.allowed:.3g}")
        table.add_row(shown(check.name), *numbers, check.unit, verdict)
    console.print(table, highlight=False)
    above = [check.name for check in checks if not check.passed]
    text = "Residuals, reserves and markers are within what the literature allows (doi:10.1115/1.4029304)."
    if above:
        text = (
            f"Do not trust these results before you know why these are above what the literature allows "
            f"(doi:10.1115/1.4029304): {', '.join(above)}."
        )
    console.print(text, highlight=False, markup=False)
