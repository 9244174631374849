"""Colours of the scene, told apart also by the colour-blind: RGB on a dark ground."""

from __future__ import annotations

import numpy as np

from knee_contact_ros.core.types import ContactState

Colour = tuple[int, int, int]

SURFACE: Colour = (205, 200, 190)
ANGLE: Colour = (120, 200, 160)
FORCE: Colour = (240, 120, 70)
LOAD: Colour = (160, 160, 172)
DEPTH: Colour = (240, 240, 245)
BAND: Colour = (130, 135, 160)
ERROR: Colour = (190, 150, 235)
COST: Colour = (215, 195, 100)
CARTILAGE: Colour = (90, 165, 240)
BONE: Colour = (240, 80, 165)
WAY: Colour = (250, 205, 80)
APART: Colour = (120, 125, 135)

OF_STATE = np.array([APART, CARTILAGE, BONE], dtype=np.uint8)
"""By `ContactState`"""
NAME_OF_STATE = {ContactState.SEPARATED: "apart", ContactState.CARTILAGE: "cartilage", ContactState.BONE: "bone"}
