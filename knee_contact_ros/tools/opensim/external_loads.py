"""Find the columns of ground reactions that act on a foot, by OpenSim's external loads or by the columns' names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from knee_contact_ros.offline.gait_files.storage import Storage, read_storage, some
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.columns import LEFT, RIGHT, SIDE_WORDS, is_part, words
from knee_contact_ros.tools.opensim.model_file import NOTHING, read_xml, text_in

XML = ".xml"
GROUND = {"ground", "/ground", *NOTHING}
"""Names of the ground frame, which is also meant where none is named"""
FOOT = ("foot", "calc", "talus", "toe", "heel", "mtp", "midfoot", "forefoot", "hindfoot")
"""Beginnings of words in names of the bodies of a foot"""
FORCE = re.compile(r"(?P<stem>.*force.*_)vx", re.IGNORECASE)
"""Name of a force's first column, as `ground_force_vx`, `1_ground_force_vx`, `ground_force_r_vx`"""
EXAMPLES = {"ground_force_": RIGHT, "1_ground_force_": LEFT}
"""Side of each force plate in OpenSim's own examples, which name no foot"""
TURNS = ("torque", "moment")


class FootForce(NamedTuple):
    """Columns of a force on a foot: the beginnings of their names, which x, y and z follow."""

    force: str
    """Columns of the force [N]"""
    point: str
    """Columns of the point of application [m]"""
    torque: str
    """Columns of the free moment [N m]; empty: there are none"""

    @property
    def columns(self) -> str:
        """Text that names the columns."""
        return " ".join(f"{name}(x y z)" for name in self if name)


class GroundFile(NamedTuple):
    """Ground reactions over time, and which of them act on a foot."""

    data: Storage
    forces: tuple[FootForce, ...]
    notes: tuple[str, ...]
    """What was left out, as sentences"""


def data_file(ground: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers: `ground` itself, or the one that it names if it is an external loads file.

    That file lies beside it, or is named from `folder`, in which a tool of OpenSim runs with it.

    Raises:
        UsageError: the external loads file names no file, or one that is not there.
    """
    return named_data(ground, folder) if ground.suffix.lower() == XML else ground


def named_data(loads: Path, folder: Path | None = None) -> Path:
    """Find the file with the numbers of an external loads file; it lies beside that, or is named from `folder`.

    Raises:
        UsageError: the external loads file names no file, or one that is not there.
    """
    name = text_in(read_xml(loads, "ExternalLoads"), ".//datafile")
    if name in NOTHING:
        raise UsageError(f"{loads} names no datafile, which has the numbers")
    places = [place / name for place in (loads.parent, folder) if place]
    there = next((path for path in places if path.is_file()), None)
    if there is None:
        raise UsageError(f"{loads} names the datafile {name}, which is not there")
    return there


def read_ground(ground: Path, data: Path, side: str) -> GroundFile:
    """Read the forces on the right or left foot; `data` is the file that `data_file` finds.

    Raises:
        UsageError: a file cannot be read, it is not clear which forces act on the foot, or a column is missing.
    """
    storage = read_storage(data)
    if ground.suffix.lower() == XML:
        forces, notes = by_loads(ground, side)
    else:
        forces, notes = [by_names(storage, side)], []
    for force in forces:
        missing = [name + axis for name in force if name for axis in "xyz" if name + axis not in storage.names]
        if missing:
            raise UsageError(f"{storage.path} has no column {', '.join(missing)}; it has {some(storage.names)}")
    return GroundFile(storage, tuple(forces), tuple(notes))


def by_loads(path: Path, side: str) -> tuple[list[FootForce], list[str]]:
    """Forces that an external loads file applies to bodies of a foot, and notes on forces on other bodies than feet.

    Raises:
        UsageError: there are no forces on the foot, or they are not expressed in ground.
    """
    forces: list[FootForce] = []
    bodies: list[str] = []
    elsewhere: list[str] = []
    for element in read_xml(path, "ExternalLoads").iter("ExternalForce"):
        body = text_in(element, "applied_to_body")
        bodies.append(body)
        if not applies(element) or not body:
            continue
        if is_foot(body, side):
            forces.append(foot_force(path, element))
        elif not any(is_foot(body, other) for other in SIDE_WORDS):
            elsewhere.append(body)
    if not forces:
        named = some(list(dict.fromkeys(filter(None, bodies))))
        raise UsageError(f"{path} applies no force to the {side} foot; its forces act on {named or 'nothing'}")
    return forces, [f"ground: what acts on {', '.join(elsewhere)} is left out"] * bool(elsewhere)


def foot_force(path: Path, element: ET.Element) -> FootForce:
    """Columns that an ExternalForce of an external loads file names.

    Raises:
        UsageError: it has no force or no point, or these are not expressed in ground.
    """
    where = f"{path}: the force {element.get('name', '')!r}"
    for tag in ("force_expressed_in_body", "point_expressed_in_body"):
        if text_in(element, tag) not in GROUND:
            raise UsageError(f"{where}: {tag} is {text_in(element, tag)}, and must be ground")
    force, point, torque = (text_in(element, f"{what}_identifier") for what in ("force", "point", "torque"))
    for name, value in (("force", force), ("point", point)):
        if value in NOTHING:
            raise UsageError(f"{where} has no {name}_identifier")
    return FootForce(force, point, "" if torque in NOTHING else torque)


def applies(element: ET.Element) -> bool:
    """Whether a force is enabled, by the properties of OpenSim 3 and 4."""
    return text_in(element, "isDisabled").lower() != "true" and text_in(element, "appliesForce").lower() != "false"


def is_foot(body: str, side: str) -> bool:
    """Whether a body belongs to the foot of a side, by its name."""
    return is_part(body, FOOT) and bool(words(body) & SIDE_WORDS[side])


def by_names(storage: Storage, side: str) -> FootForce:
    """Find the force whose columns name the foot, or have the names that OpenSim's examples have for it.

    Raises:
        UsageError: there is no such force, or more than one.
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
    """Beginning of the names of a free moment's columns, from that of its force; empty if there are none."""
    for turn in TURNS:
        for prefix in (stem.replace("force", turn), stem.replace("force", turn) + "m"):
            if f"{prefix}y" in names:
                return prefix
    return ""
