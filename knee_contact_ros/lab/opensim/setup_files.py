"""OpenSim's XML: set-up files of tools, which step each is, what it reads and writes, and those that we write."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require

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


def static_setup(base: Setup, path: Path, interval: int) -> Setup:
    """Write a set-up file for static optimization of what a CMC set-up tracks, every `interval` rows."""
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    own = {
        "coordinates_file": base.text("desired_kinematics_file"),
        "lowpass_cutoff_frequency_for_coordinates": str(cutoff if cutoff > 0.0 else -1.0),
    }
    analyses = {"StaticOptimization": {"step_interval": str(interval)}}
    return _write(STATIC, path, f"{base.name}_static", _shared(base, "ResultsStatic"), analyses, own)


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
    return _write(REACTIONS, path, "knee_contact", _shared(base, "ResultsReactions"), analyses, own)


def dynamics_setup(base: Setup, path: Path, coordinates: str, window: tuple[float, float]) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, with which reserves are compared."""
    properties = {
        "results_directory": "ResultsDynamics", "model_file": base.text("model_file"),
        "time_range": f"{window[0]} {window[1]}", "forces_to_exclude": "Muscles",
        "external_loads_file": base.text("external_loads_file"), "coordinates_file": coordinates,
        "lowpass_cutoff_frequency_for_coordinates": "-1", "output_gen_force_file": "moments.sto",
    }  # fmt: skip
    return _write(DYNAMICS, path, "knee_contact", properties, {}, {})


def _shared(base: Setup, results: str) -> dict[str, str]:
    """Properties of an AnalyzeTool: model, actuators, loads and times of `base`."""
    own = {
        "results_directory": results,
        "output_precision": "12",
        "solve_for_equilibrium_for_auxiliary_states": "false",
    }
    return {tag: base.text(tag) for tag in SHARED} | own


def _write(
    step: str, path: Path, name: str, first: dict[str, str], analyses: dict[str, dict[str, str]], last: dict[str, str]
) -> Setup:
    """Write a set-up file with a tool: its first properties, its analyses, its last properties."""
    document = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(document, TOOLS[step], name=name)
    _add(tool, first)
    objects = ET.SubElement(ET.SubElement(tool, "AnalysisSet", name="Analyses"), "objects") if analyses else tool
    for kind, own in analyses.items():
        _add(ET.SubElement(objects, kind, name=kind), own)
    _add(tool, last)
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding="UTF-8", xml_declaration=True)
    return Setup(step, path, tool)


def _add(element: ET.Element, properties: dict[str, str]) -> None:
    for tag, text in properties.items():
        ET.SubElement(element, tag).text = text
