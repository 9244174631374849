"""OpenSim's set-up files: the step of each, the files that it reads and writes, and those that we write ourselves."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.model_file import NOTHING, read_xml, text_in

SCALE, IK, RRA, CMC, STATIC, REACTIONS, DYNAMICS = "scale", "ik", "rra", "cmc", "static", "reactions", "dynamics"
TOOLS = {
    SCALE: "ScaleTool", IK: "InverseKinematicsTool", RRA: "RRATool", CMC: "CMCTool", STATIC: "AnalyzeTool",
    REACTIONS: "AnalyzeTool", DYNAMICS: "InverseDynamicsTool",
}  # fmt: skip
"""Tool of each step, in the order in which the steps run"""
CHOOSABLE = (SCALE, IK, RRA, CMC, STATIC)
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
    """Set-up file of a tool."""

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
        """Folder in which the tool runs, and relative to which the set-up file names others."""
        return self.path.parent

    def results(self) -> str:
        """Folder of the results, relative to `folder`."""
        return posixpath.normpath(self.text("results_directory", "."))

    def reads(self) -> list[str]:
        """Files that the set-up file names as inputs, relative to `folder`."""
        texts = [element.text or "" for tag in INPUTS for element in self.tool.iter(tag)]
        return list(dict.fromkeys(posixpath.normpath(n) for text in texts for n in text.split() if n not in NOTHING))

    def writes(self) -> list[str]:
        """Files that the set-up file names as outputs, relative to `folder`."""
        texts = [(element.text or "").strip() for tag in OUTPUTS for element in self.tool.iter(tag)]
        return [posixpath.normpath(text) for text in texts if text not in NOTHING]


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
        for name in needed(setup):
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
        for name in needed(setup):
            path = absolute(setup.folder / name)
            if not (path.is_file() or path in files or path.parent in folders):
                raise UsageError(
                    f"{setup.path} ({setup.step}) needs {name}, which is not in {setup.folder} and comes of no step "
                    f"before ({', '.join(earlier.step for earlier in setups)})"
                )
        files |= {absolute(setup.folder / name) for name in setup.writes()}
        results = absolute(setup.folder / setup.results())
        if results == absolute(setup.folder):
            files.add(results / f"{setup.name}_Kinematics_q.sto")
        else:
            folders.add(results)


def needed(setup: Setup) -> list[str]:
    """All files that a step needs, including the data file of its external loads; relative to the set-up's folder.

    Raises:
        UsageError: the external loads cannot be read.
    """
    loads = setup.text("external_loads_file", " ")
    if not (setup.folder / loads).is_file():
        return setup.reads()
    name = text_in(read_xml(setup.folder / loads), ".//datafile")
    if name in NOTHING:
        return setup.reads()
    beside = posixpath.normpath(posixpath.join(posixpath.dirname(loads), name))
    return [*setup.reads(), beside if (setup.folder / beside).is_file() else posixpath.normpath(name)]


def absolute(path: Path) -> Path:
    """Absolute path without dots; symbolic links are kept."""
    return Path(os.path.abspath(path))  # noqa: PTH100  (resolve would follow links out of the folder)


def static_setup(base: Setup, path: Path, interval: int) -> Setup:
    """Write a set-up file for static optimization of what a CMC set-up tracks, every `interval` rows."""
    tool, analyses = analyze_tool(base, f"{base.name}_static", "ResultsStatic")
    add(ET.SubElement(analyses, "StaticOptimization", name="StaticOptimization"), step_interval=str(interval))
    add(tool, coordinates_file=base.text("desired_kinematics_file"))
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    add(tool, lowpass_cutoff_frequency_for_coordinates=str(cutoff if cutoff > 0.0 else -1.0))
    return write(tool, STATIC, path)


def reactions_setup(base: Setup, path: Path, states: str | None, forces: str) -> Setup:
    """Write a set-up file for joint reactions on child bodies in their frames, kinematics and the centre of mass.

    `forces` is the file of forces of the muscles' step, `base`; `states` is CMC's file of states, without which the
    coordinates of `base` are taken.
    """
    tool, analyses = analyze_tool(base, "knee_contact", "ResultsReactions")
    add(ET.SubElement(analyses, "Kinematics", name="Kinematics"), coordinates="all", in_degrees="true")
    add(ET.SubElement(analyses, "BodyKinematics", name="BodyKinematics"), bodies="center_of_mass")
    reaction = ET.SubElement(analyses, "JointReaction", name="JointReaction")
    add(reaction, forces_file=forces, joint_names="ALL", apply_on_bodies="child", express_in_frame="child")
    if states:
        add(tool, states_file=states)
    else:
        cutoff = base.text("lowpass_cutoff_frequency_for_coordinates", "-1")
        add(tool, coordinates_file=base.text("coordinates_file"), lowpass_cutoff_frequency_for_coordinates=cutoff)
    return write(tool, REACTIONS, path)


def dynamics_setup(base: Setup, path: Path, coordinates: str, window: tuple[float, float]) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, with which reserves are compared."""
    tool = ET.Element(TOOLS[DYNAMICS], name="knee_contact")
    add(tool, results_directory="ResultsDynamics", model_file=base.text("model_file"))
    add(tool, time_range=f"{window[0]} {window[1]}", forces_to_exclude="Muscles")
    add(tool, external_loads_file=base.text("external_loads_file"), coordinates_file=coordinates)
    add(tool, lowpass_cutoff_frequency_for_coordinates="-1", output_gen_force_file="moments.sto")
    return write(tool, DYNAMICS, path)


def analyze_tool(base: Setup, name: str, results: str) -> tuple[ET.Element, ET.Element]:
    """Make an AnalyzeTool with the model, actuators, loads and times of `base`, and the element for its analyses."""
    tool = ET.Element(TOOLS[REACTIONS], name=name)
    add(tool, **{tag: base.text(tag) for tag in SHARED})
    add(tool, results_directory=results, output_precision="12", solve_for_equilibrium_for_auxiliary_states="false")
    return tool, ET.SubElement(ET.SubElement(tool, "AnalysisSet", name="Analyses"), "objects")


def add(element: ET.Element, **properties: str) -> None:
    """Add properties to an element."""
    for tag, text in properties.items():
        ET.SubElement(element, tag).text = text


def write(tool: ET.Element, step: str, path: Path) -> Setup:
    """Write a set-up file with a tool."""
    document = ET.Element("OpenSimDocument", Version="40000")
    document.append(tool)
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding="UTF-8", xml_declaration=True)
    return Setup(step, path, tool)
