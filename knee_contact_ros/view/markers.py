"""The knee as markers in the tibia frame, for RViz: both surfaces, the contact point and the force on the femur.

The model is planar, and so are the markers: all lie at z = 0, or those of each compartment at the z of its contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from knee_contact_ros.model.types import ROW, ContactState, reader
from knee_contact_ros.view import colours
from knee_contact_ros.view.anatomy import NEWTONS_PER_MM, KneeOutlines
from knee_contact_ros.view.marker_message import Colour, Marker, MarkerMessage, Shape

LENGTH = 1e-3 / NEWTONS_PER_MM
"""Length of the arrow by its force [m/N]"""
LINE, BALL, ARROW = (3e-4, 0.0, 0.0), (2e-3, 2e-3, 2e-3), (1e-3, 3e-3, 4e-3)
"""Scales [m] of the markers, see `Marker.scale`"""
SHOWN = reader(
    "flexion_angle", "contact_force", "contact_point_x", "contact_point_y", "contact_point_z", "femoral_height",
    "contact_state", "femoral_x", "normal_x", "normal_y",
)  # fmt: skip
"""Reader of the fields of an answer's row that are drawn"""


def _colour(rgb: colours.Colour) -> Colour:
    """Return a colour with parts from 0 to 1."""
    red, green, blue = (part / 255.0 for part in rgb)
    return red, green, blue


SURFACE, FORCE = _colour(colours.SURFACE), _colour(colours.FORCE)
OF_STATE = {state.value: _colour(tuple(colours.OF_STATE[state].tolist())) for state in ContactState}


FEMUR, POINT, FORCE_ON_FEMUR = 1, 2, 3
"""Places of the moving markers among those of a compartment; the tibia is the first"""
MARKERS_PER_COMPARTMENT = 4
"""Number of markers of a compartment"""


class KneeMarkers:
    """Makes the markers of answers; their namespaces begin with the name of the knee or of the compartment."""

    def __init__(self, drawings: Sequence[KneeOutlines]) -> None:
        """Prepare the parts of the message that do not change."""
        self._markers = [marker for drawing in drawings for marker in self._markers_of(drawing)]
        self._message = MarkerMessage("", self._markers)

    @staticmethod
    def _markers_of(drawing: KneeOutlines) -> list[Marker]:
        """Make the markers of a compartment, before they move."""
        knee = drawing.knee
        return [
            Marker(f"{knee}/tibia", Shape.LINE_STRIP, LINE, SURFACE, drawing.tibia),
            Marker(f"{knee}/femur", Shape.LINE_STRIP, LINE, SURFACE, drawing.femur),
            Marker(f"{knee}/contact_point", Shape.SPHERE, BALL, OF_STATE[ContactState.SEPARATED]),
            Marker(f"{knee}/contact_force_on_femur", Shape.ARROW, ARROW, FORCE, np.zeros((2, 2))),
        ]

    def encode(self, stamp: int, frame_id: str, rows: bytes) -> bytes:
        """Return the bytes of the MarkerArray of an answer at `stamp` [ns]; `rows` has a row for each compartment.

        Raises:
            ValueError: a ROS message cannot hold the stamp.
        """
        if frame_id != self._message.frame_id:
            self._message = MarkerMessage(frame_id, self._markers)
        self._message.set_stamp(stamp)
        for number in range(len(self._markers) // MARKERS_PER_COMPARTMENT):
            self._move(number * MARKERS_PER_COMPARTMENT, SHOWN.unpack_from(rows, number * ROW.itemsize))
        return self._message.tobytes()

    def _move(self, first: int, values: tuple[Any, ...]) -> None:
        """Move the markers of a compartment, from number `first` on, to the places that an answer gives."""
        angle, force, x, y, z, height, state, femoral_x, normal_x, normal_y = values
        message, length = self._message, LENGTH * force
        message.move(first, 0.0, 0.0, 0.0, z)
        message.move(first + FEMUR, femoral_x, height, angle, z)
        message.move(first + POINT, x, y, 0.0, z)
        message.paint(first + POINT, OF_STATE[state])
        message.place(first + FORCE_ON_FEMUR, (x, y, z), (x + length * normal_x, y + length * normal_y, z))
        message.show(first + FORCE_ON_FEMUR, force != 0.0)
