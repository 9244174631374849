"""The work of `knee-contact import-opensim`: run OpenSim if asked to, read one knee or both, write the bags, print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.offline.gait_files.gait_bag import check_output, digest, write_bag
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.terminal import progress
from knee_contact_ros.system.work_folder import replace, work_folder
from knee_contact_ros.tools.opensim.columns import LEFT, RIGHT
from knee_contact_ros.tools.opensim.external_loads import data_file
from knee_contact_ros.tools.opensim.opensim_pipeline import Run, opensim_version, plan, run_pipeline
from knee_contact_ros.tools.opensim.opensim_process import check_opensim
from knee_contact_ros.tools.opensim.opensim_quality import Check, assess
from knee_contact_ros.tools.opensim.opensim_results import Files, KneeGait, Settings, read_knee
from knee_contact_ros.tools.opensim.origin import origin_record
from knee_contact_ros.tools.opensim.show import show_checks, show_knee, show_steps

BOTH = "both"
LOADS = "external_loads_file"
RUN = "opensim"
"""Folder of the run in the work folder"""


class Pipeline(NamedTuple):
    """What to run."""

    setups: tuple[Path, ...]
    """Set-up files, or the folder that has them"""
    steps: tuple[str, ...]
    """Names of steps; empty: all that there are"""
    work: Path | None
    """Where to keep logs and all results; None: nowhere"""


def import_opensim(side: str, options: dict[str, Any], output: Path, overwrite: bool) -> None:
    """Do what the command line asks for; `options` are those of the command `import-opensim`.

    Raises:
        UsageError: they do not fit together; and see `import_run` and `import_results`.
    """
    left = options | {"rate": options["rate"] or None}
    pipeline = Pipeline(left.pop("setups"), tuple(filter(None, left.pop("steps").split(","))), left.pop("work"))
    results = {name: left.pop(name) for name in ("kinematics", "reactions", "speeds", "model")}
    ground = left.pop("ground")
    sign = left.pop("angle_sign")
    settings = Settings(**left, angle_sign=None if sign == "auto" else int(sign))
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
    """Ground reactions, as --ground names them, and the file with their numbers, by the names of `Files`.

    Raises:
        UsageError: no name or no model is given, a file cannot be used, or OpenSim is not installed.
    """
    if not ground:
        raise UsageError("--ground FILE is missing; only with --setup it is found")
    if model is None:
        raise UsageError("--ground needs --model M.osim, which tells where the ankle is")
    check_opensim()
    return {"ground": Path(ground), "ground_data": data_file(Path(ground))}


def ground_of_run(ground: str, run: Run) -> dict[str, Path]:
    """Likewise after a run, whose external loads are taken if --ground names none.

    Raises:
        UsageError: a file cannot be used.
    """
    loads = Path(ground) if ground else run.folder / run.muscles.text(LOADS)
    return {"ground": loads, "ground_data": data_file(loads, None if ground else run.folder)}


def import_run(
    side: str, pipeline: Pipeline, settings: Settings, output: Path, overwrite: bool, ground: str | None = None
) -> None:
    """Run OpenSim's tools in a copy of the set-up files' folder, and import what comes of it.

    With `ground` the leg's sensors too: of this file with ground reactions or, if it is empty, of the set-up's own.

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
        more = {"source": opensim_version(), **run_record(run, checks, fault)}
        store([read_knee(name, files, settings, work) for name in bags], files, settings, bags, work, more)
    show_steps(run)
    show_checks(checks, fault)


def judge(run: Run) -> tuple[list[Check], str]:
    """Checks of a run; or none, and why: hours of computing are not given up for that."""
    try:
        return assess(run), ""
    except UsageError as fault:
        return [], f"Residuals and reserves could not be judged: {fault}"


def run_record(run: Run, checks: Sequence[Check], fault: str) -> dict[str, str]:
    """For the metadata record: steps with their set-up files, and how far the run can be trusted."""
    steps = [f"{setup.step}: {setup.path.name} {digest(setup.path)}" for setup in run.setups]
    return {"steps": "\n".join(steps), "quality": "\n".join(check.sentence() for check in checks) or fault}


def import_results(side: str, files: Files, settings: Settings, output: Path, overwrite: bool) -> None:
    """Write the bag of a knee, or with `both` a bag for each, and print what is in them.

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
    """Write bags by way of the folder `work`, and print what is in them; `more` goes into the metadata record."""
    for knee in knees:
        origin = origin_record(knee, files, settings, more)
        write_bag(knee.side, knee.angles, knee.reactions, work / bags[knee.side].name, origin, leg=knee.leg)
    for bag in bags.values():
        replace(work / bag.name, bag)
    for knee in knees:
        show_knee(knee, files, bags[knee.side])


def outputs(side: str, output: Path, settings: Settings, overwrite: bool) -> dict[str, Path]:
    """The bags by side: OUTPUT, or OUTPUT_right and OUTPUT_left.

    Raises:
        UsageError: one is there already, or --joint or --coordinate is to be of both sides.
    """
    if side == BOTH and (settings.joint or settings.coordinate):
        raise UsageError("--joint and --coordinate name one knee's; give --side right or left with them")
    bags = {side: output}
    if side == BOTH:
        bags = {name: output.with_name(f"{output.name}_{name}") for name in (RIGHT, LEFT)}
    for bag in bags.values():
        check_output(bag, overwrite)
    return bags
