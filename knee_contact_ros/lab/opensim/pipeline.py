"""Run OpenSim's tools from the user's set-up files, one after another, and judge what comes of it.

They run in a copy of the user's folder, each in a process of its own. Residuals, reserves and marker errors are held
against limits of the literature (Hicks, Uchida, Seth, Rajagopal, Delp: Is my model good enough? J Biomech Eng 137(2),
020905, 2015, doi:10.1115/1.4029304): residual forces below 5 % of the peak net external force, residual moments below
1 % of that force times the height of the centre of mass, reserves below 5 % of the peak net joint moment. Markers:
errors below 2 cm RMS and 4 cm at most, as in OpenSim's best practices. A reserve below 1 N m passes, by our own
judgement: joints that carry nothing, as a foot's in swing, have no net moment to compare with.
"""

from __future__ import annotations

import os
import posixpath
import re
import shutil
import stat
import subprocess
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from knee_contact_ros.lab.opensim import child
from knee_contact_ros.lab.tables import Floats, Stamps, Table, read_storage, repaired, text_of
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require
from knee_contact_ros.system.processes import kept, python_module
from knee_contact_ros.system.terminal import Bar

NOTHING = {"", "Unassigned", "unassigned"}
"""Texts of properties that are not set"""
SCALE, IK, RRA, CMC, STATIC, REACTIONS, DYNAMICS = "scale", "ik", "rra", "cmc", "static", "reactions", "dynamics"
TOOLS = {
    SCALE: "ScaleTool", IK: "InverseKinematicsTool", RRA: "RRATool", CMC: "CMCTool", STATIC: "AnalyzeTool",
    REACTIONS: "AnalyzeTool", DYNAMICS: "InverseDynamicsTool",
}  # fmt: skip
"""Tool of each step, in the order in which the steps run"""
CHOOSABLE = (SCALE, IK, RRA, CMC, STATIC)
WORDS = {
    SCALE: "Scaling", IK: "Inverse kinematics", RRA: "Residual reduction", CMC: "Computed muscle control",
    STATIC: "Static optimization", REACTIONS: "Joint reactions", DYNAMICS: "Inverse dynamics",
}  # fmt: skip
INPUTS = (
    "model_file", "marker_set_file", "marker_file", "force_set_files", "external_loads_file", "desired_kinematics_file",
    "task_set_file", "constraints_file", "coordinates_file", "coordinate_file", "datafile",
)  # fmt: skip
SHARED = (
    "model_file", "replace_force_set", "force_set_files", "external_loads_file", "initial_time", "final_time",
)  # fmt: skip
"""Properties that an AnalyzeTool takes from another set-up file"""
OUTPUTS = ("output_model_file", "output_motion_file", "output_marker_file")
GB = 10**9
LARGEST = 4 * GB
"""Largest size of a folder that is copied [B]"""
STATIC_RATE = 200.0
"""Rate of static optimization in our set-up files [Hz]: forces are smooth in between, and a row takes some 50 ms"""
RESULTS = ("Kinematics_q", "Kinematics_u", "JointReaction_ReactionLoads", "BodyKinematics_pos_global")
"""Results of the joint reactions' step, in the order of the fields of `Run`"""
PERIOD = 0.2
"""Period of the checks on a running step [s]"""
PATIENCE = 5.0
"""Time that a step has to end [s]"""
TAIL = 4096
"""Number of bytes at the end of a log in which its last time is looked for"""
TIMES = re.compile(rb"\bt(?:ime)? = ([0-9.eE+-]+)")
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


class Setup(NamedTuple):
    """Set-up file of a tool. Files are named relative to `folder`, in which the tool runs."""

    step: str
    path: Path
    tool: ET.Element
    """The tool's element in the file"""

    @property
    def name(self) -> str:
        """Name of the tool, with which the names of its results begin."""
        return self.tool.get("name", "")

    def text(self, tag: str, default: str = "") -> str:
        """Text of a property, or the default if it is not set."""
        text = text_in(self.tool, f".//{tag}")
        return default if text in NOTHING else text

    @property
    def folder(self) -> Path:
        """Folder in which the tool runs."""
        return self.path.parent

    def results(self) -> str:
        """Folder of the results."""
        return posixpath.normpath(self.text("results_directory", "."))

    def files(self, tags: Sequence[str]) -> list[str]:
        """Files that the properties `tags` name, each once."""
        texts = [element.text or "" for tag in tags for element in self.tool.iter(tag)]
        return list(dict.fromkeys(posixpath.normpath(n) for text in texts for n in text.split() if n not in NOTHING))

    def needs(self) -> list[str]:
        """Files that the step reads, including the data file of its external loads.

        Raises:
            UsageError: the external loads cannot be read.
        """
        files, loads = self.files(INPUTS), self.text("external_loads_file", " ")
        name = text_in(read_xml(self.folder / loads), ".//datafile") if (self.folder / loads).is_file() else ""
        if name in NOTHING:
            return files
        beside = posixpath.normpath(posixpath.join(posixpath.dirname(loads), name))
        return [*files, beside if (self.folder / beside).is_file() else posixpath.normpath(name)]


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


def read_xml(path: Path, root: str | None = None) -> ET.Element:
    """Root of an OpenSim document, which must have a child `root` if that is given.

    Raises:
        UsageError: the file cannot be read, or is no such document.
    """
    try:
        document = ET.parse(path).getroot()  # noqa: S314  (a user's own file; expat bounds what entities grow to)
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except ET.ParseError as error:
        raise UsageError(f"{path} is no OpenSim document: {error}") from None
    if root is not None and document.find(root) is None:
        raise UsageError(f"{path} is no OpenSim {root.lower()} file")
    return document


def text_in(element: ET.Element, tag: str) -> str:
    """Text of a property of an element without blanks around it; empty if it is not there."""
    return (element.findtext(tag) or "").strip()


def named_data(loads: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers of an external loads file; it lies beside that, or is named from `folder`.

    Raises:
        UsageError: the external loads file names no file, or one that is not there.
    """
    name = text_in(read_xml(loads, "ExternalLoads"), ".//datafile")
    if name in NOTHING:
        raise UsageError(f"{loads} names no datafile, which has the numbers")
    there = next((place / name for place in (loads.parent, folder) if place and (place / name).is_file()), None)
    if there is None:
        raise UsageError(f"{loads} names the datafile {name}, which is not there")
    return there


def check_opensim() -> None:
    """Check that OpenSim is installed.

    Raises:
        UsageError: it is not installed.
    """
    require("opensim", "opensim")


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


def find_setups(paths: Sequence[Path]) -> dict[str, Setup]:
    """Find the set-up files among `paths`, which are files or folders; return them by step.

    Raises:
        UsageError: there are none, or two for a step.
    """
    files: list[Path] = []
    for path in paths:
        if not path.exists():
            raise UsageError(f"--setup {path}: no such file or folder")
        files += sorted(path.glob("*.xml")) if path.is_dir() else [path]
    setups: dict[str, Setup] = {}
    for setup in filter(None, map(read_setup, files)):
        if setup.step in setups:
            both = f"{setups[setup.step].path.name} and {setup.path.name}"
            raise UsageError(f"--setup: {both} are both for {setup.step}; give the files instead of the folder")
        setups[setup.step] = setup
    if not setups:
        raise UsageError(f"--setup {paths[0]}: no set-up file of a scale, IK, RRA, CMC or static optimization tool")
    return setups


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


def common_folder(setups: Sequence[Setup]) -> Path:
    """Find the folder that holds the set-up files and all files that they name, as an absolute path.

    Raises:
        UsageError: a file name is absolute, or the folder is a root or home folder.
    """
    places = {absolute(setup.folder) for setup in setups}
    for setup in setups:
        for name in setup.needs():
            if posixpath.isabs(name) or "\\" in name:
                raise UsageError(f"{setup.path} names {name}; files must be named from its folder, with /")
            places.add(absolute(setup.folder / name).parent)
    folder = Path(os.path.commonpath(places))
    if folder in {Path(folder.anchor), Path.home()}:
        raise UsageError(
            f"the set-up files and what they name are all over {folder}; put them into a folder of their own"
        )
    return folder


def check_inputs(setups: Sequence[Setup]) -> None:
    """Check before anything runs that the input files of every step are there, or are written by a step before it.

    Raises:
        UsageError: a file is not.
    """
    files: set[Path] = set()
    folders: set[Path] = set()
    for setup in setups:
        for name in setup.needs():
            path = absolute(setup.folder / name)
            if not (path.is_file() or path in files or path.parent in folders):
                raise UsageError(
                    f"{setup.path} ({setup.step}) needs {name}, which is not in {setup.folder} and comes of no step "
                    f"before ({', '.join(earlier.step for earlier in setups)})"
                )
        files |= {absolute(setup.folder / name) for name in setup.files(OUTPUTS)}
        results = absolute(setup.folder / setup.results())
        if results == absolute(setup.folder):
            files.add(results / f"{setup.name}_Kinematics_q.sto")
        else:
            folders.add(results)


def absolute(path: Path) -> Path:
    """Absolute path without dots; symbolic links are kept."""
    return Path(os.path.abspath(path))  # noqa: PTH100  (resolve would follow links out of the folder)


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
        stamps = read_storage(place / last.text("desired_kinematics_file")).stamps
        rate = (len(stamps) - 1) * NANOSECONDS / float(stamps[-1] - stamps[0])
        last = own[-1] = static_setup(last, place / "knee_contact_static.xml", max(1, round(rate / STATIC_RATE)))
    run(last)
    forces, states = results_of(last)
    reactions = reactions_setup(last, place / "knee_contact_reactions.xml", states, forces)
    run(reactions)
    kinematics, speeds, loads, centre = (
        place / reactions.results() / f"{reactions.name}_{name}.sto" for name in RESULTS
    )
    times = read_storage(kinematics).stamps / NANOSECONDS
    window, coordinates = (float(times[0]), float(times[-1])), str(kinematics.relative_to(place))
    dynamics = dynamics_setup(last, place / "knee_contact_dynamics.xml", coordinates, window)
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


def run_step(setup: Setup, work: Path, bar: Bar) -> None:
    """Run the tool of a set-up file in that file's folder, with its output in `work`/logs.

    Raises:
        UsageError: it has failed.
    """
    log, window = work / "logs" / f"{setup.step}.log", times_of(setup)
    arguments = (TOOLS[setup.step], setup.path.name)
    code = run_python(child.__name__, arguments, setup.folder, log, lambda: bar(progress_of(log, window), 1000))
    if code:
        raise UsageError(
            f"OpenSim's {setup.step} ({setup.path.name}) failed with code {code}: {last_words(log)}; "
            "--work DIR keeps its log"
        )


def run_python(
    module: str, arguments: Sequence[str], folder: Path, log: Path, look: Callable[[], None] = lambda: None
) -> int:
    """Run a module in a process of its own, in a folder, with its output in `log`; return its exit code.

    While it runs, `look` is called every `PERIOD`.
    """
    command = python_module(module, *arguments)
    with log.open("wb") as output, kept(output=output, patience=PATIENCE, cwd=folder, **command) as process:
        while process.poll() is None:
            look()
            with suppress(subprocess.TimeoutExpired):
                process.wait(PERIOD)
    return process.returncode


def times_of(setup: Setup) -> tuple[float, float]:
    """First and last time of a step [s]; both 0 if its set-up file has none."""
    texts = setup.text("time_range").split() or [setup.text("initial_time"), setup.text("final_time")]
    try:
        return float(texts[0]), float(texts[1])
    except (ValueError, IndexError):
        return 0.0, 0.0


def progress_of(log: Path, window: tuple[float, float]) -> int:
    """Progress of a step in thousandths, by the last time in its log; `window` is its first and last time [s]."""
    with log.open("rb") as file:
        file.seek(max(file.seek(0, 2) - TAIL, 0))
        times = TIMES.findall(file.read())
    with suppress(ValueError, IndexError, ZeroDivisionError):
        return max(0, min(999, round(1000 * (float(times[-1]) - window[0]) / (window[1] - window[0]))))
    return 0


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


def static_setup(base: Setup, path: Path, interval: int) -> Setup:
    """Write a set-up file for static optimization of what a CMC set-up tracks, every `interval` rows."""
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    own = {
        "coordinates_file": base.text("desired_kinematics_file"),
        "lowpass_cutoff_frequency_for_coordinates": str(cutoff if cutoff > 0.0 else -1.0),
    }
    analyses = {"StaticOptimization": {"step_interval": str(interval)}}
    return _write(STATIC, path, f"{base.name}_static", _shared(base, "ResultsStatic") | own, analyses)


def reactions_setup(base: Setup, path: Path, states: str | None, forces: str) -> Setup:
    """Write a set-up file for joint reactions on child bodies in their frames, kinematics and the centre of mass.

    `forces` is the file of forces of the muscles' step, `base`; `states` is CMC's file of states, without which the
    coordinates of `base` are taken.
    """
    own = {"states_file": states} if states else {
        "coordinates_file": base.text("coordinates_file"),
        "lowpass_cutoff_frequency_for_coordinates": base.text("lowpass_cutoff_frequency_for_coordinates", "-1"),
    }  # fmt: skip
    child_frame = {"apply_on_bodies": "child", "express_in_frame": "child"}
    analyses = {
        "Kinematics": {"coordinates": "all", "in_degrees": "true"},
        "BodyKinematics": {"bodies": "center_of_mass"},
        "JointReaction": {"forces_file": forces, "joint_names": "ALL", **child_frame},
    }
    return _write(REACTIONS, path, "knee_contact", _shared(base, "ResultsReactions") | own, analyses)


def dynamics_setup(base: Setup, path: Path, coordinates: str, window: tuple[float, float]) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, with which reserves are compared."""
    properties = {
        "results_directory": "ResultsDynamics", "model_file": base.text("model_file"),
        "time_range": f"{window[0]} {window[1]}", "forces_to_exclude": "Muscles",
        "external_loads_file": base.text("external_loads_file"), "coordinates_file": coordinates,
        "lowpass_cutoff_frequency_for_coordinates": "-1", "output_gen_force_file": "moments.sto",
    }  # fmt: skip
    return _write(DYNAMICS, path, "knee_contact", properties, {})


def _shared(base: Setup, results: str) -> dict[str, str]:
    """Properties of an AnalyzeTool: model, actuators, loads and times of `base`."""
    own = {
        "results_directory": results,
        "output_precision": "12",
        "solve_for_equilibrium_for_auxiliary_states": "false",
    }
    return {tag: base.text(tag) for tag in SHARED} | own


def _write(step: str, path: Path, name: str, properties: dict[str, str], analyses: dict[str, dict[str, str]]) -> Setup:
    """Write a set-up file with a tool and its analyses."""
    document = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(document, TOOLS[step], name=name)
    objects = ET.SubElement(ET.SubElement(tool, "AnalysisSet", name="Analyses"), "objects") if analyses else tool
    for kind, own in analyses.items():
        _add(ET.SubElement(objects, kind, name=kind), own)
    _add(tool, properties)
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding="UTF-8", xml_declaration=True)
    return Setup(step, path, tool)


def _add(element: ET.Element, properties: dict[str, str]) -> None:
    for tag, text in properties.items():
        ET.SubElement(element, tag).text = text


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
    data = read_storage(named_data(loads, folder))
    names = [text_in(force, "force_identifier") for force in read_xml(loads, "ExternalLoads").iter("ExternalForce")]
    names = [name for name in names if f"{name}x" in data.names]
    if not names:
        raise UsageError(f"{loads}: no force_identifier of it is in {data.path}")
    net = sum(np.column_stack([data.column(f"{name}{axis}") for axis in "xyz"]) for name in names)
    inside = (data.stamps >= stamps[0]) & (data.stamps <= stamps[-1])
    return float(np.linalg.norm(net, axis=1)[inside].max())
