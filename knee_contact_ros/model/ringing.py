"""Ringing: how far the force of a contact law without a dashpot is from that of the same knee with one.

Nothing damps a knee whose law has no dashpot. What sets it swinging, a heel strike or a kink of the load, goes on, and
rates and largest forces contain a swing of the model's own. The same inputs under the same law with a dashpot tell it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .laws import COMMON
from .ticks import DYNAMIC
from .types import Floats, Rows, Status

if TYPE_CHECKING:
    from .knee import KneeModel, Stream

STANDING = 8.0
"""Body weight over that of the femur, at least nearly: the load at which damping that grows with the force is judged"""
GRAVITY = 9.80665
"""Standard gravity [m/s²]"""
LEAST_DECAY = 20.0
"""Decay rate [1/s] of an oscillation below which a layer rings: 50 ms later more than a third of it is left"""
GIVEN_DECAY = 270.0
"""Decay rate [1/s] by the dashpot for comparison: that of the paper's healthy knee, 5 kN s/m over 2 x 9.3 kg"""
LEAST_PART = 1e-3
"""Smallest ringing that is told, as a part of the largest contact force"""


def damped(model: KneeModel) -> KneeModel | None:
    """Return the same knee with a dashpot in every layer that hardly has one; None if the knee does not ring.

    A prescribed height and the quasi-static level leave nothing to ring.
    """
    if model.height_prescribed or model.level != DYNAMIC:
        return None
    standing = model.static_depth(STANDING * GRAVITY * model.mass)
    layers = list(model.law.layers)
    for place, layer in enumerate(layers):
        damping = layer.force_at(max(standing, 1.1 * layer.begin), 0.0)[2]
        if layer.form == COMMON and damping < 2.0 * model.mass * LEAST_DECAY:
            dashpot = 2.0 * model.mass * GIVEN_DECAY
            layers[place] = layer._replace(damping=layer.damping + dashpot)
    law = replace(model.law, layers=tuple(layers))
    return None if law == model.law else replace(model, law=law)


class Ringing:
    """Follows the answers of a knee beside those of the same knee with a dashpot."""

    def __init__(self, model: KneeModel) -> None:
        """Begin before the first answer of a model."""
        self._damped = damped(model)
        self.largest = 0.0
        """Largest ringing [N] of the contact force so far"""
        self._largest_force = 0.0
        self._stream: Stream | None = None
        self._last = -1  # stamp of the last answer [ns]

    def add_answers(self, answers: Mapping[str, NDArray[Any]] | Rows) -> Floats:
        """Add answers, in their order in time; return the ringing of each, contact force minus damped one [N]."""
        force = np.asarray(answers["contact_force"])
        ringing = np.zeros(len(force))
        if self._damped is None or not len(force):
            return ringing
        columns = [np.asarray(answers[name]) for name in ("stamp", "flexion_angle", "load")]
        status = np.asarray(answers["status"])
        begins = (status & Status.TIME_RESET) != 0
        begins |= np.diff(columns[0], prepend=self._last) <= 0
        self._last = columns[0][-1]
        resets = np.flatnonzero(begins).tolist()
        for begin, end in zip([0, *resets], [*resets, len(force)], strict=True):
            if begin in resets or self._stream is None:
                self._stream = self._damped.stream()
            if begin < end:
                stamps, angles, loads = (column[begin:end] for column in columns)
                own = self._stream.advance_all(stamps, angles, loads, None)
                unknown = ((status[begin:end] | own["status"]) & Status.NOT_CONVERGED) != 0
                difference = force[begin:end] - own["contact_force"]
                ringing[begin:end] = np.where(unknown, 0.0, difference)
        self.largest = max(self.largest, float(np.abs(ringing).max()))
        self._largest_force = max(self._largest_force, float(force.max()))
        return ringing

    @property
    def rings(self) -> bool:
        """Whether the knee may ring."""
        return self._damped is not None

    @property
    def is_told(self) -> bool:
        """Whether the ringing is large enough to be told."""
        return self.largest > LEAST_PART * self._largest_force

    @property
    def sentence(self) -> str:
        """Sentence on the ringing, in newtons; empty if there is none worth telling."""
        return ringing_sentence(self.largest) if self.is_told else ""


def ringing_sentence(largest: float = 0.0) -> str:
    """Sentence that answers ring, by up to `largest` [N] if that is known."""
    by = f" by up to {largest:.3g} N" if largest else ""
    return (
        f"the contact law hardly damps a layer, and the contact force rings{by}: "
        "loading rate and largest force contain this ringing of the model (contact.damping, contact.damp_first_layer)"
    )
