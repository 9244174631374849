"""The compartments of a knee, tick by tick, and the sum of their wrenches."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.knee import KneeModel
from ..model.types import FLAT, ROW, WRENCH_BYTES, Floats, Rows, Stamps
from ..parameters.build import build_model, retuned
from ..parameters.curves import lateral_texts
from ..parameters.schema import Parameters, has_two_compartments, lateral_knee
from .topics import KNEE_CONTACT, KNEE_CONTACT_LATERAL, is_lateral
from .watch import doubts_about

WRENCH_NUMBERS = struct.Struct("<6d")
"""Force and torque in the bytes of a row"""
WRENCH_FIELDS = [f"contact_wrench_{part}_{axis}" for part in ("force", "torque") for axis in "xyz"]
"""Names in `FLAT` of the numbers of a wrench"""


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
        self.topic = topic
        self.parameters = parameters
        self.model = model
        self._z = z
        self.doubts = doubts_about(parameters, model, z > 0.0)
        """Implausible parameters, and implausible ones among the answers added to it"""
        self.restart()

    def restart(self) -> None:
        """Restart from rest."""
        self.stream = self.model.stream()
        # Fields of the row are looked up once: that takes as long as to find the contact.
        row = self.stream.answer
        self._status = row["status"]
        self._point_z = row["contact_point"]["z"]
        self._force_x = row["contact_wrench"]["force"]["x"]
        self._force_y = row["contact_wrench"]["force"]["y"]
        self._torque_x = row["contact_wrench"]["torque"]["x"]
        self._torque_y = row["contact_wrench"]["torque"]["y"]

    def compile_model(self) -> None:
        """Use the compiled model; to be called before the first tick."""
        self.model = replace(self.model, compiled=True)
        self.restart()

    def retune(self, parameters: Parameters, z: float) -> None:
        """Continue with changed numbers among the parameters and another place [m], between two ticks."""
        is_shifted = _offsets(parameters) != _offsets(self.parameters)
        self.parameters = parameters
        self._z = z
        self.model = retuned(self.model, parameters)
        self.stream.continue_with(self.model)
        doubts = doubts_about(parameters, self.model, z > 0.0)
        self.doubts.continue_with(doubts)
        if is_shifted:  # the inputs before say nothing of those that come
            self.doubts.inputs = doubts.inputs

    @property
    def row(self) -> Rows:
        """Answer of the last tick, shape (1,); the next tick overwrites it."""
        return self.stream.answer

    def compute_row(
        self,
        stamp: int,
        angle: float,
        load: float,
        height: float | None,
        status: int,
        is_lost: bool = False,
    ) -> bytes:
        """Compute a tick at a stamp [ns]; return the bytes of its row, with further bits of `Status`.

        `is_lost`: the tick lies in the middle of an unknown motion. See also `Stream.advance`.
        """
        self.stream.advance(stamp, angle, load, height)
        if is_lost:
            self.stream.mark_state_lost()
        if status:
            self._status |= status
        if self._z:
            self._point_z[0] = self._z
            self._torque_x[0] = -self._z * self._force_y[0]
            self._torque_y[0] = self._z * self._force_x[0]
        return self.stream.answer.tobytes()

    def compute_rows(
        self,
        stamps: Stamps,
        angles: Floats,
        loads: Floats,
        heights: Floats | None,
        status: NDArray[Any],
    ) -> Rows:
        """Compute many ticks, with the same bits as `compute_row`. All arrays have shape (n,)."""
        rows = self.stream.advance_all(stamps, angles, loads, heights)
        rows["status"] |= status.astype(np.uint8)
        move_along_z(rows, self._z)
        return rows


def _offsets(parameters: Parameters) -> tuple[float, float]:
    """Offsets of the angles [rad] and of the forces [N]."""
    return parameters.knee.flexion_offset, parameters.load.offset


def move_along_z(rows: Rows, z: float) -> None:
    """Move the answers of many ticks to a compartment at z [m] from the middle of the tibia."""
    if not z:
        return
    rows["contact_point"]["z"] = z
    force = rows["contact_wrench"]["force"]
    torque = rows["contact_wrench"]["torque"]
    torque["x"] = -z * force["y"]
    torque["y"] = z * force["x"]


def compartments_of(parameters: Parameters, texts: Mapping[str, str]) -> tuple[Compartment, ...]:
    """Make the only compartment of a knee, or the medial and the lateral one.

    `texts` has the contents of files by parameter.

    Raises:
        UsageError: a model cannot be built; see `build_model`.
    """
    z = half_spacing(parameters)
    medial = Compartment(KNEE_CONTACT, parameters, build_model(parameters, curves=texts), -z)
    if not z:
        return (medial,)
    own = lateral_knee(parameters)
    model = build_model(own, curves=lateral_texts(texts))
    return medial, Compartment(KNEE_CONTACT_LATERAL, own, model, z)


def half_spacing(parameters: Parameters) -> float:
    """Distance [m] of the compartments from the middle of the tibia; 0 if there is only one."""
    return 0.5 * parameters.load.compartment_spacing if has_two_compartments(parameters) else 0.0


def compartment_of_topic(
    topic: str, parameters: Parameters, texts: Mapping[str, str]
) -> tuple[Parameters, Mapping[str, str]]:
    """Parameters, and contents of files by parameter, of the compartment that answers on a topic."""
    if is_lateral(topic):
        return lateral_knee(parameters), lateral_texts(texts)
    return parameters, texts


def summed_wrench(rows: Sequence[bytes]) -> bytes:
    """Bytes of the sum of all contact wrenches, at the origin of the tibia frame.

    `rows` has the bytes of the row of each compartment.
    """
    first, *others = rows
    if not others:
        return first[WRENCH_BYTES]
    wrench = WRENCH_NUMBERS.unpack_from(first, WRENCH_BYTES.start)
    for row in others:
        wrench = tuple(map(add, wrench, WRENCH_NUMBERS.unpack_from(row, WRENCH_BYTES.start)))
    return WRENCH_NUMBERS.pack(*wrench)


def summed_wrenches(rows: Sequence[Rows]) -> Rows:
    """Rows of the first compartment with the sums of all contact wrenches, the same bits as `summed_wrench`.

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
