"""The knee as markers in the tibia frame, for RViz: both surfaces, the contact point and the force on the femur.

The model is planar, and so is what is drawn: all of it lies at z = 0.
"""

from __future__ import annotations

import numpy as np

from knee_contact_ros.core.types import ContactState, reader
from knee_contact_ros.messages.marker_out import Colour, Marker, MarkerMessage, Shape
from knee_contact_ros.view import colours
from knee_contact_ros.view.outlines import NEWTONS_PER_MM, KneeOutlines

LENGTH = 1e-3 / NEWTONS_PER_MM
"""Of the arrow, by its force [m/N]"""
LINE, BALL, ARROW = (3e-4, 0.0, 0.0), (2e-3, 2e-3, 2e-3), (1e-3, 3e-3, 4e-3)
"""[m] see `Marker.scale`"""
SHOWN = reader(
    "flexion_angle", "contact_force", "contact_point_x", "contact_point_y", "femoral_height", "contact_state",
    "femoral_x", "normal_x", "normal_y",
)  # fmt: skip
"""Of an answer's row"""


def _colour(rgb: colours.Colour) -> Colour:
    red, green, blue = (part / 255.0 for part in rgb)
    return red, green, blue


SURFACE, FORCE = _colour(colours.SURFACE), _colour(colours.FORCE)
OF_STATE = {state.value: _colour(tuple(colours.OF_STATE[state].tolist())) for state in ContactState}


FEMUR, POINT, FORCE_ON_FEMUR = 1, 2, 3
"""Places in the message, behind the tibia, which does not move"""


class KneeMarkers:
    """Makes the markers of answers; their names begin with the knee's."""

    def __init__(self, drawing: KneeOutlines) -> None:
        """Prepare what does not change."""
        knee = drawing.knee
        self._markers = [
            Marker(f"{knee}/tibia", Shape.LINE_STRIP, LINE, SURFACE, drawing.tibia),
            Marker(f"{knee}/femur", Shape.LINE_STRIP, LINE, SURFACE, drawing.femur),
            Marker(f"{knee}/contact_point", Shape.SPHERE, BALL, OF_STATE[ContactState.SEPARATED]),
            Marker(f"{knee}/contact_force_on_femur", Shape.ARROW, ARROW, FORCE, np.zeros((2, 2))),
        ]
        self._message = MarkerMessage("", self._markers)

    def encode(self, stamp: int, frame_id: str, row: bytes) -> bytes:
        """Bytes of the MarkerArray of an answer; stamp in [ns], the row's own is not looked at.

        Raises:
            ValueError: the stamp is beyond what ROS can hold.
        """
        if frame_id != self._message.frame_id:
            self._message = MarkerMessage(frame_id, self._markers)
        angle, force, x, y, height, state, femoral_x, normal_x, normal_y = SHOWN.unpack_from(row)
        message, length = self._message, LENGTH * force
        message.set_stamp(stamp)
        message.move(FEMUR, femoral_x, height, angle)
        message.move(POINT, x, y, 0.0)
        message.paint(POINT, OF_STATE[state])
        message.place(FORCE_ON_FEMUR, (x, y), (x + length * normal_x, y + length * normal_y))
        message.show(FORCE_ON_FEMUR, force != 0.0)
        return message.tobytes()
