"""The knees of a study over one recording: from parameter values to scenes, and to the loads that drive them."""

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
from knee_contact_ros.core.types import Status
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
"""Parameters of a case, by their names"""
NANOSECOND = 1e-9
KEPT_SURFACES = 64
"""Pairs of surfaces that are not made anew, and loads"""
SECTIONS = ("load.", "femur.", "tibia.", "translation.", "contact.", "lateral.", "fidelity.", "body_weight")
"""What the names of the parameters begin with that a study may vary: the others say how a bag is read or recorded"""


class Side(NamedTuple):
    """A compartment of a case."""

    scene: Scene
    patch: ContactPatch | None
    loads: Floats
    """[N], shape (n,)"""

    @property
    def law(self) -> ContactLaw:
        """Its contact law."""
        return self.scene.modes.law


class Surfaces(NamedTuple):
    """What takes long to make."""

    pair: ContactPair
    mechanism: Mechanism
    radius: float
    """Of the circle that fits the femur [m]"""


class Recording(NamedTuple):
    """What the ticks of a recording are, arrays of shape (n,)."""

    stamps: NDArray[np.int64]
    """[ns]"""
    steps: Floats
    """Since the tick before [s]; 0 where a run begins"""
    angles: Floats
    """[rad]"""
    axial: Floats
    """[N]"""
    moment: Floats
    """[N m]"""
    heights: Floats
    """[m]; not a number unless they are prescribed"""

    damage: tuple[str, ...] = ()
    """What of it cannot be read, as sentences"""

    @property
    def begins(self) -> list[int]:
        """Where runs begin, and the number of ticks."""
        return [*np.flatnonzero(self.steps == 0.0).tolist(), len(self.steps)]


class Files:
    """Contents of the files that parameters name; each is read once."""

    def __init__(self, known: Mapping[str, str] = MappingProxyType({})) -> None:
        """With those that are known, by the files' names."""
        self.known = dict(known)

    def texts(self, parameters: Parameters) -> dict[str, str]:
        """Contents of the files that answers with some parameters need, by parameter.

        Raises:
            UsageError: one cannot be read.
        """
        texts = {}
        for parameter, name in curve_files(parameters).items():
            if name not in self.known:
                self.known[name] = read_curve(parameter, name)
            texts[parameter] = self.known[name]
        return texts


class Knees:
    """Makes the knees of one recording and one set of parameters, others being varied."""

    def __init__(self, recording: Recording, parameters: Parameters, files: Files) -> None:
        """What is common to all of them.

        Raises:
            UsageError: an angle or a height is none of a knee.
        """
        self.recording, self.parameters, self.files = recording, parameters, files
        _refuse_beyond("flexion angle", recording.angles, LARGEST_ANGLE, "rad")
        _refuse_beyond("femoral height", recording.heights, LARGEST_HEIGHT, "m")
        self.varied = variations_of(parameters)
        self._surfaces = lru_cache(KEPT_SURFACES)(self._made_surfaces)
        self._medial = lru_cache(KEPT_SURFACES)(self._made_medial)

    def sides(self, parameters: Parameters, *, tried: bool) -> tuple[Side, ...]:
        """The only compartment, or medial and lateral; whether the laws are `tried` against their contract.

        Raises:
            UsageError: a surface cannot be made, a law breaks its contract, or a load is none of a knee.
        """
        texts = self.files.texts(parameters)
        medial = self._medial(parameters.load, parameters.body_weight)
        first = self._side(parameters, texts, medial, tried=tried)
        if not has_both(parameters):
            return (first,)
        own, texts = lateral_knee(parameters), lateral_texts(texts)
        return first, self._side(own, texts, self.recording.axial - medial, tried=tried)

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
        own = dict(texts)
        pair = contact_pair(femoral_geometry(femur, own), tibia, own)
        return Surfaces(pair, mechanism(translation, own), radius_of(pair.femur))

    def _made_medial(self, load: Any, body_weight: float) -> Floats:
        parameters = self.parameters.model_copy(update={"load": load, "body_weight": body_weight})
        given = self.recording
        rule = COMPARTMENTS[load.rule](parameters, self.files.texts(parameters))
        loads = np.ascontiguousarray(rule(given.axial, given.moment, given.angles), dtype=float)
        _refuse_beyond("load", loads, LARGEST_LOAD, "N")
        _refuse_beyond("load", given.axial - loads, LARGEST_LOAD, "N")
        return loads


def _refuse_beyond(what: str, values: Floats, most: float, unit: str) -> None:
    """Refuse what the model is given as `KneeModel.run` does.

    Raises:
        UsageError: a value is too large.
    """
    beyond = values[np.abs(values) > most]
    if beyond.size:
        raise UsageError(f"{what} {beyond[0]:g} {unit} is not allowed; at most {most:g} {unit}")


def may_vary(name: str) -> bool:
    """Whether a study may vary a parameter."""
    return name.startswith(SECTIONS)


def knees_in(bag: Path, parameters: Parameters, files: Files, names: Names = OWN_NAMES) -> Knees:
    """The knees over a bag's gait.

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
    """Refuse parameters that a study cannot vary.

    Raises:
        UsageError: one of them.
    """
    for name in names:
        if name in known_parameters() and not may_vary(name):
            raise UsageError(f"{name} is not allowed; a parameter of {', '.join(SECTIONS)}")
