"""What the model was given in a recording, and what it answers to that with other inputs and parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.provenance import Provenance
from knee_contact_ros.bags.topic_names import OWN_NAMES, Names
from knee_contact_ros.compiled.choice import forced, worth_compiling
from knee_contact_ros.core.types import Rows, Status
from knee_contact_ros.offline.solve import solve, texts_of
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
from knee_contact_ros.pipeline.compartment import Compartment, aside, compartments_of
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.system.errors import UsageError

Floats = NDArray[np.float64]
Moved = Mapping[Deviation, float]
"""How many standard deviations each is off"""


class Given(NamedTuple):
    """What the ticks of a recording were given, arrays of shape (n,), and with which parameters."""

    parameters: Parameters
    texts: Mapping[str, str]
    """Contents of files by parameter"""
    rows: tuple[Rows, ...]
    """The answers of each compartment"""
    angles: Floats
    """[rad]"""
    axial: Floats
    """[N]"""
    moment: Floats
    """[N m]"""
    compartments: tuple[Compartment, ...]
    """To answer with"""
    asked: bool | None
    """Whether with the compiled kernel; None: if that answers sooner"""
    compiled: bool
    damage: tuple[str, ...]
    """What of the recording cannot be read, as sentences"""

    def ready_for(self, replays: int) -> Given:
        """The same, to be answered so many times more: for many it is compiled."""
        scene, ticks = self.compartments[0].model.scene, replays * sum(map(len, self.rows))
        wanted = worth_compiling(scene, ticks) if self.asked is None else self.asked
        for compartment in self.compartments if wanted and not self.compiled else ():
            compartment.compile(forced)
        return self._replace(compiled=self.compiled or wanted)

    def answers(self, moved: Moved) -> list[Rows]:
        """The answers of each compartment to inputs and parameters that are off.

        A lateral parameter that is the medial one's is off with it, unless it is among those moved. Off by nothing,
        the bits are the recording's.

        Raises:
            UsageError: a parameter leaves its range, or an input that of a knee.
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
        found = []
        for compartment, loads in zip(self._compartments(parameters, moved), (medial, axial - medial), strict=False):
            parts = []
            for part in np.split(np.arange(len(stamps)), np.flatnonzero(status)):
                if len(part):
                    ours = slice(part[0], part[-1] + 1)
                    height = None if heights is None else heights[ours]
                    parts.append(_run(compartment, stamps[ours], angles[ours], loads[ours], height, status[ours]))
            found.append(np.concatenate(parts))
        return found

    def _compartments(self, parameters: Parameters, moved: Moved) -> Sequence[Compartment]:
        """Those of other parameters: ours with other numbers, unless other surfaces have to be made."""
        if any(times and of_a_surface(deviation.name) for deviation, times in moved.items()):
            made = compartments_of(parameters, self.texts)
            for compartment in made if self.compiled else ():
                compartment.compile(forced)
            return made
        z = aside(parameters)
        for compartment, own, place in zip(
            self.compartments, (parameters, lateral_knee(parameters)), (-z, z), strict=False
        ):
            compartment.retune(own, place)
        return self.compartments

    def _parameters(self, moved: Moved) -> Parameters:
        values = flat_parameters(self.parameters)
        known = {name: self._value(name) for name in (each.name for each in moved) if name not in STREAMS}
        off = {each.name: each.moved(known[each.name], times) for each, times in moved.items() if each.name in known}
        return load_parameters(values | off) if off else self.parameters

    def _value(self, name: str) -> float:
        part: Any = self.parameters
        for step in name.split("."):
            part = getattr(part, step)
        return float(part)


def given_in(
    bag: Path, how: Parameters | Provenance, advance: Callable[[int, int], None], names: Names = OWN_NAMES,
    *, replays: int, compiled: bool | None = None, curves: Mapping[str, str] | None = None,
) -> Given:  # fmt: skip
    """What the model is given in a bag, to be answered `replays` times more. The arguments are those of `solve`.

    All answers are held in memory: 300 B a tick and compartment.

    Raises:
        UsageError: as `solve`; or parameters changed while the recording was made, so that no model made all of it.
    """
    if isinstance(how, Provenance) and how.changes:
        raise UsageError(
            f"bag {bag}: its parameters changed, or the model was reset; uncertainty needs a constant model"
        )
    parameters = how.parameters if isinstance(how, Provenance) else how
    texts = texts_of(how) if curves is None else curves
    taken: list[tuple[Any, Any, Any]] = []
    blocks: list[Sequence[Rows]] = []

    def listen(pipeline: Pipeline) -> None:
        rule = pipeline.rule

        def told(axial: Any, moment: Any, flexion: Any) -> Any:
            taken.append((axial, moment, flexion))
            return rule(axial, moment, flexion)

        pipeline.rule = told

    summary = solve(
        bag, how, None, advance, names=names, compiled=compiled, keep=blocks.append, prepare=listen, curves=texts
    )
    axial, moment, angles = (
        np.concatenate([np.atleast_1d(one) for one in column]) for column in zip(*taken, strict=True)
    )
    rows = tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))
    ours = compartments_of(parameters, texts)
    damage = tuple(summary.damage)
    given = Given(parameters, texts, rows, angles, axial, moment, ours, compiled, compiled=False, damage=damage)
    return given.ready_for(replays)


def _run(compartment: Compartment, *columns: Any) -> Rows:
    """Answer ticks from rest; the columns are those of `Compartment.advance_all`.

    Raises:
        UsageError: a value is no knee's.
    """
    compartment.start_anew()
    try:
        return compartment.advance_all(*columns)
    except ValueError as error:
        raise UsageError(f"uncertainty: {error}") from None


def of_a_surface(name: str) -> bool:
    """Whether a parameter is one of a surface or a mechanism, which are made anew for it."""
    return name.removeprefix(LATERAL).startswith(("femur.", "tibia.", "translation.")) and not name.endswith(".mass")
