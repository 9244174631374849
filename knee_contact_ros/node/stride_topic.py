"""The topic `knee_contact/stride`: numbers of each stride, as a sensor_msgs/JointState."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..model.knee import KneeModel
from ..model.ringing import Ringing
from ..model.types import NANOSECOND, ROW
from ..streams.contact_pipeline import ContactAnswer
from ..streams.messages import JointState, encode_joint_state
from ..streams.strides import CERTAIN, Stride, Strides

STRIDE_PERIOD = 0.05
"""Time [s] between two searches for complete strides"""
STRIDE_NUMBERS = (
    "peak_force",
    "peak_depth",
    "impulse",
    "stance_impulse",
    "loading_rate",
    "stance_time",
    "stride_time",
    "phase",
    "usable",
    "ringing",
)
"""Names of the numbers of a stride's message"""


class StrideTopic:
    """Publishes the strides between ticks, while somebody listens; without a listener a tick costs nothing more."""

    def __init__(self, publisher: Any, body_weight: float, model: Callable[[], KneeModel]) -> None:
        """Publish with the publisher of a JointState the strides of a person with this body weight [N].

        `model` returns the model that computes the answers, with which their ringing is found.
        """
        self._publisher = publisher
        self._body_weight = body_weight
        self._model = model
        self._of: KneeModel | None = None
        self._rows: list[bytes] | None = None  # since the last search; None while nobody listens
        self._frame_id = ""

    def add_answer(self, answer: ContactAnswer) -> None:
        """Keep an answer for the next search, if somebody listens."""
        if self._rows is not None:
            self._rows.append(answer.rows[0])
            self._frame_id = answer.pair.load.frame_id

    def publish_strides(self) -> None:
        """Publish the strides that have become certain."""
        if not self._publisher.get_subscription_count():
            self._rows = None
        elif self._rows is None or self._of is not self._model():
            self._rows, self._of = [], self._model()
            self._strides, self._ringing = Strides(self._body_weight), Ringing(self._of)
        elif self._rows:
            rows = np.frombuffer(b"".join(self._rows), ROW)
            self._rows = []
            now = int(rows["stamp"][-1])
            for stride in self._strides.add_answers(rows, self._ringing.add_answers(rows)):
                self._publisher.publish(encode_stride(stride, self._frame_id, now))


def encode_stride(stride: Stride, frame_id: str, now: int) -> bytes:
    """Bytes of the message of a stride: a JointState with a number for each of `STRIDE_NUMBERS`.

    Its stamp is the heel strike that ends the stride. `phase` is that of the answer at the stamp `now` [ns] in the
    stride that follows, if this lasts as long; NaN if stamps have jumped since.
    """
    span = stride.span
    since = now - span.end if 0 <= now - span.end <= CERTAIN else math.nan
    numbers = (
        stride.peak_force,
        stride.peak_depth,
        stride.impulse,
        stride.stance_impulse,
        stride.loading_rate,
        NANOSECOND * (span.toe_off - span.start),
        span.duration,
        since / (span.end - span.start),
        float(stride.usable),
        stride.ringing,
    )
    return encode_joint_state(JointState(span.end, frame_id, STRIDE_NUMBERS, numbers, (), ()))
