"""How much of the sagittal plane is seen, the same for all knees of a scene, and where words stand in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.view.anatomy import SURFACE_POINTS, placed
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.overlap import Floats, lowest_at

MM = 1e3
SCALE_BAR = 10.0
"""[mm]"""
FLEXIONS = np.radians([-5.0, 0.0, 15.0, 30.0, 45.0, 60.0, 70.0])
"""Angles [rad] at which a walking knee is seen whole"""
MARGIN, WORD = 0.04, 0.07
"""Around it, and what is left for words below the marks at the bottom, in heights of the knee: words stay as large"""


class Frame(NamedTuple):
    """All in mm on the screen, whose y points down."""

    x: tuple[float, float]
    y: tuple[float, float]
    axes: tuple[float, float]
    """Where the arrows to anterior and superior begin"""
    axis_length: float
    scale: tuple[float, float]
    """Where the scale bar begins"""
    femur_name: tuple[float, float]
    """On the shaft, femur frame"""
    tibia_name: tuple[float, float]
    depth_name: tuple[float, float]
    """Behind the contact, above the plateau: no bone comes there"""


def frame_of(drawing: KneeOutlines) -> Frame:
    """What is seen of a knee."""
    knee = drawing.anatomy
    shapes = [_touching(drawing, angle) for angle in FLEXIONS]
    points = MM * np.concatenate([*shapes, knee.tibia_bone])
    height = float(np.ptp(points[:, 1]))
    margin, word = MARGIN * height, WORD * height
    (left, bottom), (right, top) = points.min(axis=0) - margin, points.max(axis=0) + margin
    floor = -bottom - word
    shaft = knee.femur_bone[knee.femur_bone[:, 1] > knee.femur_bone[:, 1].max() - 1e-6]
    rear = MM * knee.tibia_cartilage[0]
    length = 0.09 * (right - left)
    return Frame(
        (left, right), (-top, -bottom),
        axes=(left + word, floor), axis_length=length,
        scale=(right - margin - SCALE_BAR, floor),
        femur_name=(MM * float(shaft[:, 0].mean()), -MM * float(shaft[0, 1]) + word),
        tibia_name=(MM * float(knee.tibia_bone[:, 0].mean()), floor - 0.5 * word),
        depth_name=(0.5 * (left + float(rear[0])), -float(rear[1]) - word),
    )  # fmt: skip


def _touching(drawing: KneeOutlines, angle: float) -> Floats:
    """The femur [m] at an angle [rad], as high as it touches the tibia."""
    knee = drawing.anatomy
    femur, tibia = placed(knee.femur_cartilage, angle, 0.0, 0.0), knee.tibia_cartilage[:SURFACE_POINTS]
    apart = lowest_at(femur[None], tibia[None, :, 0])[0] - tibia[:, 1]
    return placed(knee.femur_bone, angle, 0.0, -float(apart.min()))


def common(frames: Sequence[Frame]) -> Frame:
    """The first one, as large as all of them need: knees side by side have one scale."""
    x, y = (np.array([frame[axis] for frame in frames]) for axis in (0, 1))
    first = frames[0]
    return first._replace(
        x=(float(x[:, 0].min()), float(x[:, 1].max())), y=(float(y[:, 0].min()), float(y[:, 1].max()))
    )
