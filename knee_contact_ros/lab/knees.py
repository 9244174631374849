"""Many knees through the same gait, in memory: their models and answers."""

import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model.knee import LARGEST_ANGLE, LARGEST_HEIGHT, LARGEST_LOAD, KneeModel
from ..model.ringing import LEAST_PART
from ..model.surfaces import ContactPair
from ..model.types import ROW, Floats, Rows, Status
from ..parameters.build import build_model, contact_pair, load_rule
from ..parameters.curves import curve_files, lateral_texts, read_curve
from ..parameters.files import known_parameters, variations_of
from ..parameters.schema import (
    Parameters,
    has_two_compartments,
    lateral_knee,
    without_effect,
)
from ..streams.compartments import half_spacing, move_along_z
from ..system.errors import UsageError
from ..system.portable import usable_processors
from .outcomes import OUTCOME_RECORD, outcomes_of
from .recordings import Recording

_CONTACT = "contact."
CACHE_SIZE = 64
"""Number of pairs of surfaces, and of series of loads, that are kept for later cases with the same ones"""
VARIABLE_PREFIXES = (
    "load.",
    "femur.",
    "tibia.",
    "translation.",
    "contact.",
    "lateral.",
    "fidelity.",
    "body_weight",
)
"""Beginnings of the names of the parameters that a study may vary; the others say how a bag is read or recorded"""
INPUT_PARAMETERS = ("load.source", "load.rotation", "load.offset")
"""Parameters with such names that say how a bag is read; an uncertain `axial_load` is an uncertain offset"""
ANSWERS_AT_ONCE = 16_384
"""Number of answers that a thread holds at a time: about 4 MB, which fit into a processor's cache"""


class Side(NamedTuple):
    """A compartment of a knee: medial (or the only one), or lateral."""

    model: KneeModel
    loads: Floats
    """Compressive load of the compartment [N], shape (n,)"""
    z: float
    """Place in the tibia frame [m]"""


class Knees:
    """Makes the knees of one recording and one set of parameters, some of which vary."""

    def __init__(
        self, recording: Recording, parameters: Parameters, files: Mapping[str, str]
    ) -> None:
        """Set what all knees have in common; `files` has contents of files by name, other files are read.

        Raises:
            UsageError: an angle or a height is too large for a knee.
        """
        self.recording = recording
        self.parameters = parameters
        self.files = dict(files)
        _check_size("flexion angle", recording.angles, LARGEST_ANGLE, "rad")
        _check_size("femoral height", recording.heights, LARGEST_HEIGHT, "m")
        self.vary = variations_of(parameters)
        self._medial_loads = lru_cache(CACHE_SIZE)(self._compute_medial_loads)

    def sides(self, parameters: Parameters, *, compiled: bool = False) -> tuple[Side, ...]:
        """Make the compartments of a knee, compiled or not: the only one, or medial and lateral.

        Raises:
            UsageError: a surface or a law cannot be made, or a load is too large for a knee.
        """

        def side(
            parameters: Parameters, texts: Mapping[str, str], loads: Floats, z: float
        ) -> Side:
            # Surfaces do not depend on the mass, so knees with other masses share them.
            femur = parameters.femur.model_copy(update={"mass": 1.0})
            pair = _surfaces(femur, parameters.tibia, parameters.translation, *texts.items())
            model = replace(build_model(parameters, pair=pair), compiled=compiled)
            return Side(model, loads, z)

        texts = file_texts(parameters, self.files)
        z = half_spacing(parameters)
        loads = self._medial_loads(parameters.load, parameters.body_weight)
        medial = side(parameters, texts, loads, -z)
        if not has_two_compartments(parameters):
            return (medial,)
        lateral_loads = self.recording.axial - loads
        return medial, side(lateral_knee(parameters), lateral_texts(texts), lateral_loads, z)

    def _compute_medial_loads(self, load: Any, body_weight: float) -> Floats:
        """Compute the loads of the medial compartment, or of the only one."""
        parameters = self.parameters.model_copy(update={"load": load, "body_weight": body_weight})
        recording = self.recording
        rule = load_rule(parameters, file_texts(parameters, self.files))
        if rule.by_moment and np.isnan(recording.moment).any():
            raise UsageError("gait: load rule moment_balance needs frontal_moment")
        loads = np.ascontiguousarray(
            rule(recording.axial, recording.moment, recording.angles), dtype=float
        )
        if recording.share:
            loads = loads + recording.share * recording.axial
        _check_size("load", loads, LARGEST_LOAD, "N")
        _check_size("load", recording.axial - loads, LARGEST_LOAD, "N")
        return loads


@lru_cache(CACHE_SIZE)
def _surfaces(femur: Any, tibia: Any, translation: Any, *texts: tuple[str, str]) -> ContactPair:
    """Make surfaces and mechanism from sections of the parameters, and contents of files by parameter."""
    sections = {"femur": femur, "tibia": tibia, "translation": translation}
    return contact_pair(Parameters().model_copy(update=sections), dict(texts))


def file_texts(parameters: Parameters, files: dict[str, str]) -> dict[str, str]:
    """Return the contents of the files that the model of some parameters needs, by parameter.

    `files` has contents by the files' names; a file that is not in it is read once, and added.

    Raises:
        UsageError: a file cannot be read.
    """
    for parameter, name in curve_files(parameters).items():
        if name not in files:
            files[name] = read_curve(parameter, name)
    return {parameter: files[name] for parameter, name in curve_files(parameters).items()}


def _check_size(what: str, values: Floats, most: float, unit: str) -> None:
    """Refuse inputs that are too large, as `KneeModel.run` does."""
    beyond = values[np.abs(values) > most]
    if beyond.size:
        raise UsageError(f"{what} {beyond[0]:g} {unit} is not allowed; at most {most:g} {unit}")


def idle_doubt(parameters: Parameters, varied: Iterable[str]) -> list[str]:
    """Return a sentence that some varied parameters do nothing, so that cases repeat each other, in a list."""
    names = list(varied)
    if "contact.law" in names or "contact.stiffness_from" in names:
        return []
    own = [name.removeprefix(_CONTACT) for name in names if name.startswith(_CONTACT)]
    sentence = without_effect(parameters.contact, own)
    return [f"{sentence}: cases repeat each other"] if sentence else []


def check_may_vary(names: Iterable[str]) -> None:
    """Refuse parameters that a study cannot vary; unknown ones are left to `check_value`.

    Raises:
        UsageError: a study cannot vary one of them.
    """
    for name in names:
        if name in known_parameters() and (
            name in INPUT_PARAMETERS or not name.startswith(VARIABLE_PREFIXES)
        ):
            raise UsageError(
                f"{name} is not allowed; a parameter of {', '.join(VARIABLE_PREFIXES)}, without "
                f"{', '.join(INPUT_PARAMETERS)}"
            )


class Computed(NamedTuple):
    """Results of k cases that were computed together."""

    parameters: list[Parameters | None]
    """All parameters of each case; None where a case failed"""
    failed: list[str]
    """Why a case has no outcomes; empty if it has them"""
    outcomes: list[NDArray[Any]]
    """Outcomes of the only or medial, and of the lateral compartment: records of `OUTCOME_RECORD`, shape (k,);
    NaN where a case has none"""
    series: list[Rows]
    """Answers of each compartment, shape (k, n), zeros where a case has none; none unless they were requested"""
    seconds: float
    """Mean time [s] of a case"""

    @property
    def ringing(self) -> float:
        """Largest ringing [N] of a case that is large enough to be told; 0 if there is none."""
        told = [
            rows["ringing"][rows["ringing"] > LEAST_PART * rows["peak_force"]]
            for rows in self.outcomes
        ]
        return float(np.concatenate(told).max(initial=0.0))

    def has(self, side: int) -> NDArray[np.bool_]:
        """Whether a case has answers of a compartment (0 or 1), shape (k,)."""
        known: NDArray[np.bool_] = np.isfinite(self.outcomes[side]["ticks"])
        return known


def compute(
    knees: Knees,
    cases: Sequence[Mapping[str, Any]],
    *,
    series: bool = False,
    threads: int = 1,
    compiled: bool = True,
) -> Computed:
    """Compute cases; the answers have the same bits as a run of each case alone.

    Args:
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        series: Whether to keep all answers.
        threads: Number of threads; 0: one for each processor.
        compiled: Whether to use the compiled model.
    """
    begun = time.perf_counter()
    recording = knees.recording
    parameters: list[Parameters | None] = [None] * len(cases)
    failed = [""] * len(cases)
    runs = list[tuple[int, int, Side]]()
    for i, values in enumerate(cases):
        try:
            own = knees.vary(values)
            sides = knees.sides(own, compiled=compiled)
        except (UsageError, ValueError) as error:
            failed[i] = str(error)
        else:
            parameters[i] = own
            runs += [(i, place, side) for place, side in enumerate(sides)]
    found = [np.full(len(cases), np.nan, OUTCOME_RECORD) for _ in range(2)]
    ticks = len(recording.steps)
    both = any(place for _, place, _ in runs)
    kept = [np.zeros((len(cases), ticks), ROW) for _ in range(1 + both)] if series else []

    def compute_runs(part: Sequence[tuple[int, int, Side]]) -> None:
        sides = [side for *_, side in part]
        answers = _answers(recording, sides)
        laws = [side.model.law for side in sides]
        patches = [side.model.patch for side in sides]
        rows = outcomes_of(answers, recording.steps, laws, patches)
        for row, side, own in zip(rows, sides, answers, strict=True):
            row["ringing"] = np.abs(side.model.ringing(own)).max()
        for (i, place, side), row, answer in zip(part, rows, answers, strict=True):
            found[place][i] = row
            if kept:
                move_along_z(answer, side.z)
                kept[place][i] = answer

    count = max(1, ANSWERS_AT_ONCE // ticks)
    parts = [runs[first : first + count] for first in range(0, len(runs), count)]
    with ThreadPoolExecutor(threads or usable_processors()) as pool:
        list(pool.map(compute_runs, parts))
    seconds = (time.perf_counter() - begun) / max(len(cases), 1)
    return Computed(parameters, failed, found, kept, seconds)


def _answers(recording: Recording, sides: Sequence[Side]) -> Rows:
    """Compute k compartments through a recording, shape (k, n)."""
    answers = np.zeros((len(sides), len(recording.steps)), ROW)
    samples = np.column_stack(
        [recording.steps, recording.angles, np.zeros_like(recording.steps), recording.heights]
    )
    for side, own in zip(sides, answers, strict=True):
        samples[:, 2] = side.loads
        for begin, end in zip(recording.begins, recording.begins[1:], strict=False):
            side.model.compute(samples[begin:end], own[begin:end])
    answers["stamp"] = recording.stamps
    answers["status"][:, recording.begins[1:-1]] |= np.uint8(Status.TIME_RESET)
    return answers
