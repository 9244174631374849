"""Colours of the scene (RGB), told apart also by the colour-blind.

The planes are dark whatever the viewer's theme; curves must be seen in its dark and in its light one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from knee_contact_ros.core.types import ContactState

Colour = tuple[int, int, int]

SURFACE: Colour = (205, 200, 190)
BACKGROUND: Colour = (27, 31, 39)
TIBIA: Colour = (196, 184, 160)
FEMUR: Colour = (222, 212, 190)
EDGE: Colour = (92, 84, 70)
COVER: Colour = (128, 178, 200)
TEXT: Colour = (240, 240, 240)
"""Of words beside the bones. Rerun puts half-transparent boxes under words, black or white with the theme"""
INK: Colour = (24, 20, 14)
"""Of words on the bones"""
ANGLE: Colour = (70, 170, 120)
FORCE: Colour = (240, 120, 70)
LOAD: Colour = (150, 150, 165)
DEPTH: Colour = (40, 165, 185)
BAND: Colour = (130, 135, 160)
ERROR: Colour = (165, 120, 225)
COST: Colour = (190, 155, 45)
CARTILAGE: Colour = (80, 155, 235)
BONE: Colour = (240, 80, 165)
SLIP: Colour = (205, 130, 95)
WAY: Colour = (250, 205, 80)
APART: Colour = (150, 155, 165)

OF_STATE = np.array([APART, CARTILAGE, BONE], dtype=np.uint8)
"""By `ContactState`"""
NAME_OF_STATE = {ContactState.SEPARATED: "apart", ContactState.CARTILAGE: "cartilage", ContactState.BONE: "bone"}


class OfKnee(NamedTuple):
    """What tells a knee from others in the same plot."""

    name: str
    colour: Colour


OF_KNEES = (
    OfKnee("blue", (75, 150, 235)), OfKnee("orange", (235, 115, 55)), OfKnee("green", (60, 165, 110)),
    OfKnee("violet", (165, 120, 225)),
)  # fmt: skip
"""In turn"""
