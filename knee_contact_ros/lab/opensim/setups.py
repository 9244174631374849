"""Set-up files of OpenSim's tools: which step each is for, what it reads and writes, and those that we write."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

from ...system.errors import UsageError
from ...system.files import require

XML = ".xml"
UNSET = {"", "Unassigned", "unassigned"}
"""Texts that mean that a property is not set"""
SCALE = "scale"
IK = "ik"
RRA = "rra"
CMC = "cmc"
STATIC = "static"
REACTIONS = "reactions"
DYNAMICS = "dynamics"
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
_CHOOSABLE_STEPS = (SCALE, IK, RRA, CMC, STATIC)
EXTERNAL_LOADS = "external_loads_file"
_CUTOFF = "lowpass_cutoff_frequency_for_coordinates"
_FILE_PROPERTIES = (
    "model_file",
    "marker_set_file",
    "marker_file",
    "force_set_files",
    EXTERNAL_LOADS,
    "desired_kinematics_file",
    "task_set_file",
    "constraints_file",
    "coordinates_file",
    "coordinate_file",
)
"""Properties that name the files that a tool reads"""
_WRITTEN_PROPERTIES = (
    "results_directory",
    "output_model_file",
    "output_motion_file",
    "output_marker_file",
    "output_scale_file",
)
"""Properties that name what a tool writes"""
_LISTS = {"force_set_files"}
"""Properties with several names, divided by blanks"""
_ELSEWHERE = re.compile(r"/|[A-Za-z]:|.*\\")
"""A name that OpenSim's GUI wrote, on Windows or with the whole path"""
_SHARED_PROPERTIES = (
    "model_file",
    "replace_force_set",
    "force_set_files",
    EXTERNAL_LOADS,
    "initial_time",
    "final_time",
)
"""Properties that an AnalyzeTool takes from another set-up file"""


class Setup(NamedTuple):
    """Set-up file of a tool. Files are named relative to its folder, in which the tool runs."""

    step: str
    path: Path
    tool: ET.Element
    """The tool's element in the file"""
    document: ET.Element | None = None
    """The whole file, of a user's set-up"""
    changed: bool = False
    """Whether it must be written before it runs"""

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
        return default if text in UNSET else text

    def needs(self) -> list[str]:
        """Files that the step reads."""
        names = []
        for tag in _FILE_PROPERTIES:
            for element in self.tool.iter(tag):
                text = (element.text or "").strip()
                names += text.split() if tag in _LISTS else [text]
        return [name for name in names if name not in UNSET]


def read_xml(path: Path, root: str | None = None) -> ET.Element:
    """Return the root of an OpenSim document, which must have a child `root` if that is given.

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
    """Return the stripped text of a property of an element; empty if it is missing."""
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
    if name in UNSET:
        raise UsageError(f"{ground} names no datafile, which has the numbers")
    name = _end_in(ground.parent, name) or name
    for place in (ground.parent, folder):
        if place and (place / name).is_file():
            return place / name
    raise UsageError(f"{ground} names the datafile {name}, which is not there")


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
        for file in sorted(path.glob("*.xml")) if path.is_dir() else [path]:
            setup = read_setup(file)
            if setup is None:
                continue
            if setup.step in there:
                both = f"{there[setup.step].path.name} and {file.name}"
                raise UsageError(
                    f"--setup: {both} are both for {setup.step}; give the files instead of the folder"
                )
            there[setup.step] = setup
    if not there:
        raise UsageError(
            f"--setup {paths[0]}: no set-up file of a scale, IK, RRA, CMC or static optimization tool"
        )
    if unknown := [step for step in steps if step not in _CHOOSABLE_STEPS]:
        allowed = ", ".join(_CHOOSABLE_STEPS)
        raise UsageError(f"--steps: there is no {unknown[0]}; there are {allowed}")
    wanted = steps or [
        step for step in _CHOOSABLE_STEPS if step in there and (step != STATIC or CMC not in there)
    ]
    if (CMC in wanted) == (STATIC in wanted):
        raise UsageError(
            f"--steps {','.join(wanted)}: one of cmc and static must be among them, because it computes the forces"
        )
    # A set-up file of CMC has what static optimization needs.
    found = {
        step: there.get(step) or (there.get(CMC) if step == STATIC else None)
        for step in _CHOOSABLE_STEPS
        if step in wanted
    }
    if missing := [step for step, setup in found.items() if setup is None]:
        raise UsageError(
            f"--setup {paths[0]}: there is no set-up file for {missing[0]}; there are {', '.join(there)}"
        )
    require("opensim", "opensim")
    setups = _of_this_folder([setup._replace(step=step) for step, setup in found.items() if setup])
    return _common_folder(setups), setups


def _end_in(folder: Path, name: str) -> str:
    """Return the longest end of a file's name that is there in a folder; empty if none is."""
    parts = name.replace("\\", "/").split("/")
    ends = ("/".join(parts[first:]) for first in range(len(parts)))
    return next((end for end in ends if end.strip("/") and (folder / end).exists()), "")


def _names_in(element: ET.Element, tags: Sequence[str]) -> Iterator[tuple[ET.Element, str]]:
    """Yield the properties that name files, and each name that OpenSim's GUI wrote."""
    for tag in tags:
        for each in element.iter(tag):
            text = (each.text or "").strip()
            # Of several whole paths, which may have blanks, each begins with a drive or a slash.
            for name in re.split(r"\s+(?=[A-Za-z]:|/)", text) if tag in _LISTS else [text]:
                if _ELSEWHERE.match(name):
                    yield each, name


def localised(
    element: ET.Element, folder: Path, tags: Sequence[str], roots: dict[str, Path] | None = None
) -> bool:
    """Make names of files that OpenSim's GUI wrote relative to the folder of their file; return whether there are any.

    What stands before the names of files that are there is put into `roots`, with the folder that it is here; other
    names in it, of what a tool has still to write, follow.
    """
    roots = {} if roots is None else roots
    found = [*_names_in(element, tags)]
    for each, name in found:
        plain, end = name.replace("\\", "/"), _end_in(folder, name)
        if end:
            roots.setdefault(plain[: -len(end)], folder)
        within = [root for root in roots if root and f"{plain}/".startswith(root)]
        if within and not end:
            end = os.path.relpath(roots[within[0]] / plain[len(within[0]) :], folder)
        each.text = (each.text or "").replace(name, end or plain)
    return bool(found)


def _of_this_folder(setups: Sequence[Setup]) -> list[Setup]:
    """Make names relative, and name the model where there is none: that of the step before, or the only one.

    Raises:
        UsageError: there is not one model in the folder.
    """
    done, written, roots = list[Setup](), Path(), dict[str, Path]()
    for setup in setups:
        tags = (*_FILE_PROPERTIES, *_WRITTEN_PROPERTIES)
        changed = localised(setup.tool, setup.folder, tags, roots)
        lacks = not setup.text("model_file")
        if lacks:
            models = [written] if written.name else sorted(setup.folder.glob("*.osim"))
            if len(models) != 1:
                raise UsageError(
                    f"{setup.path} names no model_file, and its folder has {len(models)} models: write one into it"
                )
            element = next(setup.tool.iter("model_file"), None)
            element = ET.SubElement(setup.tool, "model_file") if element is None else element
            element.text = os.path.relpath(models[0], setup.folder)
        outputs = [(each.text or "").strip() for each in setup.tool.iter("output_model_file")]
        for output in outputs:
            written = written if output in UNSET else setup.folder / output
        done.append(setup._replace(changed=changed or lacks))
    return done


def _common_folder(setups: Sequence[Setup]) -> Path:
    """Find the folder that contains the set-up files and all files that they name, as an absolute path."""
    places = [absolute_path(setup.folder) for setup in setups]
    for setup in setups:
        for name in setup.needs():
            if _ELSEWHERE.match(name):
                raise UsageError(
                    f"{setup.path} names {name}, which is not in its folder; put it there, or write its name relative "
                    "to its folder, with /"
                )
            places.append(absolute_path(setup.folder / name).parent)
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
    for step in _CHOOSABLE_STEPS:
        tool = root.find(TOOLS[step])
        if tool is not None and (step != STATIC or tool.find(".//StaticOptimization") is not None):
            return Setup(step, path, tool, root)
    return None


def absolute_path(path: Path) -> Path:
    """Return the absolute path without dots; symbolic links are kept, which may lead out of the folder."""
    return Path(os.path.abspath(path))  # noqa: PTH100


def static_setup(base: Setup, path: Path, interval: int) -> Setup:
    """Write a set-up file for static optimization of the motion that a CMC set-up tracks, every `interval` rows."""
    cutoff = float(base.text("lowpass_cutoff_frequency", "-1"))
    content = {
        **_shared(base, "ResultsStatic"),
        "AnalysisSet": {"objects": {"StaticOptimization": {"step_interval": str(interval)}}},
        "coordinates_file": base.text("desired_kinematics_file"),
        _CUTOFF: str(cutoff if cutoff > 0.0 else -1.0),
    }
    return _write(STATIC, path, f"{base.name}_static", content)


def reactions_setup(base: Setup, path: Path, states: Path | None, forces: Path) -> Setup:
    """Write a set-up file for joint reactions on child bodies in their frames, kinematics and the centre of mass.

    `forces` has the forces from the muscles' step `base`. `states` is CMC's file of states; without it the coordinates
    of `base` are used.
    """
    analyses = {
        "Kinematics": {"coordinates": "all", "in_degrees": "true"},
        "BodyKinematics": {"bodies": "center_of_mass"},
        "JointReaction": {
            "forces_file": str(forces),
            "joint_names": "ALL",
            "apply_on_bodies": "child",
            "express_in_frame": "child",
        },
    }
    content = {**_shared(base, "ResultsReactions"), "AnalysisSet": {"objects": analyses}}
    if states:
        content["states_file"] = str(states)
    else:
        content["coordinates_file"] = base.text("coordinates_file")
        content[_CUTOFF] = base.text(_CUTOFF, "-1")
    return _write(REACTIONS, path, "knee_contact", content)


def dynamics_setup(
    base: Setup, path: Path, coordinates: str, window: tuple[float, float]
) -> Setup:
    """Write a set-up file for inverse dynamics: net joint moments, to compare reserves with."""
    content = {
        "results_directory": "ResultsDynamics",
        "model_file": base.text("model_file"),
        "time_range": f"{window[0]} {window[1]}",
        "forces_to_exclude": "Muscles",
        EXTERNAL_LOADS: base.text(EXTERNAL_LOADS),
        "coordinates_file": coordinates,
        _CUTOFF: "-1",
        "output_gen_force_file": "moments.sto",
    }
    return _write(DYNAMICS, path, "knee_contact", content)


def _shared(base: Setup, results: str) -> dict[str, Any]:
    """Return the properties of an AnalyzeTool: model, actuators, loads and times of `base`."""
    return {
        **{tag: base.text(tag) for tag in _SHARED_PROPERTIES},
        "results_directory": results,
        "output_precision": "12",
        "solve_for_equilibrium_for_auxiliary_states": "false",
    }


def _write(step: str, path: Path, name: str, content: Mapping[str, Any]) -> Setup:
    """Write a set-up file of a tool with its properties; a mapping becomes an object with properties."""
    document = ET.Element("OpenSimDocument", Version="40000")
    tool = ET.SubElement(document, TOOLS[step], name=name)
    _fill(tool, content)
    ET.indent(document)
    ET.ElementTree(document).write(path, encoding="UTF-8", xml_declaration=True)
    return Setup(step, path, tool)


def _fill(element: ET.Element, content: Mapping[str, Any]) -> None:
    """Add properties to an element; objects have names that begin with a capital letter."""
    for tag, value in content.items():
        child = ET.SubElement(element, tag, {} if tag.islower() else {"name": tag})
        if isinstance(value, str):
            child.text = value
        else:
            _fill(child, value)
