"""The knees of a study over one recording: scenes from parameter values, and the loads that drive them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.core.contact_laws.base import ContactLaw
from knee_contact_ros.core.contact_pairs.base import ContactPair
from knee_contact_ros.core.levels import LEVELS
from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.model import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD
from knee_contact_ros.core.plausible_depth import plausible_depth, radius_of
from knee_contact_ros.core.readouts import ContactPatch
from knee_contact_ros.core.scene import PRESCRIBED_HEIGHT, Scene
from knee_contact_ros.core.types import NANOSECOND, Status
from knee_contact_ros.offline.uncertainty.replay import Given, given_in
from knee_contact_ros.parameters.build import (
    contact_law,
    contact_pair,
    contact_patch,
    femoral_geometry,
    mechanism,
    untried_law,
)
from knee_contact_ros.parameters.compartments import COMPARTMENTS
from knee_contact_ros.parameters.curves import curve_files, read_curve
from knee_contact_ros.parameters.lateral import has_both, lateral_knee, lateral_texts
from knee_contact_ros.parameters.reading import known_parameters, variations_of
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Values = Mapping[str, Any]
"""Values of the varied parameters of a case, by name"""
KEPT_SURFACES = 64
"""Number of pairs of surfaces, and of series of loads, that are kept for the next case that has the same ones"""
SECTIONS = ("load.", "femur.", "tibia.", "translation.", "contact.", "lateral.", "fidelity.", "body_weight")
"""Prefixes of the parameters that a study may vary; the others say how a bag is read or recorded"""


class Side(NamedTuple):
    """A compartment of a case: medial (or the only one), or lateral."""

    scene: Scene
    patch: ContactPatch | None
    """Area over which the contact spreads; None where it is not known"""
    loads: Floats
    """Compressive load of the compartment [N], shape (n,)"""

    @property
    def law(self) -> ContactLaw:
        """Contact law of the compartment."""
        return self.scene.modes.law


class Surfaces(NamedTuple):
    """Parts of a scene that take long to make."""

    pair: ContactPair
    mechanism: Mechanism
    radius: float
    """Radius [m] of the circle that fits the femur"""


class Recording(NamedTuple):
    """Inputs of all ticks of a recording, arrays of shape (n,)."""

    stamps: NDArray[np.int64]
    """Stamps [ns]"""
    steps: Floats
    """Time since the tick before [s]; 0 where a run begins"""
    angles: Floats
    """Flexion angle [rad]"""
    axial: Floats
    """Axial joint reaction [N], positive in compression"""
    moment: Floats
    """Frontal moment [N m]"""
    heights: Floats
    """Prescribed femoral height [m]; not a number where it is not prescribed"""

    damage: tuple[str, ...] = ()
    """Parts of the recording that cannot be read, a sentence each"""

    @property
    def begins(self) -> list[int]:
        """Indices of the ticks with which runs begin, and at the end the number of ticks."""
        return [*np.flatnonzero(self.steps == 0.0).tolist(), len(self.steps)]


class Files:
    """Contents of the files that parameters name; each file is read once."""

    def __init__(self, known: Mapping[str, str] = MappingProxyType({})) -> None:
        """Begin with contents that are known already, by the files' names."""
        self.known = dict(known)

    def texts(self, parameters: Parameters) -> dict[str, str]:
        """Give the contents of the files that the model of some parameters needs, by parameter.

        Raises:
            UsageError: a file cannot be read.
        """
        texts = {}
        for parameter, name in curve_files(parameters).items():
            if name not in self.known:
                self.known[name] = read_curve(parameter, name)
            texts[parameter] = self.known[name]
        return texts


class Knees:
    """Makes the knees of one recording and one set of parameters, of which some are varied."""

    def __init__(self, recording: Recording, parameters: Parameters, files: Files) -> None:
        """Take what all knees have in common.

        Raises:
            UsageError: an angle or a height is too large for a knee.
        """
        self.recording, self.parameters, self.files = recording, parameters, files
        _refuse_beyond("flexion angle", recording.angles, LARGEST_ANGLE, "rad")
        _refuse_beyond("femoral height", recording.heights, LARGEST_HEIGHT, "m")
        self.varied = variations_of(parameters)
        self._surfaces = lru_cache(KEPT_SURFACES)(self._made_surfaces)
        self._medial = lru_cache(KEPT_SURFACES)(self._made_medial)

    def sides(self, parameters: Parameters, *, tried: bool) -> tuple[Side, ...]:
        """Make the compartments of a knee: the only one, or medial and lateral.

        Args:
            parameters: All parameters of the knee.
            tried: Whether to check that the contact laws keep their contract.

        Raises:
            UsageError: a surface cannot be made, a law breaks its contract, or a load is too large for a knee.
        """
        texts = self.files.texts(parameters)
        medial = self._medial(parameters.load, parameters.body_weight)
        first = self._side(parameters, texts, medial, tried=tried)
        if not has_both(parameters):
            return (first,)
        lateral, texts = lateral_knee(parameters), lateral_texts(texts)
        return first, self._side(lateral, texts, self.recording.axial - medial, tried=tried)

    def _side(self, parameters: Parameters, texts: Mapping[str, str], loads: Floats, *, tried: bool) -> Side:
        contact, fidelity = parameters.contact, parameters.fidelity
        modes = contact_law(contact) if tried else untried_law(contact)
        femur = parameters.femur.model_copy(update={"mass": 1.0})
        surfaces = self._surfaces(femur, parameters.tibia, parameters.translation, tuple(texts.items()))
        displaced = parameters.drive == "displacement"
        scene = Scene(
            pair=surfaces.pair, mechanism=surfaces.mechanism, modes=modes, mass=parameters.femur.mass,
            tolerance=fidelity.tolerance, force_tolerance=fidelity.force_tolerance, budget=fidelity.budget,
            level=PRESCRIBED_HEIGHT if displaced else LEVELS[fidelity.level],
            plausible_depth=plausible_depth(modes.law, surfaces.radius),
        )  # fmt: skip
        return Side(scene, contact_patch(contact, modes), loads)

    @staticmethod
    def _made_surfaces(femur: Any, tibia: Any, translation: Any, texts: tuple[tuple[str, str], ...]) -> Surfaces:
        by_parameter = dict(texts)
        pair = contact_pair(femoral_geometry(femur, by_parameter), tibia, by_parameter)
        return Surfaces(pair, mechanism(translation, by_parameter), radius_of(pair.femur))

    def _made_medial(self, load: Any, body_weight: float) -> Floats:
        parameters = self.parameters.model_copy(update={"load": load, "body_weight": body_weight})
        recording = self.recording
        rule = COMPARTMENTS[load.rule](parameters, self.files.texts(parameters))
        loads = np.ascontiguousarray(rule(recording.axial, recording.moment, recording.angles), dtype=float)
        _refuse_beyond("load", loads, LARGEST_LOAD, "N")
        _refuse_beyond("load", recording.axial - loads, LARGEST_LOAD, "N")
        return loads


def _refuse_beyond(what: str, values: Floats, most: float, unit: str) -> None:
    """Refuse inputs that are too large, as `KneeModel.run` does."""
    beyond = values[np.abs(values) > most]
    if beyond.size:
        raise UsageError(f"{what} {beyond[0]:g} {unit} is not allowed; at most {most:g} {unit}")


def may_vary(name: str) -> bool:
    """Whether a study may vary the parameter of a name."""
    return name.startswith(SECTIONS)


def knees_in(bag: Path, parameters: Parameters, files: Files, names: Names = OWN_NAMES) -> Knees:
    """Read a bag, and make the knees that go through its gait.

    Args:
        bag: Path of the bag.
        parameters: Parameters before any value is varied.
        files: Contents of the files that the parameters name.
        names: Names of the input topics.

    Raises:
        UsageError: bag or parameters cannot be used.
    """
    texts = files.texts(parameters)
    given = given_in(bag, parameters, lambda _done, _total: None, names, replays=0, compiled=None, curves=texts)
    return Knees(_recording(given), parameters, files)


def _recording(given: Given) -> Recording:
    rows = given.rows[0]
    stamps, resets = rows["stamp"].copy(), (rows["status"] & Status.TIME_RESET) != 0
    steps = np.diff(stamps, prepend=stamps[:1]) * NANOSECOND
    steps[resets] = 0.0
    displaced = given.parameters.drive == "displacement"
    heights = rows["femoral_height"].copy() if displaced else np.full(len(rows), np.nan)
    angles, axial, moment = (np.ascontiguousarray(column, dtype=float) for column in given[3:6])
    return Recording(stamps, steps, angles, axial, moment, heights, given.damage)


def checked_names(names: list[str]) -> None:
    """Refuse parameters that a study cannot vary; unknown ones are left to `check_value`.

    Raises:
        UsageError: a study cannot vary one of them.
    """
    for name in names:
        if name in known_parameters() and not may_vary(name):
            raise UsageError(f"{name} is not allowed; a parameter of {', '.join(SECTIONS)}")
