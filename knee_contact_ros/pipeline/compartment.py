"""Compartment of the knee: its model, the state of its run, and its place in the tibia frame."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.messages.cdr import Stamps
from knee_contact_ros.messages.topics import KNEE_CONTACT, KNEE_CONTACT_LATERAL
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import FLAT, ROW, WRENCH, Rows
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.lateral import has_both, lateral_knee, lateral_texts
from knee_contact_ros.parameters.plausibility import doubts_about
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.pair_blocks import Floats

SIX = struct.Struct("<6d")
"""Force and torque in the bytes of a row"""
WRENCH_FIELDS = [f"contact_wrench_{part}_{axis}" for part in ("force", "torque") for axis in "xyz"]


class Compartment:
    """Compartment of the knee that is computed tick by tick."""

    def __init__(self, topic: str, parameters: Parameters, model: KneeModel, z: float) -> None:
        """Make a compartment at rest.

        Args:
            topic: Topic of its answers.
            parameters: Parameters of the compartment, under the names of the medial one's.
            model: Model with these parameters.
            z: Place in the tibia frame [m]; 0 for the only compartment, as the model is planar.
        """
        self.topic, self.parameters, self.model, self._z = topic, parameters, model, z
        self.doubts = doubts_about(parameters, model)
        """Implausible parameters, and implausible answers among those that are added to it"""
        self.start_anew()

    def start_anew(self) -> None:
        """Restart from rest."""
        self.stream = self.model.stream()
        row = self.stream.answer
        self._point_z = row["contact_point"]["z"]
        force, torque = row["contact_wrench"]["force"], row["contact_wrench"]["torque"]
        self._force_x, self._force_y, self._torque_x, self._torque_y = force["x"], force["y"], torque["x"], torque["y"]

    def compile(self) -> None:
        """Use the compiled model; to be called before the first tick."""
        self.model = replace(self.model, compiled=True)
        self.start_anew()

    def retune(self, parameters: Parameters, z: float) -> None:
        """Continue with other numbers among the parameters and another place [m], between two ticks."""
        self.parameters, self._z = parameters, z
        self.model = retuned(self.model, parameters)
        self.stream.go_on_with(self.model)
        self.doubts.go_on_with(doubts_about(parameters, self.model))

    @property
    def row(self) -> Rows:
        """Answer of the last tick, shape (1,); the next tick overwrites it."""
        return self.stream.answer

    def advance(self, stamp: int, angle: float, load: float, height: float | None, status: int) -> None:
        """Compute a tick at a stamp [ns] into `row`, with further bits of `Status`; see also `Stream.advance`."""
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
        """Compute many ticks, with the same bits as `advance`. All arrays have shape (n,)."""
        rows = self.stream.advance_all(stamps, angles, loads, heights)
        rows["status"] |= status.astype(np.uint8)
        move_along_z(rows, self._z)
        return rows


def move_along_z(rows: Rows, z: float) -> None:
    """Move the answers of many ticks to a compartment at a place z [m] beside the middle of the tibia."""
    if not z:
        return
    rows["contact_point"]["z"] = z
    force, torque = rows["contact_wrench"]["force"], rows["contact_wrench"]["torque"]
    torque["x"] = -z * force["y"]
    torque["y"] = z * force["x"]


def compartments_of(parameters: Parameters, texts: Mapping[str, str]) -> tuple[Compartment, ...]:
    """Make the only compartment of a knee, or the medial and the lateral one.

    `texts` has the contents of files by parameter.

    Raises:
        UsageError: a model cannot be built; see `build_model`.
    """
    z = half_spacing(parameters)
    first = Compartment(KNEE_CONTACT, parameters, build_model(parameters, curves=texts), -z)
    if not z:
        return (first,)
    own = lateral_knee(parameters)
    return first, Compartment(KNEE_CONTACT_LATERAL, own, build_model(own, curves=lateral_texts(texts)), z)


def half_spacing(parameters: Parameters) -> float:
    """Distance [m] of the compartments from the middle of the tibia; 0 if there is only one."""
    return 0.5 * parameters.load.compartment_spacing if has_both(parameters) else 0.0


def summed_wrench(rows: Sequence[bytes]) -> bytes:
    """Row of the first compartment with the sum of all contact wrenches, at the origin of the tibia frame."""
    first, *others = rows
    if not others:
        return first
    wrench = SIX.unpack_from(first, WRENCH.start)
    for row in others:
        wrench = tuple(map(add, wrench, SIX.unpack_from(row, WRENCH.start)))
    return first[: WRENCH.start] + SIX.pack(*wrench) + first[WRENCH.stop :]


def summed_wrenches(rows: Sequence[Rows]) -> Rows:
    """Rows of the first compartment with the sums of all contact wrenches, as `summed_wrench` makes them.

    `rows` has an array for each compartment, all of shape (n,).
    """
    first, *others = rows
    if not others:
        return first
    summed = np.frombuffer(bytearray(first.tobytes()), ROW)
    for more in others:
        for name in WRENCH_FIELDS:
            summed.view(FLAT)[name] += more.view(FLAT)[name]
    return summed
