"""The topic `knee_contact/stride`: numbers of each stride, as a sensor_msgs/JointState."""

import math
from collections.abc import Callable, Sequence
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
    """Publishes the strides between ticks, while somebody listens, and finds how far the contact force rings.

    Without a listener, and under a law that is damped, a tick costs nothing more.
    """

    def __init__(
        self, publisher: Any, body_weight: float, models: Callable[[], Sequence[KneeModel]]
    ) -> None:
        """Publish with the publisher of a JointState the strides of a person with this body weight [N].

        `models` returns the models that compute the answers of each compartment, the medial one first.
        """
        self._publisher = publisher
        self._body_weight = body_weight
        self._models = models
        self._of: Sequence[KneeModel] = []
        self._ringings: list[Ringing] = []
        self._rows: list[tuple[bytes, ...]] | None = None  # since the last search; None: not kept
        self._frame_id = ""

    @property
    def ringing(self) -> str:
        """Sentence on the ringing under the present parameters; empty if there is none worth telling."""
        return (
            max(self._ringings, key=lambda each: each.largest).sentence if self._ringings else ""
        )

    def add_answer(self, answer: ContactAnswer) -> None:
        """Keep an answer for the next search, if it is needed."""
        if self._rows is not None:
            self._rows.append(answer.rows)
            self._frame_id = answer.pair.load.frame_id

    def publish_strides(self) -> None:
        """Publish the strides that have become certain."""
        is_heard = self._publisher.get_subscription_count() > 0
        models = self._models()
        if [*map(id, models)] != [*map(id, self._of)]:
            self._rows, self._of, self._ringings = None, models, [*map(Ringing, models)]
        if not (is_heard or any(each.rings for each in self._ringings)):
            self._rows = None
        elif self._rows is None:
            self._rows, self._strides = [], Strides(self._body_weight)
        elif self._rows:
            rows = [np.frombuffer(b"".join(part), ROW) for part in zip(*self._rows, strict=True)]
            self._rows = []
            now = int(rows[0]["stamp"][-1])
            rings = [one.add_answers(part) for one, part in zip(self._ringings, rows, strict=True)]
            for stride in self._strides.add_answers(rows[0], rings[0]):
                if is_heard:
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
