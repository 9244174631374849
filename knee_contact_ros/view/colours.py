"""Colours of the scene (RGB), told apart also by the colour-blind.

The planes are dark whatever the viewer's theme; curves must be seen in its dark and in its light one.
"""

from __future__ import annotations

import numpy as np

from knee_contact_ros.core.types import ContactState

Colour = tuple[int, int, int]

SURFACE: Colour = (205, 200, 190)
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
