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
from knee_contact_ros.tools.opensim.opensim_pipeline import Run, opensim_version, plan, run_pipeline
from knee_contact_ros.tools.opensim.opensim_quality import Check, assess
from knee_contact_ros.tools.opensim.opensim_results import Files, KneeGait, Settings, read_knee
from knee_contact_ros.tools.opensim.origin import origin_record
from knee_contact_ros.tools.opensim.show import show_checks, show_knee, show_steps

BOTH = "both"
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
    """Do what the command line asks for; `options` are those of `opensim_results_options` and `opensim_run_options`.

    Raises:
        UsageError: they do not fit together; and see `import_run` and `import_results`.
    """
    left = options | {"rate": options["rate"] or None}
    pipeline = Pipeline(left.pop("setups"), tuple(filter(None, left.pop("steps").split(","))), left.pop("work"))
    results = {name: left.pop(name) for name in ("kinematics", "reactions", "speeds", "model")}
    sign = left.pop("angle_sign")
    settings = Settings(**left, angle_sign=None if sign == "auto" else int(sign))
    given = [f"--{name}" for name, path in results.items() if path is not None]
    if pipeline.setups:
        if given:
            raise UsageError(f"{given[0]} and --setup exclude each other: OpenSim's run gives its own")
        import_run(side, pipeline, settings, output, overwrite)
        return
    if pipeline.steps or pipeline.work:
        raise UsageError("--steps and --work need --setup")
    for name in ("kinematics", "reactions"):
        if results[name] is None:
            raise UsageError(f"--{name} FILE is missing; or give --setup FOLDER, and OpenSim is run")
    import_results(side, Files(**results), settings, output, overwrite)


def import_run(side: str, pipeline: Pipeline, settings: Settings, output: Path, overwrite: bool) -> None:
    """Run OpenSim's tools in a copy of the set-up files' folder, and import what comes of it.

    Raises:
        UsageError: a file or the output cannot be used, or a step has failed; no bag is then written.
    """
    bags = outputs(side, output, settings, overwrite)
    folder, setups = plan(pipeline.setups, pipeline.steps)
    if pipeline.work and pipeline.work.exists():
        raise UsageError(f"--work {pipeline.work} exists already; give a new folder")
    with work_folder(output.parent) as work:
        with progress("OpenSim") as bar:
            run = run_pipeline(folder, setups, (pipeline.work or work / RUN).resolve(), bar)
        checks, fault = judge(run)
        files = Files(run.kinematics, run.reactions, run.speeds, run.model)
        more = {"source": opensim_version(), **run_record(run, checks, fault)}
        store([read_knee(name, files, settings) for name in bags], files, settings, bags, work, more)
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
    knees = [read_knee(name, files, settings) for name in bags]
    with work_folder(output.parent) as work:
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
        write_bag(knee.side, knee.angles, knee.reactions, work / bags[knee.side].name, origin)
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
