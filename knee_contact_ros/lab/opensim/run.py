"""Run OpenSim's tools from the user's set-up files, one after another, and judge their results.

A set-up file says which step it is, and what it reads and writes. The tools run in a copy of the user's folder, each in
its own process. Residuals, reserves and marker errors are compared with limits from the literature (Hicks, Uchida,
Seth, Rajagopal, Delp: Is my model good enough? J Biomech Eng 137(2), 020905, 2015, doi:10.1115/1.4029304): residual
forces below 5 % of the peak net external force, residual moments below 1 % of that force times the height of the centre
of mass, reserves below 5 % of the peak net joint moment. Markers: errors below 2 cm RMS and 4 cm at most, as in
OpenSim's best practices. A reserve below 1 N m always passes (our own choice): unloaded joints, such as a foot's in
swing, have no net moment to compare with.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from knee_contact_ros.lab.opensim import child
from knee_contact_ros.lab.tables import Table, read_storage, repaired
from knee_contact_ros.model.types import Floats, Stamps
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require
from knee_contact_ros.system.processes import python_module, running
from knee_contact_ros.system.progress import Bar

XML = ".xml"
NOTHING = {"", "Unassigned", "unassigned"}
"""Texts that mean that a property is not set"""
SCALE, IK, RRA, CMC, STATIC, REACTIONS, DYNAMICS = (
    "scale",
    "ik",
    "rra",
    "cmc",
    "static",
    "reactions",
    "dynamics",
)
TOOLS = {
    SCALE: "ScaleTool",
    IK: "InverseKinematicsTool",
    RRA: "RRATool",
    CMC: "CMCTool",
    STATIC: "AnalyzeTool",
    REACTIONS: "AnalyzeTool",
    DYNAMICS: "InverseDynamicsTool",
}
"""Tool of each step, in the order in which the steps run"""
CHOOSABLE = (SCALE, IK, RRA, CMC, STATIC)
INPUTS = (
    "model_file",
    "marker_set_file",
    "marker_file",
    "force_set_files",
    "external_loads_file",
    "desired_kinematics_file",
    "task_set_file",
    "constraints_file",
    "coordinates_file",
    "coordinate_file",
)
SHARED = (
    "model_file",
    "replace_force_set",
    "force_set_files",
    "external_loads_file",
    "initial_time",
    "final_time",
)
"""Properties that an AnalyzeTool takes from another set-up file"""
STATIC_RATE = 200.0
"""Rate of static optimization in our set-up files [Hz]: forces are smooth in between, and a row takes about 50 ms"""
PATIENCE = 5.0
"""Time that a step may take to end [s]"""
FAILED = re.compile(r"error|exception|fail|unable|not found", re.IGNORECASE)
MESHES = re.compile(r"mesh|\.vtp|\.stl|\.obj", re.IGNORECASE)
FORCE_SHARE, MOMENT_SHARE, RESERVE_SHARE = 0.05, 0.01, 0.05
"""Largest residual forces, residual moments and reserves, as shares of the quantities above"""
SMALL_RESERVE = 1.0
"""Reserve that always passes [N m]"""
MARKERS = {
    "marker error, RMS of all": ("marker_error_RMS", 20.0),
    "marker error, the worst": ("marker_error_max", 40.0),
}
"""Columns of marker errors, and the largest ones [mm]"""
PELVIS = "pelvis"
"""Beginning of the names of coordinates whose actuators are residuals"""
ALWAYS = "knee"
"""Part of the names of reserves that are shown even if they are small"""


class Setup(NamedTuple):
    """Set-up file of a tool. Files are named relative to its folder, in which the tool runs."""

    step: str
    path: Path
    tool: ET.Element
    """The tool's element in the file"""

    @property
    def name(self) -> str:
        """Name of the tool, and prefix of its results."""
        return self.tool.get("name", "")

    @property
    def folder(self) -> Path:
        """Folder in which the tool runs."""
        return self.path.parent

    @property
    def results(self) -> Path:
        """Folder of the results, from `folder`."""
        return Path(self.text("results_directory", "."))

    def text(self, tag: str, default: str = "") -> str:
        """Text of a property, or the default if it is not set."""
        text = text_in(self.tool, f".//{tag}")
        return default if text in NOTHING else text

    def needs(self) -> list[str]:
        """Files that the step reads."""
        texts = [element.text or "" for tag in INPUTS for element in self.tool.iter(tag)]
        return [name for text in texts for name in text.split() if name not in NOTHING]


def read_xml(path: Path, root: str | None = None) -> ET.Element:
    """Root of an OpenSim document, which must have a child `root` if that is given.

    Raises:
        UsageError: the file cannot be read, or is not such a document.
    """
    try:
        document = ET.parse(path).getroot()  # noqa: S314  (a user's own file; expat bounds what entities grow to)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except ET.ParseError as error:
        raise UsageError(f"{path} is not an OpenSim document: {error}") from None
    if root is not None and document.find(root) is None:
        raise UsageError(f"{path} is not an OpenSim {root.lower()} file")
    return document


def text_in(element: ET.Element, tag: str) -> str:
    """Stripped text of a property of an element; empty if it is missing."""
    return (element.findtext(tag) or "").strip()


def data_file(ground: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers: `ground` itself, or the file that it names if it is an external loads file.

    That name is relative to the external loads file, or to `folder`, where OpenSim's tool runs.

    Raises:
        UsageError: the external loads file names no file, or a missing one.
    """
    if ground.suffix.lower() != XML:
        return ground
    name = text_in(read_xml(ground, "ExternalLoads"), ".//datafile")
    if name in NOTHING:
        raise UsageError(f"{ground} names no datafile, which has the numbers")
    there = next(
        (place / name for place in (ground.parent, folder) if place and (place / name).is_file()),
        None,
    )
    if there is None:
        raise UsageError(f"{ground} names the datafile {name}, which is not there")
    return there


def plan(paths: Sequence[Path], steps: Sequence[str]) -> tuple[Path, list[Setup]]:
    """Choose the folder to copy, and the set-up files of the steps to run; the last is CMC or static optimization.

    Without `steps`, all steps with a set-up file run, but static optimization only if there is no CMC.

    Raises:
        UsageError: a file is missing or cannot be used, a step has two files, or OpenSim is not installed.
    """
    there: dict[str, Setup] = {}
    for path in paths:
        if not path.exists():
            raise UsageError(f"--setup {path}: no such file or folder")
        for setup in filter(
            None, map(read_setup, sorted(path.glob("*.xml")) if path.is_dir() else [path])
        ):
            if setup.step in there:
                both = f"{there[setup.step].path.name} and {setup.path.name}"
                raise UsageError(
                    f"--setup: {both} are both for {setup.step}; give the files instead of the folder"
                )
            there[setup.step] = setup
    if not there:
        raise UsageError(
            f"--setup {paths[0]}: no set-up file of a scale, IK, RRA, CMC or static optimization tool"
        )
    if unknown := [step for step in steps if step not in CHOOSABLE]:
        raise UsageError(f"--steps: there is no {unknown[0]}; there are {', '.join(CHOOSABLE)}")
    wanted = list(steps) or [
        step for step in CHOOSABLE if step in there and (step != STATIC or CMC not in there)
    ]
    if (CMC in wanted) == (STATIC in wanted):
        raise UsageError(
            f"--steps {','.join(wanted)}: one of cmc and static must be among them, because it computes the forces"
        )
    if missing := [
        step for step in wanted if step not in there and not (step == STATIC and CMC in there)
    ]:
        raise UsageError(
            f"--setup {paths[0]}: there is no set-up file for {missing[0]}; there are {', '.join(there)}"
        )
    require("opensim", "opensim")
    setups = [
        (there.get(step) or there[CMC])._replace(step=step) for step in CHOOSABLE if step in wanted
    ]
    return _common_folder(setups), setups


def _common_folder(setups: Sequence[Setup]) -> Path:
    """Find the folder that contains the set-up files and all files that they name, as an absolute path."""
    places = [absolute(setup.folder) for setup in setups]
    for setup in setups:
        for name in setup.needs():
            if name.startswith("/") or "\\" in name:
                raise UsageError(
                    f"{setup.path} names {name}; write file names relative to its folder, with /"
                )
            places.append(absolute(setup.folder / name).parent)
    folder = Path(os.path.commonpath(places))
    if folder in {Path(folder.anchor), Path.home()}:
        raise UsageError(
            f"the set-up files and what they name are all over {folder}; put them into a folder of their own"
        )
    return folder


def read_setup(path: Path) -> Setup | None:
    """Read a set-up file; None if the file is not one.

    Raises:
        UsageError: the file cannot be read.
    """
    root = read_xml(path)
    for step in CHOOSABLE:
        tool = root.find(TOOLS[step])
        if tool is not None and (step != STATIC or tool.find(".//StaticOptimization") is not None):
            return Setup(step, path, tool)
    return None


def absolute(path: Path) -> Path:
    """Absolute path without dots; symbolic links are kept."""
    return Path(os.path.abspath(path))  # noqa: PTH100  (resolve would follow links out of the folder)


def static_setup(base: Setup, path: Path, interval: int) -> Setup:
    """Write a set-up file for static optimization of the motion that a CMC set-up tracks, every `interval` rows."""
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    return _write(
        STATIC,
        path,
        f"{base.name}_static",
        {
            **_shared(base, "ResultsStatic"),
            "AnalysisSet": {"objects": {"StaticOptimization": {"step_interval": str(interval)}}},
            "coordinates_file": base.text("desired_kinematics_file"),
            "lowpass_cutoff_frequency_for_coordinates": str(cutoff if cutoff > 0.0 else -1.0),
        },
    )


def reactions_setup(base: Setup, path: Path, states: Path | None, forces: Path) -> Setup:
    """Write a set-up file for joint reactions on child bodies in their frames, kinematics and the centre of mass.

    `forces` has the forces from the muscles' step `base`. `states` is CMC's file of states; without it the coordinates
    of `base` are used.
    """
    cutoff = "lowpass_cutoff_frequency_for_coordinates"
    own = {"coordinates_file": base.text("coordinates_file"), cutoff: base.text(cutoff, "-1")}
    child_frame = {"apply_on_bodies": "child", "express_in_frame": "child"}
    return _write(
        REACTIONS,
        path,
        "knee_contact",
        {
            **_shared(base, "ResultsReactions"),
            "AnalysisSet": {
                "objects": {
                    "Kinematics": {"coordinates": "all", "in_degrees": "true"},
                    "BodyKinematics": {"bodies": "center_of_mass"},
                    "JointReaction": {
                        "forces_file": str(forces),
                        "joint_names": "ALL",
                        **child_frame,
                    },
                }
            },
            **({"states_file": str(states)} if states else own),
        },
    )


def dynamics_setup(
    base: Setup, path: Path, coordinates: str, window: tuple[float, float]
) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, to compare reserves with."""
    return _write(
        DYNAMICS,
        path,
        "knee_contact",
        {
            "results_directory": "ResultsDynamics",
            "model_file": base.text("model_file"),
            "time_range": f"{window[0]} {window[1]}",
            "forces_to_exclude": "Muscles",
            "external_loads_file": base.text("external_loads_file"),
            "coordinates_file": coordinates,
            "lowpass_cutoff_frequency_for_coordinates": "-1",
            "output_gen_force_file": "moments.sto",
        },
    )


def _shared(base: Setup, results: str) -> dict[str, str]:
    """Properties of an AnalyzeTool: model, actuators, loads and times of `base`."""
    own = {"output_precision": "12", "solve_for_equilibrium_for_auxiliary_states": "false"}
    return {tag: base.text(tag) for tag in SHARED} | {"results_directory": results} | own


def _write(step: str, path: Path, name: str, content: Mapping[str, Any]) -> Setup:
    """Write a set-up file of a tool with its properties; a mapping becomes an object with properties."""

    def fill(element: ET.Element, content: Mapping[str, Any]) -> None:
        for tag, value in content.items():
            child = ET.SubElement(element, tag, {} if tag.islower() else {"name": tag})
            if isinstance(value, str):
                child.text = value
            else:
                fill(child, value)

    document = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(document, TOOLS[step], name=name)
    fill(tool, content)
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding="UTF-8", xml_declaration=True)
    return Setup(step, path, tool)


class Run(NamedTuple):
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

    def result(self, name: str) -> Path:
        """File with a result of the joint reaction step."""
        return self.results / f"knee_contact_{name}.sto"


class Check(NamedTuple):
    """Quantity of a run and its limit."""

    name: str
    peak: float
    rms: float
    allowed: float
    """Limit of the peak"""
    unit: str
    basis: str
    """Origin of the limit, as text"""

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
    """Copy `folder` to the new folder `work`, and run the steps, joint reactions and inverse dynamics there.

    Raises:
        UsageError: the folder cannot be copied, or a step failed; its log is in `work`/logs.
    """
    try:
        shutil.copytree(
            folder, work, ignore=shutil.ignore_patterns(".*"), copy_function=shutil.copyfile
        )
        for path in (work, *(path for path in work.rglob("*") if path.is_dir())):
            path.chmod(0o755)  # even if the original cannot be written to
        (work / "logs").mkdir(exist_ok=True)
    except (OSError, shutil.Error) as error:
        raise UsageError(f"cannot copy {folder}: {error}") from None
    seconds: dict[str, float] = {}

    def run(setup: Setup) -> None:
        bar.describe(f"{setup.step} ({len(seconds) + 1} of {len(setups) + 2})")
        begun, log = time.monotonic(), work / "logs" / f"{setup.step}.log"
        if code := run_python(
            child.__name__, (TOOLS[setup.step], setup.path.name), setup.folder, log
        ):
            raise UsageError(
                f"OpenSim's {setup.step} ({setup.path.name}) failed with code {code}: {last_words(log)}; "
                "--work DIR keeps its log"
            )
        seconds[setup.step] = time.monotonic() - begun

    own = [
        setup._replace(path=work / absolute(setup.path).relative_to(folder)) for setup in setups
    ]
    for setup in own[:-1]:
        run(setup)
    last, place = own[-1], own[-1].folder
    if last.step == STATIC and last.tool.tag == TOOLS[CMC]:
        stamps = read_storage(place / last.text("desired_kinematics_file")).stamps
        rate = (len(stamps) - 1) * NANOSECONDS / float(stamps[-1] - stamps[0])
        interval = max(1, round(rate / STATIC_RATE))
        last = own[-1] = static_setup(last, place / "knee_contact_static.xml", interval)
    run(last)
    forces, states = results_of(last)
    reactions = reactions_setup(last, place / "knee_contact_reactions.xml", states, forces)
    run(reactions)
    done = Run(place, last, place / forces, place / reactions.results, Path(), seconds, tuple(own))
    kinematics = done.result("Kinematics_q")
    times = read_storage(kinematics).stamps / NANOSECONDS
    window, coordinates = (float(times[0]), float(times[-1])), str(kinematics.relative_to(place))
    dynamics = dynamics_setup(last, place / "knee_contact_dynamics.xml", coordinates, window)
    with suppress(UsageError):  # it only serves to judge; where it is missing, that is said
        run(dynamics)
    return done._replace(moments=place / dynamics.results / "moments.sto")


def run_python(module: str, arguments: Sequence[str], folder: Path, log: Path) -> int:
    """Run a module in its own process and a folder, with its output in `log`; return the exit code."""
    command = python_module(module, *arguments)
    with (
        log.open("wb") as output,
        running(output=output, patience=PATIENCE, cwd=folder, **command) as process,
    ):
        return process.wait()


def last_words(log: Path) -> str:
    """Last line of a log that reports a failure, or else its last line."""
    lines = [
        line.strip()
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines()
        if line.strip()
    ]
    telling = [line for line in lines if FAILED.search(line) and not MESHES.search(line)]
    return (telling or lines or ["it said nothing"])[-1]


def results_of(muscles: Setup) -> tuple[Path, Path | None]:
    """Find the files of forces and states from the muscles' step, relative to its folder.

    CMC's states are copied with a header that OpenSim can read; static optimization may have none.

    Raises:
        UsageError: a file is missing.
    """
    begin = muscles.results / muscles.name
    forces, states = Path(f"{begin}_Actuation_force.sto"), Path(f"{begin}_states.sto")
    if muscles.step == STATIC:
        forces, states = (
            Path(f"{begin}_StaticOptimization_force.sto"),
            Path(muscles.text("states_file")),
        )
    known = states != Path()
    for name in [forces, states][: 1 + known]:
        if not (muscles.folder / name).is_file():
            raise UsageError(
                f"{muscles.step} has not written {name}; for CMC that needs an Actuation analysis"
            )
    if not known:
        return forces, None
    fixed = states.with_stem(f"{states.stem}_repaired")
    (muscles.folder / fixed).write_text(repaired(muscles.folder / states), encoding="utf-8")
    return forces, fixed


def assess(run: Run) -> list[Check]:
    """Check residuals, markers and reserves of a run; lists only reserves of the knee or above their limit.

    Raises:
        UsageError: a file of the run cannot be read.
    """
    forces = read_storage(run.forces)
    residual_forces, residual_moments, reserves = actuators_of(run.muscles, run.folder, forces)
    external = external_peak(
        run.folder / run.muscles.text("external_loads_file"), run.folder, forces.stamps
    )
    height = float(
        read_storage(run.result("BodyKinematics_pos_global")).column("center_of_mass_Y").mean()
    )
    of_force, of_moment = (
        f"5 % of {external:.0f} N of external force",
        f"1 % of {external:.0f} N x {height:.2f} m",
    )
    found: list[Check] = []

    def check(name: str, values: Floats, allowed: float, unit: str, basis: str) -> None:
        peak, rms = float(np.abs(values).max()), float(np.sqrt(np.mean(values**2)))
        if not name.startswith("reserve") or ALWAYS in name or peak > allowed:
            found.append(Check(name, peak, rms, allowed, unit, basis))

    for name, names, allowed, unit, basis in (
        ("residual force", residual_forces, FORCE_SHARE * external, "N", of_force),
        ("residual moment", residual_moments, MOMENT_SHARE * external * height, "N m", of_moment),
    ):
        if names:
            check(
                name,
                np.linalg.norm([forces.column(each) for each in names], axis=0),
                allowed,
                unit,
                basis,
            )
    moments = read_storage(run.moments)
    for name, coordinate in reserves.items():
        if f"{coordinate}_moment" in moments.names:
            peak = float(np.abs(moments.column(f"{coordinate}_moment")).max())
            basis = f"5 % of the net {peak:.3g} N m, at least {SMALL_RESERVE:g}"
            allowed = max(RESERVE_SHARE * peak, SMALL_RESERVE)
            check(f"reserve {coordinate}", forces.column(name), allowed, "N m", basis)
    for setup in run.setups:
        path = setup.folder / setup.results / f"{setup.name}_ik_marker_errors.sto"
        if setup.step == IK and path.is_file():
            for name, (column, allowed) in MARKERS.items():
                check(
                    name, read_storage(path).column(column) * 1e3, allowed, "mm", "best practices"
                )
    return found


def verdict(found: Sequence[Check]) -> list[str]:
    """Lines with residuals, reserves and marker errors, their limits, and a conclusion."""
    above = ", ".join(check.name for check in found if not check.passed)
    text = "Residuals, reserves and markers are within the limits in the literature (doi:10.1115/1.4029304)."
    if above:
        text = (
            "Do not trust these results before you know why these values exceed the limits in the literature "
            f"(doi:10.1115/1.4029304): {above}."
        )
    return [*(f"- {check.sentence()}" for check in found), text]


def actuators_of(
    muscles: Setup, folder: Path, forces: Table
) -> tuple[list[str], list[str], dict[str, str]]:
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
            if element.tag == "PointActuator" or (
                coordinate.startswith(PELVIS) and coordinate[-3:-1] == "_t"
            ):
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
    data = read_storage(data_file(loads, folder))
    names = [
        text_in(force, "force_identifier")
        for force in read_xml(loads, "ExternalLoads").iter("ExternalForce")
    ]
    names = [name for name in names if f"{name}x" in data.names]
    if not names:
        raise UsageError(f"{loads}: no force_identifier of it is in {data.path}")
    net = sum(np.column_stack([data.column(f"{name}{axis}") for axis in "xyz"]) for name in names)
    inside = (data.stamps >= stamps[0]) & (data.stamps <= stamps[-1])
    return float(np.linalg.norm(net, axis=1)[inside].max())
