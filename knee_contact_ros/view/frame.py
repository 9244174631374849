"""Visible part of the sagittal plane, the same for all knees of a scene, and the places of words in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from knee_contact_ros.view.anatomy import SURFACE_POINTS, placed
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.overlap import Floats, lowest_at

MM = 1e3
SCALE_BAR = 10.0
"""Length of the scale bar [mm]"""
FLEXIONS = np.radians([-5.0, 0.0, 15.0, 30.0, 45.0, 60.0, 70.0])
"""Flexion angles [rad] at which the whole knee must be visible"""
MARGIN, WORD = 0.04, 0.07
"""Margin around the knee, and room for words below the marks, in heights of the knee: words keep their size"""


class Frame(NamedTuple):
    """Visible part and places of words, in mm on the screen, whose y points down."""

    x: tuple[float, float]
    """Left and right end of the visible part"""
    y: tuple[float, float]
    """Upper and lower end of the visible part"""
    axes: tuple[float, float]
    """Origin of the arrows to anterior and superior"""
    axis_length: float
    """Length of these arrows"""
    scale: tuple[float, float]
    """Left end of the scale bar"""
    femur_name: tuple[float, float]
    """Place of the femur's name, on its shaft, femur frame"""
    tibia_name: tuple[float, float]
    """Place of the tibia's name"""
    depth_name: tuple[float, float]
    """Place of the depth: posterior to the contact, above the plateau, where no bone comes"""


def frame_of(drawing: KneeOutlines) -> Frame:
    """Return the visible part for a single knee."""
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
    """Return the femur's bone [m], tibia frame, at a flexion angle [rad], touching the tibia."""
    knee = drawing.anatomy
    femur, tibia = placed(knee.femur_cartilage, angle, 0.0, 0.0), knee.tibia_cartilage[:SURFACE_POINTS]
    apart = lowest_at(femur[None], tibia[None, :, 0])[0] - tibia[:, 1]
    return placed(knee.femur_bone, angle, 0.0, -float(apart.min()))


def common(frames: Sequence[Frame]) -> Frame:
    """Return the first frame, as large as all need it: knees side by side have one scale."""
    x, y = (np.array([frame[axis] for frame in frames]) for axis in (0, 1))
    first = frames[0]
    return first._replace(
        x=(float(x[:, 0].min()), float(x[:, 1].max())), y=(float(y[:, 0].min()), float(y[:, 1].max()))
    )
