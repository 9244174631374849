"""The leg that is drawn in recordings: its description (URDF), and the pose of the thigh (tf2)."""

import math
from collections.abc import Iterator
from functools import lru_cache
from html import escape

import numpy as np
from numpy.typing import NDArray

from ..model.types import Bytes, Rows, Stamps, answer_struct
from ..streams.contact_pipeline import ContactAnswer
from ..streams.frames import Transform, encode_transform
from ..streams.messages import HEADER
from ..streams.topics import (
    LEG_URDF,
    NANOSECONDS,
    ROBOT_DESCRIPTION,
    SHANK,
    TF,
    Record,
)
from ..system.files import share_folder

POSE_PERIOD = NANOSECONDS // 50
"""Time [ns]; the thigh is placed at the first tick of each such period"""
DESCRIPTION_PERIOD = 10 * NANOSECONDS
"""Time [ns]; the leg is described at the first tick of each such period, so that snapshots and split files have it"""
THIGH_POSE = answer_struct("flexion_angle", "femoral_height", "femoral_x")
"""Reader of the fields of an answer's row that give the pose of the thigh"""


class DrawnLeg:
    """Makes the messages about the leg, tick by tick or for many; they depend on stamps and answers alone.

    The shank is in the frame of the forces, the tibia frame; the thigh is where the answers place the femur. So Rerun,
    RViz and Foxglove draw and move the leg of a recording without anything else.
    """

    def __init__(self) -> None:
        """Begin without ticks; the leg's file is read here, and at no tick."""
        self._last_stamp = -1
        _urdf()

    def records_with_leg(self, answer: ContactAnswer) -> tuple[Record, ...]:
        """Return the messages to record of an answer, with those about the leg before the wrench."""
        stamp = answer.pair.load.stamp
        before, self._last_stamp = self._last_stamp, stamp
        records = answer.records()
        leg: list[Record] = []
        if stamp // DESCRIPTION_PERIOD != before // DESCRIPTION_PERIOD:
            leg.append((ROBOT_DESCRIPTION, stamp, description(answer.pair.load.frame_id)))
        if stamp // POSE_PERIOD != before // POSE_PERIOD:
            leg.append((TF, stamp, thigh_pose(stamp, answer.pair.load.frame_id, answer.rows[0])))
        return (*records[:-1], *leg, records[-1]) if leg else records

    def messages(
        self, stamps: Stamps, frame_id: str, rows: Rows
    ) -> Iterator[tuple[str, NDArray[np.intp], Bytes]]:
        """Yield the topics about the leg with their messages for many ticks.

        Args:
            stamps: Stamps of the ticks [ns], shape (n,).
            frame_id: Frame of the forces.
            rows: Answers of the medial or only compartment, shape (n,).

        Yields:
            The topic, the numbers of the ticks that have such a message, and the messages' bytes.
        """
        before = np.append(self._last_stamp, stamps[:-1])
        self._last_stamp = int(stamps[-1])
        described = np.flatnonzero(stamps // DESCRIPTION_PERIOD != before // DESCRIPTION_PERIOD)
        moved = np.flatnonzero(stamps // POSE_PERIOD != before // POSE_PERIOD)
        texts = [description(frame_id)] * len(described)
        poses = [thigh_pose(int(stamps[i]), frame_id, rows[i].tobytes()) for i in moved]
        for topic, ticks, data in ((ROBOT_DESCRIPTION, described, texts), (TF, moved, poses)):
            yield topic, ticks, np.array([np.frombuffer(one, np.uint8) for one in data])


@lru_cache(maxsize=1)
def _urdf() -> str:
    """Return the text of the leg's file."""
    return (share_folder() / LEG_URDF).read_text(encoding="utf-8")


@lru_cache(maxsize=4)
def description(frame_id: str) -> bytes:
    """Return a std_msgs/String with the URDF of a leg whose shank is `frame_id`, or `shank` if that is empty."""
    link = escape(frame_id or SHANK)
    text = _urdf().replace(f'"{SHANK}', f'"{link}').encode() + b"\0"
    return HEADER + len(text).to_bytes(4, "little") + text


def thigh_pose(stamp: int, frame_id: str, row: bytes) -> bytes:
    """Return the bytes of a tf2_msgs/TFMessage with the pose of the thigh in `frame_id` at a stamp [ns]."""
    angle, height, x = THIGH_POSE.unpack(row)
    turn = (0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle))
    shank = frame_id or SHANK
    return encode_transform(Transform(shank, f"{shank}/thigh", (x, height, 0.0), turn), stamp)
