"""Run OpenSim's tools from the user's set-up files, one after another, and judge what comes of it.

They run in a copy of the user's folder, each in a process of its own. Residuals, reserves and marker errors are held
against limits of the literature (Hicks, Uchida, Seth, Rajagopal, Delp: Is my model good enough? J Biomech Eng 137(2),
020905, 2015, doi:10.1115/1.4029304): residual forces below 5 % of the peak net external force, residual moments below
1 % of that force times the height of the centre of mass, reserves below 5 % of the peak net joint moment. Markers:
errors below 2 cm RMS and 4 cm at most, as in OpenSim's best practices. A reserve below 1 N m passes, by our own
judgement: joints that carry nothing, as a foot's in swing, have no net moment to compare with.
"""

from __future__ import annotations

import re
import shutil
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.lab.opensim import child, setup_files
from knee_contact_ros.lab.opensim.setup_files import CMC, IK, STATIC, TOOLS, WORDS, Setup, absolute, read_xml, text_in
from knee_contact_ros.lab.tables import Floats, Stamps, Table, read_storage, repaired, text_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.processes import kept, python_module
from knee_contact_ros.system.terminal import Bar

GB = 10**9
LARGEST = 4 * GB
"""Largest size of a folder that is copied [B]"""
STATIC_RATE = 200.0
"""Rate of static optimization in our set-up files [Hz]: forces are smooth in between, and a row takes some 50 ms"""
RESULTS = ("Kinematics_q", "Kinematics_u", "JointReaction_ReactionLoads", "BodyKinematics_pos_global")
"""Results of the joint reactions' step, in the order of the fields of `Run`"""
PATIENCE = 5.0
"""Time that a step has to end [s]"""
MESHES = re.compile(r"mesh|\.vtp|\.stl|\.obj", re.IGNORECASE)
FAILED = re.compile(r"error|exception|fail|unable|not found", re.IGNORECASE)
FORCE_SHARE, MOMENT_SHARE, RESERVE_SHARE = 0.05, 0.01, 0.05
"""Largest residual forces, residual moments and reserves, as shares of the quantities above"""
SMALL_RESERVE = 1.0
"""Reserve that always passes [N m]"""
MARKER_RMS, MARKER_MAX = 20.0, 40.0
"""Largest RMS and largest single marker error [mm]"""
PELVIS = "pelvis"
"""Beginning of the names of coordinates whose actuators are residuals"""
ALWAYS = "knee"
"""Part of the names of reserves that are shown also if they are small"""


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


class Check(NamedTuple):
    """Quantity of a run with its limit."""

    name: str
    peak: float
    rms: float
    allowed: float
    """Limit of the peak"""
    unit: str
    basis: str
    """Text on the origin of the limit"""

    @property
    def passed(self) -> bool:
        """Whether the peak is within the limit."""
        return self.peak <= self.allowed

    def sentence(self) -> str:
        """Describe the quantity, its limit and the verdict in a line."""
        verdict = "within" if self.passed else "ABOVE"
        numbers = f"peak {self.peak:.3g}, RMS {self.rms:.3g} {self.unit}"
        return f"{self.name}: {numbers}, {verdict} {self.allowed:.3g} ({self.basis})"


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
        run_step(setup, work)
        seconds[setup.step] = time.monotonic() - begun

    own = [setup._replace(path=work / absolute(setup.path).relative_to(folder)) for setup in setups]
    for setup in own[:-1]:
        run(setup)
    last, place = own[-1], own[-1].folder
    if last.step == STATIC and last.tool.tag == TOOLS[CMC]:
        stamps = read_storage(place / last.text("desired_kinematics_file")).stamps
        rate = (len(stamps) - 1) * NANOSECONDS / float(stamps[-1] - stamps[0])
        last = own[-1] = setup_files.static_setup(
            last, place / "knee_contact_static.xml", max(1, round(rate / STATIC_RATE))
        )
    run(last)
    forces, states = results_of(last)
    reactions = setup_files.reactions_setup(last, place / "knee_contact_reactions.xml", states, forces)
    run(reactions)
    kinematics, speeds, loads, centre = (
        place / reactions.results() / f"{reactions.name}_{name}.sto" for name in RESULTS
    )
    times = read_storage(kinematics).stamps / NANOSECONDS
    window, coordinates = (float(times[0]), float(times[-1])), str(kinematics.relative_to(place))
    dynamics = setup_files.dynamics_setup(last, place / "knee_contact_dynamics.xml", coordinates, window)
    with suppress(UsageError):  # it only serves to judge; where it is missing, that is said
        run(dynamics)
    moments, model = place / dynamics.results() / "moments.sto", place / last.text("model_file")
    return Run(
        place, last, place / forces, model, kinematics, speeds, loads, centre, moments, seconds, tuple(own)
    )  # fmt: skip


def copy(folder: Path, work: Path) -> None:
    """Copy a folder, make the copy writable even if the original is not, and make a folder for logs in it.

    Raises:
        UsageError: the folder cannot be copied, or is too large.
    """
    visible = (path for path in folder.rglob("[!.]*") if "/." not in str(path.relative_to(folder)))
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


def run_step(setup: Setup, work: Path) -> None:
    """Run the tool of a set-up file in that file's folder, with its output in `work`/logs.

    Raises:
        UsageError: it has failed.
    """
    log = work / "logs" / f"{setup.step}.log"
    if code := run_python(child.__name__, (TOOLS[setup.step], setup.path.name), setup.folder, log):
        raise UsageError(
            f"OpenSim's {setup.step} ({setup.path.name}) failed with code {code}: {last_words(log)}; "
            "--work DIR keeps its log"
        )


def run_python(module: str, arguments: Sequence[str], folder: Path, log: Path) -> int:
    """Run a module in a process of its own, in a folder, with its output in `log`; return its exit code."""
    command = python_module(module, *arguments)
    with log.open("wb") as output, kept(output=output, patience=PATIENCE, cwd=folder, **command) as process:
        return process.wait()


def last_words(log: Path) -> str:
    """Last line of a log that reports a failure, or else its last line."""
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    telling = [line for line in lines if FAILED.search(line) and not MESHES.search(line)]
    return (telling or lines or ["it said nothing"])[-1]


def results_of(muscles: Setup) -> tuple[str, str | None]:
    """Find the files of forces and of states that the muscles' step wrote, relative to its folder.

    CMC's states are copied with a header that OpenSim can read; static optimization may have none.

    Raises:
        UsageError: a file is not there.
    """
    results, place = Path(muscles.results()), muscles.folder
    forces, states = results / f"{muscles.name}_Actuation_force.sto", results / f"{muscles.name}_states.sto"
    if muscles.step == STATIC:
        forces = results / f"{muscles.name}_StaticOptimization_force.sto"
        states = Path(muscles.text("states_file"))
    known = states != Path()
    for name in [forces, states][: 1 + known]:
        if not (place / name).is_file():
            raise UsageError(f"{muscles.step} has not written {name}; for CMC that needs an Actuation analysis")
    if not known:
        return str(forces), None
    fixed = states.with_stem(f"{states.stem}_repaired")
    (place / fixed).write_text(repaired(text_of(place / states), place / states), encoding="utf-8")
    return str(forces), str(fixed)


def assess(run: Run) -> list[Check]:
    """Check residuals, markers and reserves of a run; of the reserves those of the knee and those above their limit.

    Raises:
        UsageError: a file of the run cannot be read.
    """
    forces = read_storage(run.forces)
    residual_forces, residual_moments, reserves = actuators_of(run.muscles, run.folder, forces)
    external = external_peak(run.folder / run.muscles.text("external_loads_file"), run.folder, forces.stamps)
    height = float(read_storage(run.centre_of_mass).column("center_of_mass_Y").mean())
    of_force, of_moment = f"5 % of {external:.0f} N of external force", f"1 % of {external:.0f} N x {height:.2f} m"
    quantities: list[tuple[str, Floats, float, str, str]] = []
    for name, names, allowed, unit, basis in (
        ("residual force", residual_forces, FORCE_SHARE * external, "N", of_force),
        ("residual moment", residual_moments, MOMENT_SHARE * external * height, "N m", of_moment),
    ):
        if names:
            together = np.linalg.norm([forces.column(each) for each in names], axis=0)
            quantities.append((name, together, allowed, unit, basis))
    moments = read_storage(run.moments)
    for name, coordinate in reserves.items():
        if f"{coordinate}_moment" in moments.names:
            peak = float(np.abs(moments.column(f"{coordinate}_moment")).max())
            basis = f"5 % of the net {peak:.3g} N m, at least {SMALL_RESERVE:g}"
            allowed, values = max(RESERVE_SHARE * peak, SMALL_RESERVE), forces.column(name)
            if ALWAYS in coordinate or np.abs(values).max() > allowed:
                quantities.append((f"reserve {coordinate}", values, allowed, "N m", basis))
    for setup in run.setups:
        path = setup.folder / setup.results() / f"{setup.name}_ik_marker_errors.sto"
        if setup.step == IK and path.is_file():
            errors = read_storage(path)
            for name, column, allowed in (("RMS of all", "RMS", MARKER_RMS), ("the worst", "max", MARKER_MAX)):
                values = errors.column(f"marker_error_{column}") * 1e3
                quantities.append((f"marker error, {name}", values, allowed, "mm", "best practices"))
    return [
        Check(name, float(np.abs(values).max()), float(np.sqrt(np.mean(values**2))), allowed, unit, basis)
        for name, values, allowed, unit, basis in quantities
    ]


def actuators_of(muscles: Setup, folder: Path, forces: Table) -> tuple[list[str], list[str], dict[str, str]]:
    """Names of residual forces and moments, and coordinates of reserves by name, in the force set files.

    Raises:
        UsageError: a file cannot be read.
    """
    residual_forces, residual_moments, reserves = [], [], {}
    for file in muscles.text("force_set_files").split():
        for element in read_xml(folder / file).findall(".//objects/*"):
            name, coordinate = element.get("name", ""), text_in(element, "coordinate")
            if name not in forces.names:
                continue
            if element.tag == "PointActuator" or (coordinate.startswith(PELVIS) and coordinate[-3:-1] == "_t"):
                residual_forces.append(name)
            elif element.tag == "TorqueActuator" or coordinate.startswith(PELVIS):
                residual_moments.append(name)
            elif coordinate:
                reserves[name] = coordinate
    return residual_forces, residual_moments, reserves


def external_peak(loads: Path, folder: Path, stamps: Stamps) -> float:
    """Largest net external force [N] between the first and the last stamp.

    Raises:
        UsageError: the loads cannot be read.
    """
    data = read_storage(setup_files.named_data(loads, folder))
    names = [text_in(force, "force_identifier") for force in read_xml(loads, "ExternalLoads").iter("ExternalForce")]
    names = [name for name in names if f"{name}x" in data.names]
    if not names:
        raise UsageError(f"{loads}: no force_identifier of it is in {data.path}")
    net = sum(np.column_stack([data.column(f"{name}{axis}") for axis in "xyz"]) for name in names)
    inside = (data.stamps >= stamps[0]) & (data.stamps <= stamps[-1])
    return float(np.linalg.norm(net, axis=1)[inside].max())
