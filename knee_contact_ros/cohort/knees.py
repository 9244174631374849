"""The knees of a study over one recording: models from parameter values, and the loads that drive them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD, KneeModel
from knee_contact_ros.model.surfaces import ContactPair
from knee_contact_ros.model.types import NANOSECOND, Status
from knee_contact_ros.offline.uncertainty.replay import Given, given_in
from knee_contact_ros.parameters.build import build_model, contact_pair
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

    model: KneeModel
    loads: Floats
    """Compressive load of the compartment [N], shape (n,)"""


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

    def sides(self, parameters: Parameters, *, compiled: bool = False) -> tuple[Side, ...]:
        """Make the compartments of a knee, with compiled models or plain ones: the only one, or medial and lateral.

        Raises:
            UsageError: a surface or a law cannot be made, or a load is too large for a knee.
        """
        texts = self.files.texts(parameters)
        medial = self._medial(parameters.load, parameters.body_weight)
        parts = [(parameters, texts, medial)]
        if has_both(parameters):
            parts.append((lateral_knee(parameters), lateral_texts(texts), self.recording.axial - medial))
        return tuple(Side(replace(self._model(own, files), compiled=compiled), loads) for own, files, loads in parts)

    def _model(self, parameters: Parameters, texts: Mapping[str, str]) -> KneeModel:
        femur = parameters.femur.model_copy(update={"mass": 1.0})
        pair = self._surfaces(femur, parameters.tibia, parameters.translation, tuple(texts.items()))
        return build_model(parameters, pair=pair)

    def _made_surfaces(
        self, femur: Any, tibia: Any, translation: Any, texts: tuple[tuple[str, str], ...]
    ) -> ContactPair:
        parts = {"femur": femur, "tibia": tibia, "translation": translation}
        return contact_pair(self.parameters.model_copy(update=parts), dict(texts))

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
