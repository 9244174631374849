"""The knee as markers in the tibia frame, for RViz: both surfaces, the contact point and the force on the femur.

The model is planar, and so is what is drawn: all of it lies at z = 0.
"""

from __future__ import annotations

from knee_contact_ros.core.types import ContactState, reader
from knee_contact_ros.messages.marker_out import POINT, Action, Colour, Marker, Pose, Shape, points_of
from knee_contact_ros.view import colours
from knee_contact_ros.view.outlines import NEWTONS_PER_MM, KneeOutlines

LENGTH = 1e-3 / NEWTONS_PER_MM
"""Of the arrow, by its force [m/N]"""
LINE, POINT_SIZE, ARROW = (7e-4, 0.0, 0.0), (3e-3, 3e-3, 3e-3), (1.2e-3, 3e-3, 4e-3)
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


class KneeMarkers:
    """Makes the markers of an answer; their names begin with the knee's."""

    def __init__(self, drawing: KneeOutlines) -> None:
        """Prepare what does not change."""
        knee = drawing.knee
        self._femur = Marker(f"{knee}/femur", Shape.LINE_STRIP, LINE, SURFACE, points=points_of(drawing.femur))
        self._tibia = Marker(f"{knee}/tibia", Shape.LINE_STRIP, LINE, SURFACE, points=points_of(drawing.tibia))
        self._point = Marker(f"{knee}/contact_point", Shape.SPHERE, POINT_SIZE, OF_STATE[ContactState.SEPARATED])
        self._force = Marker(f"{knee}/contact_force_on_femur", Shape.ARROW, ARROW, FORCE)

    def of(self, row: bytes) -> tuple[Marker, ...]:
        """The markers of an answer, given the bytes of its row; where there is no force, its arrow is deleted."""
        angle, force, x, y, height, state, femoral_x, normal_x, normal_y = SHOWN.unpack_from(row)
        femur = self._femur._replace(pose=Pose(femoral_x, height, angle))
        point = self._point._replace(colour=OF_STATE[state], pose=Pose(x, y))
        length = LENGTH * force
        tip = POINT.pack(x + length * normal_x, y + length * normal_y, 0.0)
        action = Action.ADD if force else Action.DELETE
        return self._tibia, femur, point, self._force._replace(points=POINT.pack(x, y, 0.0) + tip, action=action)
