"""A compartment of the knee: its model, the run through it, and where it lies."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import FLAT, ROW, WRENCH, Rows
from knee_contact_ros.messages.cdr import Stamps
from knee_contact_ros.messages.topics import KNEE_CONTACT, KNEE_CONTACT_LATERAL
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.lateral import has_both, lateral_knee, lateral_texts
from knee_contact_ros.parameters.plausibility import doubts_about
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.pair_blocks import Floats

SIX = struct.Struct("<6d")
"""Force and torque among the bytes of a row"""
OF_WRENCH = [f"contact_wrench_{part}_{axis}" for part in ("force", "torque") for axis in "xyz"]


class Compartment:
    """Takes its part of the load, tick by tick."""

    def __init__(self, topic: str, parameters: Parameters, model: KneeModel, z: float) -> None:
        """A compartment at rest.

        Args:
            topic: of its answers.
            parameters: its own, under the names of the medial one's.
            model: theirs.
            z: [m] where it lies in the tibia frame; 0 for the only one, as the model is planar.
        """
        self.topic, self.parameters, self.model, self._z = topic, parameters, model, z
        self.doubts = doubts_about(parameters, model)
        """What makes no sense: in the parameters, and in the answers that are told to it"""
        self.start_anew()

    def start_anew(self) -> None:
        """Start from rest."""
        self.stream = self.model.stream()
        row = self.stream.answer
        self._point_z = row["contact_point"]["z"]
        force, torque = row["contact_wrench"]["force"], row["contact_wrench"]["torque"]
        self._force_x, self._force_y, self._torque_x, self._torque_y = force["x"], force["y"], torque["x"], torque["y"]

    def compile(self, kernel: Callable[[KneeModel], KneeModel]) -> None:
        """Go on as `kernel` has it; before the first tick."""
        self.model = kernel(self.model)
        self.start_anew()

    def retune(self, parameters: Parameters, z: float) -> None:
        """Go on with other numbers, between two ticks."""
        self.parameters, self._z = parameters, z
        self.model = retuned(self.model, parameters)
        self.stream.go_on_with(self.model)
        self.doubts.go_on_with(doubts_about(parameters, self.model))

    @property
    def row(self) -> Rows:
        """The answer to the last tick, shape (1,); the next one is written over it."""
        return self.stream.answer

    def advance(self, stamp: int, angle: float, load: float, height: float | None, status: int) -> None:
        """Compute a tick, at a stamp [ns], into `row`; see `Stream.advance` for the others, and bits of `Status`."""
        self.stream.advance(stamp, angle, load, height)
        if status:
            self.row["status"] |= status
        if self._z:
            self._point_z[0] = self._z
            self._torque_x[0] = -self._z * self._force_y[0]
            self._torque_y[0] = self._z * self._force_x[0]

    def advance_all(
        self, stamps: Stamps, angles: Floats, loads: Floats, heights: Floats | None, status: NDArray[Any]
    ) -> Rows:
        """Compute many ticks: the same bits. All arrays have shape (n,)."""
        rows = self.stream.advance_all(stamps, angles, loads, heights)
        rows["status"] |= status.astype(np.uint8)
        put_aside(rows, self._z)
        return rows


def put_aside(rows: Rows, z: float) -> None:
    """Let answers be those of a compartment that lies beside the middle of the tibia, so far [m]."""
    if not z:
        return
    rows["contact_point"]["z"] = z
    force, torque = rows["contact_wrench"]["force"], rows["contact_wrench"]["torque"]
    torque["x"] = -z * force["y"]
    torque["y"] = z * force["x"]


def compartments_of(parameters: Parameters, texts: Mapping[str, str]) -> tuple[Compartment, ...]:
    """The only compartment of a knee, or medial and lateral; `texts` has the contents of files by parameter.

    Raises:
        UsageError: see `build_model`.
    """
    z = aside(parameters)
    first = Compartment(KNEE_CONTACT, parameters, build_model(parameters, curves=texts), -z)
    if not z:
        return (first,)
    own = lateral_knee(parameters)
    return first, Compartment(KNEE_CONTACT_LATERAL, own, build_model(own, curves=lateral_texts(texts)), z)


def aside(parameters: Parameters) -> float:
    """How far [m] the compartments lie from the middle of the tibia; 0 if there is one."""
    return 0.5 * parameters.load.compartment_spacing if has_both(parameters) else 0.0


def summed_wrench(rows: Sequence[bytes]) -> bytes:
    """The row of the first compartment with the contact wrench of all, at the origin of the tibia frame."""
    first, *others = rows
    if not others:
        return first
    wrench = SIX.unpack_from(first, WRENCH.start)
    for row in others:
        wrench = tuple(map(add, wrench, SIX.unpack_from(row, WRENCH.start)))
    return first[: WRENCH.start] + SIX.pack(*wrench) + first[WRENCH.stop :]


def summed_wrenches(rows: Sequence[Rows]) -> Rows:
    """The same of many answers: an array of rows for each compartment, all of shape (n,)."""
    first, *others = rows
    if not others:
        return first
    summed = np.frombuffer(bytearray(first.tobytes()), ROW)
    for more in others:
        for name in OF_WRENCH:
            summed.view(FLAT)[name] += more.view(FLAT)[name]
    return summed
