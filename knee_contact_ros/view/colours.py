"""Colours of the scene (RGB), which colour-blind users can also distinguish.

The planes are dark in every theme of the viewer; curves must be visible in a dark and in a light theme.
"""

import numpy as np

from ..model.types import ContactState

Colour = tuple[int, int, int]

SURFACE: Colour = (205, 200, 190)
BACKGROUND: Colour = (27, 31, 39)
TIBIA: Colour = (196, 184, 160)
FEMUR: Colour = (222, 212, 190)
EDGE: Colour = (92, 84, 70)
COVER: Colour = (128, 178, 200)
LIGHT_TEXT: Colour = (240, 240, 240)
"""Colour of words outside the bones; Rerun puts half-transparent boxes under words, black or white by the theme"""
INK: Colour = (24, 20, 14)
"""Colour of words on the bones"""
ANGLE: Colour = (70, 170, 120)
FORCE: Colour = (240, 120, 70)
LOAD: Colour = (150, 150, 165)
DEPTH: Colour = (40, 165, 185)
BAND: Colour = (130, 135, 160)
ERROR_BAND: Colour = (165, 120, 225)
COST: Colour = (190, 155, 45)
CARTILAGE: Colour = (80, 155, 235)
BONE: Colour = (240, 80, 165)
SLIP: Colour = (205, 130, 95)
CONTACT_PATH: Colour = (250, 205, 80)
SEPARATED: Colour = (150, 155, 165)

STATE_COLOURS = np.array([SEPARATED, CARTILAGE, BONE], dtype=np.uint8)
"""Colours by `ContactState`"""
STATE_NAMES = {
    ContactState.SEPARATED: "apart",
    ContactState.CARTILAGE: "cartilage",
    ContactState.BONE: "bone",
}


KNEE_COLOURS: dict[str, Colour] = {
    "blue": (75, 150, 235),
    "orange": (235, 115, 55),
    "green": (60, 165, 110),
    "violet": (165, 120, 225),
}
"""Colours of the curves of the knees in a plot of several knees, used in turn"""
