"""Which columns of a file with ground reactions act on which foot: by OpenSim's external loads, or by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.offline.gait_files.storage import Storage, read_storage, some
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.columns import LEFT, RIGHT, SIDE_WORDS, is_part, words
from knee_contact_ros.tools.opensim.model_file import read_xml

XML = ".xml"
NOTHING = {"", "Unassigned", "unassigned"}
GROUND = {"ground", "/ground", *NOTHING}
"""Names of the frame that stands still; it is meant where none is named"""
FOOT = ("foot", "calc", "talus", "toe", "heel", "mtp", "midfoot", "forefoot", "hindfoot")
"""Beginnings of words in bodies' names"""
FORCE = re.compile(r"(?P<stem>.*force.*_)vx", re.IGNORECASE)
"""The first of a force's columns, as `ground_force_vx`, `1_ground_force_vx`, `ground_force_r_vx`"""
EXAMPLES = {"ground_force_": RIGHT, "1_ground_force_": LEFT}
"""Whose the plates are in OpenSim's own examples, which name no foot"""
TURNS = ("torque", "moment")


class FootForce(NamedTuple):
    """A force on a foot: what the names of its columns begin with; x, y and z follow."""

    force: str
    """[N]"""
    point: str
    """[m] where it acts"""
    torque: str
    """[N m] of the free moment; empty: there is none"""

    @property
    def told(self) -> str:
        """The columns, for a person."""
        return " ".join(f"{name}(x y z)" for name in self if name)


class GroundFile(NamedTuple):
    """Ground reactions over time, and which of them act on a foot."""

    data: Storage
    forces: tuple[FootForce, ...]
    notes: tuple[str, ...]
    """What was left out"""


def data_file(ground: Path, folder: Path | None = None) -> Path:
    """The file with the numbers: `ground` itself, or the one that it names if it is an external loads file.

    That lies beside it, or is named from `folder`, where a tool of OpenSim runs with it.

    Raises:
        UsageError: it names none, or one that is not there.
    """
    return named_data(ground, folder) if ground.suffix.lower() == XML else ground


def named_data(loads: Path, folder: Path | None = None) -> Path:
    """The file with the numbers of an external loads file; it lies beside it, or is named from `folder`.

    Raises:
        UsageError: it names none, or one that is not there.
    """
    name = (read_xml(loads, "ExternalLoads").findtext(".//datafile") or "").strip()
    if name in NOTHING:
        raise UsageError(f"{loads} names no datafile, which has the numbers")
    places = [place / name for place in (loads.parent, folder) if place]
    there = next((path for path in places if path.is_file()), None)
    if there is None:
        raise UsageError(f"{loads} names the datafile {name}, which is not there")
    return there


def read_ground(ground: Path, data: Path, side: str) -> GroundFile:
    """The forces on a foot, right or left; `data` is what `data_file` gives.

    Raises:
        UsageError: a file cannot be read, it is not clear what acts on the foot, or a column is missing.
    """
    storage = read_storage(data)
    if ground.suffix.lower() == XML:
        forces, notes = by_loads(ground, side)
    else:
        forces, notes = [by_names(storage, side)], []
    for force in forces:
        check_columns(storage, force)
    return GroundFile(storage, tuple(forces), tuple(notes))


def by_loads(path: Path, side: str) -> tuple[list[FootForce], list[str]]:
    """The forces that an external loads file applies to bodies of a foot, and notes on those that it has elsewhere.

    Raises:
        UsageError: there are none, or they are not expressed in ground.
    """
    forces: list[FootForce] = []
    elsewhere: list[str] = []
    for element in read_xml(path, "ExternalLoads").iter("ExternalForce"):
        body = text(element, "applied_to_body")
        if not applies(element) or not body:
            continue
        if is_foot(body, side):
            forces.append(foot_force(path, element))
        elif not any(is_foot(body, other) for other in SIDE_WORDS):
            elsewhere.append(body)
    if not forces:
        raise UsageError(
            f"{path} applies no force to the {side} foot; its forces act on {some(bodies(path)) or 'nothing'}"
        )
    return forces, [f"ground: what acts on {', '.join(elsewhere)} is left out"] * bool(elsewhere)


def bodies(path: Path) -> list[str]:
    """All bodies that an external loads file applies forces to."""
    found = read_xml(path, "ExternalLoads").iter("ExternalForce")
    return list(dict.fromkeys(filter(None, (text(element, "applied_to_body") for element in found))))


def foot_force(path: Path, element: ET.Element) -> FootForce:
    """What an ExternalForce says.

    Raises:
        UsageError: it has no force or no point, or these are not expressed in ground.
    """
    where = f"{path}: the force {element.get('name', '')!r}"
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        if text(element, tag) not in GROUND:
            raise UsageError(f"{where}: {tag} is {text(element, tag)}, and must be ground")
    force, point, torque = (text(element, f"{what}_identifier") for what in ("force", "point", "torque"))
    for name, value in (("force", force), ("point", point)):
        if value in NOTHING:
            raise UsageError(f"{where} has no {name}_identifier")
    return FootForce(force, point, "" if torque in NOTHING else torque)


def applies(element: ET.Element) -> bool:
    """Whether a force is switched on, as OpenSim 3 or 4 says it."""
    return text(element, "isDisabled").lower() != "true" and text(element, "appliesForce").lower() != "false"


def text(element: ET.Element, tag: str) -> str:
    """A property; empty if it is not there."""
    return (element.findtext(tag) or "").strip()


def is_foot(body: str, side: str) -> bool:
    """Whether a body's name says that it is of the foot of this side."""
    return is_part(body, FOOT) and bool(words(body) & SIDE_WORDS[side])


def by_names(storage: Storage, side: str) -> FootForce:
    """The force whose columns name the foot, or that has the place it has in OpenSim's examples.

    Raises:
        UsageError: it is not clear which one.
    """
    stems = [match["stem"] for match in map(FORCE.fullmatch, storage.names) if match]
    if not stems:
        raise UsageError(f"{storage.path} has no ground force, as ground_force_vx, but {some(storage.names)}")
    fitting = [stem for stem in stems if words(stem) & SIDE_WORDS[side]]
    if set(stems) == set(EXAMPLES):
        fitting = [stem for stem in stems if EXAMPLES[stem] == side]
    if len(fitting) != 1:
        raise UsageError(
            f"{storage.path}: which of {some([f'{stem}vx' for stem in stems])} is of the {side} foot? "
            "Give the external loads file (.xml) in its place"
        )
    stem = fitting[0]
    return FootForce(f"{stem}v", f"{stem}p", torque_of(storage.names, stem))


def torque_of(names: Sequence[str], stem: str) -> str:
    """What a free moment's columns begin with, by the stem of its force's; empty if there are none."""
    for turn in TURNS:
        for prefix in (stem.replace("force", turn), stem.replace("force", turn) + "m"):
            if f"{prefix}y" in names:
                return prefix
    return ""


def check_columns(storage: Storage, force: FootForce) -> None:
    """Check that all columns of a force are there.

    Raises:
        UsageError: they are not.
    """
    missing = [name + axis for name in force if name for axis in "xyz" if name + axis not in storage.names]
    if missing:
        raise UsageError(f"{storage.path} has no column {', '.join(missing)}; it has {some(storage.names)}")
