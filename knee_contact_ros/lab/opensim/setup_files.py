"""OpenSim's XML: set-up files of tools, which step each is, what it reads and writes, and those that we write."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import require

XML = ".xml"
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
    "task_set_file", "constraints_file", "coordinates_file", "coordinate_file",
)  # fmt: skip
SHARED = (
    "model_file", "replace_force_set", "force_set_files", "external_loads_file", "initial_time", "final_time",
)  # fmt: skip
"""Properties that an AnalyzeTool takes from another set-up file"""


class Setup(NamedTuple):
    """Set-up file of a tool. Files are named relative to its folder, in which the tool runs."""

    step: str
    path: Path
    tool: ET.Element
    """The tool's element in the file"""

    @property
    def name(self) -> str:
        """Name of the tool, with which the names of its results begin."""
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
        UsageError: the file cannot be read, or is no such document.
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
    """Text of a property of an element without blanks around it; empty if it is not there."""
    return (element.findtext(tag) or "").strip()


def data_file(ground: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers: `ground` itself, or the one that it names if it is an external loads file.

    That file lies beside it, or is named from `folder`, in which a tool of OpenSim runs with it.

    Raises:
        UsageError: the external loads file names no file, or one that is not there.
    """
    if ground.suffix.lower() != XML:
        return ground
    name = text_in(read_xml(ground, "ExternalLoads"), ".//datafile")
    if name in NOTHING:
        raise UsageError(f"{ground} names no datafile, which has the numbers")
    there = next((place / name for place in (ground.parent, folder) if place and (place / name).is_file()), None)
    if there is None:
        raise UsageError(f"{ground} names the datafile {name}, which is not there")
    return there


def plan(paths: Sequence[Path], steps: Sequence[str]) -> tuple[Path, list[Setup]]:
    """Choose the folder to copy, and the set-up files of the steps to run, the last one CMC or static optimization.

    Without `steps`, all that have a set-up file are run, but static optimization only if there is no CMC.

    Raises:
        UsageError: a file is missing or cannot be used, there are two for a step, or OpenSim is not installed.
    """
    there = find_setups(paths)
    if unknown := [step for step in steps if step not in CHOOSABLE]:
        raise UsageError(f"--steps: there is no {unknown[0]}; there are {', '.join(CHOOSABLE)}")
    wanted = list(steps) or [step for step in CHOOSABLE if step in there and (step != STATIC or CMC not in there)]
    if (CMC in wanted) == (STATIC in wanted):
        raise UsageError(
            f"--steps {','.join(wanted)}: one of cmc and static must be among them, because it computes the forces"
        )
    if missing := [step for step in wanted if step not in there and not (step == STATIC and CMC in there)]:
        raise UsageError(f"--setup {paths[0]}: there is no set-up file for {missing[0]}; there are {', '.join(there)}")
    require("opensim", "opensim")
    setups = [(there.get(step) or there[CMC])._replace(step=step) for step in CHOOSABLE if step in wanted]
    return common_folder(setups), setups


def find_setups(paths: Sequence[Path]) -> dict[str, Setup]:
    """Find the set-up files among files and folders, by step."""
    there: dict[str, Setup] = {}
    for path in paths:
        if not path.exists():
            raise UsageError(f"--setup {path}: no such file or folder")
        for setup in filter(None, map(read_setup, sorted(path.glob("*.xml")) if path.is_dir() else [path])):
            if setup.step in there:
                both = f"{there[setup.step].path.name} and {setup.path.name}"
                raise UsageError(f"--setup: {both} are both for {setup.step}; give the files instead of the folder")
            there[setup.step] = setup
    if not there:
        raise UsageError(f"--setup {paths[0]}: no set-up file of a scale, IK, RRA, CMC or static optimization tool")
    return there


def common_folder(setups: Sequence[Setup]) -> Path:
    """Find the folder that holds the set-up files and all files that they name, as an absolute path."""
    places = set()
    for setup in setups:
        for name in ("", *setup.needs()):
            if name.startswith("/") or "\\" in name:
                raise UsageError(f"{setup.path} names {name}; write file names relative to its folder, with /")
            places.add(absolute(setup.folder / name).parent if name else absolute(setup.folder))
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
    """Write a set-up file for static optimization of what a CMC set-up tracks, every `interval` rows."""
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    return _write(STATIC, path, f"{base.name}_static", {
        **_shared(base, "ResultsStatic"),
        "AnalysisSet": {"objects": {"StaticOptimization": {"step_interval": str(interval)}}},
        "coordinates_file": base.text("desired_kinematics_file"),
        "lowpass_cutoff_frequency_for_coordinates": str(cutoff if cutoff > 0.0 else -1.0),
    })  # fmt: skip


def reactions_setup(base: Setup, path: Path, states: Path | None, forces: Path) -> Setup:
    """Write a set-up file for joint reactions on child bodies in their frames, kinematics and the centre of mass.

    `forces` is the file of forces of the muscles' step, `base`; `states` is CMC's file of states, without which the
    coordinates of `base` are taken.
    """
    cutoff = "lowpass_cutoff_frequency_for_coordinates"
    own = {"coordinates_file": base.text("coordinates_file"), cutoff: base.text(cutoff, "-1")}
    child_frame = {"apply_on_bodies": "child", "express_in_frame": "child"}
    return _write(REACTIONS, path, "knee_contact", {
        **_shared(base, "ResultsReactions"),
        "AnalysisSet": {"objects": {
            "Kinematics": {"coordinates": "all", "in_degrees": "true"},
            "BodyKinematics": {"bodies": "center_of_mass"},
            "JointReaction": {"forces_file": str(forces), "joint_names": "ALL", **child_frame},
        }},
        **({"states_file": str(states)} if states else own),
    })  # fmt: skip


def dynamics_setup(base: Setup, path: Path, coordinates: str, window: tuple[float, float]) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, with which reserves are compared."""
    return _write(DYNAMICS, path, "knee_contact", {
        "results_directory": "ResultsDynamics", "model_file": base.text("model_file"),
        "time_range": f"{window[0]} {window[1]}", "forces_to_exclude": "Muscles",
        "external_loads_file": base.text("external_loads_file"), "coordinates_file": coordinates,
        "lowpass_cutoff_frequency_for_coordinates": "-1", "output_gen_force_file": "moments.sto",
    })  # fmt: skip


def _shared(base: Setup, results: str) -> dict[str, str]:
    """Properties of an AnalyzeTool: model, actuators, loads and times of `base`."""
    own = {"output_precision": "12", "solve_for_equilibrium_for_auxiliary_states": "false"}
    return {tag: base.text(tag) for tag in SHARED} | {"results_directory": results} | own


def _write(step: str, path: Path, name: str, content: Mapping[str, Any]) -> Setup:
    """Write a set-up file of a tool with its properties; those that are mappings are objects with properties."""

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
