"""Inputs of the model in a recording, and its answers to them with errors of inputs and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.types import Rows, Status
from knee_contact_ros.offline.solve import parameters_in, solve, texts_of
from knee_contact_ros.offline.uncertainty.deviations import (
    AXIAL_LOAD,
    FEMORAL_HEIGHT,
    FLEXION_ANGLE,
    MEDIAL_SHARE,
    STREAMS,
    Deviation,
)
from knee_contact_ros.parameters.compartments import COMPARTMENTS
from knee_contact_ros.parameters.lateral import LATERAL, lateral_knee
from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.compartment import Compartment, compartments_of, half_spacing
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Moved = Mapping[Deviation, float]
"""Errors of inputs and parameters, in standard deviations of each"""


class Given(NamedTuple):
    """Inputs of the ticks of a recording, arrays of shape (n,), and the parameters it was computed with."""

    parameters: Parameters
    texts: Mapping[str, str]
    """Contents of the files that parameters name, by parameter"""
    rows: tuple[Rows, ...]
    """Answers of each compartment, arrays of shape (n,)"""
    angles: Floats
    """Flexion angles [rad]"""
    axial: Floats
    """Axial loads [N]"""
    moment: Floats
    """Frontal moments [N m]"""
    compartments: tuple[Compartment, ...]
    """Compartments that compute the answers to inputs with errors"""
    wanted: bool | None
    """Whether the compiled model is to be used; None: if it is quicker, with its compilation"""
    compiled: bool
    """Whether the compartments use the compiled model"""
    damage: tuple[str, ...]
    """Damage of the recording, as sentences"""

    def ready_for(self, replays: int) -> Given:
        """Return the same inputs, prepared for so many replays: for many, the model is compiled."""
        ticks = replays * sum(map(len, self.rows))
        compiles = worth_compiling(ticks) if self.wanted is None else self.wanted
        for compartment in self.compartments if compiles and not self.compiled else ():
            compartment.compile()
        return self._replace(compiled=self.compiled or compiles)

    def answers(self, moved: Moved) -> list[Rows]:
        """Return the answers of each compartment to inputs and parameters with errors.

        A lateral parameter that follows its medial one has the same error, unless it is in `moved` itself. Without
        errors the answers are those of the recording, bit for bit.

        Raises:
            UsageError: a parameter leaves its range, or an input the range of a knee.
        """
        parameters = self._parameters(moved)
        by_name = {deviation.name: (deviation, times) for deviation, times in moved.items()}

        def off(name: str, values: Any) -> Any:
            if name not in by_name:
                return values
            deviation, times = by_name[name]
            return deviation.moved(values, times)

        angles, axial = off(FLEXION_ANGLE, self.angles), off(AXIAL_LOAD, self.axial)
        medial = COMPARTMENTS[parameters.load.rule](parameters, self.texts)(axial, self.moment, angles)
        if MEDIAL_SHARE in by_name:
            medial = medial + off(MEDIAL_SHARE, 0.0) * axial
        stamps, status = self.rows[0]["stamp"], self.rows[0]["status"] & Status.TIME_RESET
        displaced = parameters.drive == "displacement"
        heights = off(FEMORAL_HEIGHT, self.rows[0]["femoral_height"].copy()) if displaced else None
        answers = []
        for compartment, loads in zip(self._compartments(parameters, moved), (medial, axial - medial), strict=False):
            parts = []
            for part in np.split(np.arange(len(stamps)), np.flatnonzero(status)):
                if len(part):
                    rows = slice(part[0], part[-1] + 1)
                    height = None if heights is None else heights[rows]
                    parts.append(_run(compartment, stamps[rows], angles[rows], loads[rows], height, status[rows]))
            answers.append(np.concatenate(parts))
        return answers

    def _compartments(self, parameters: Parameters, moved: Moved) -> Sequence[Compartment]:
        """Return compartments with other parameters: the same ones retuned, unless surfaces have to be made anew."""
        if any(times and of_a_surface(deviation.name) for deviation, times in moved.items()):
            new = compartments_of(parameters, self.texts)
            for compartment in new if self.compiled else ():
                compartment.compile()
            return new
        z = half_spacing(parameters)
        for compartment, own, place in zip(
            self.compartments, (parameters, lateral_knee(parameters)), (-z, z), strict=False
        ):
            compartment.retune(own, place)
        return self.compartments

    def _parameters(self, moved: Moved) -> Parameters:
        """Return the parameters with their errors."""
        values = flat_parameters(self.parameters)
        off = {
            deviation.name: deviation.moved(self._value(deviation.name), times)
            for deviation, times in moved.items()
            if deviation.name not in STREAMS
        }
        return load_parameters(values | off) if off else self.parameters

    def _value(self, name: str) -> float:
        """Return the value of a parameter by its dotted name; a lateral one may follow the medial one."""
        part: Any = self.parameters
        for step in name.split("."):
            part = getattr(part, step)
        return float(part)


def given_in(
    bag: Path, basis: Parameters | Provenance, advance: Callable[[int, int], None], names: Names = OWN_NAMES,
    *, replays: int, compiled: bool | None = None, curves: Mapping[str, str] | None = None,
) -> Given:  # fmt: skip
    """Read the inputs of the model from a bag, to be answered `replays` times; other arguments are those of `solve`.

    All answers are held in memory: 300 B for each tick and compartment.

    Raises:
        UsageError: the bag cannot be used, see `solve`; or parameters changed while the recording was made.
    """
    if isinstance(basis, Provenance) and basis.changes:
        raise UsageError(
            f"bag {bag}: its parameters changed, or the model was reset; uncertainty needs a constant model"
        )
    parameters = parameters_in(basis)
    texts = texts_of(basis) if curves is None else curves
    inputs: list[tuple[Any, Any, Any]] = []
    blocks: list[Sequence[Rows]] = []

    def listen(pipeline: Pipeline) -> None:
        rule = pipeline.rule

        def noting(axial: Any, moment: Any, flexion: Any) -> Any:
            inputs.append((axial, moment, flexion))
            return rule(axial, moment, flexion)

        pipeline.rule = noting

    summary = solve(
        bag, basis, None, advance, names=names, compiled=compiled, keep=blocks.append, prepare=listen, curves=texts
    )
    axial, moment, angles = (
        np.concatenate([np.atleast_1d(one) for one in column]) for column in zip(*inputs, strict=True)
    )
    rows = tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))
    compartments = compartments_of(parameters, texts)
    damage = tuple(summary.damage)
    given = Given(parameters, texts, rows, angles, axial, moment, compartments, compiled, False, damage)
    return given.ready_for(replays)


def _run(compartment: Compartment, *columns: Any) -> Rows:
    """Compute ticks from rest; the columns are the arguments of `Compartment.advance_all`.

    Raises:
        UsageError: a value is outside the range of a knee.
    """
    compartment.start_anew()
    try:
        return compartment.advance_all(*columns)
    except ValueError as error:
        raise UsageError(f"uncertainty: {error}") from None


def of_a_surface(name: str) -> bool:
    """Return whether a parameter belongs to a surface or a mechanism, which are made anew when it changes."""
    return name.removeprefix(LATERAL).startswith(("femur.", "tibia.", "translation.")) and not name.endswith(".mass")
