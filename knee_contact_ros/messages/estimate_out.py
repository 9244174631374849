"""Estimates of the joint reaction to bytes and back."""

from __future__ import annotations

from knee_contact_ros.joint_reaction.estimator import PACKING, Estimate
from knee_contact_ros.messages.answer_out import header


def encode_estimate(stamp: int, frame_id: str, estimate: Estimate) -> bytes:
    """Bytes of a `LoadEstimate` message; stamp in [ns].

    Raises:
        ValueError: the stamp is beyond what ROS can hold.
    """
    return header(stamp, frame_id) + PACKING.pack(*estimate)
