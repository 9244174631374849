"""The topic `knee_contact/markers`: the knee for RViz, as a visualization_msgs/MarkerArray."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.types import ROW, ContactState, answer_struct
from ..streams.contact_pipeline import ContactAnswer
from ..streams.messages import check_stamp
from ..streams.topics import NANOSECONDS, typestore
from ..view import colours
from ..view.anatomy import NEWTONS_PER_MM, KneeOutlines

MARKER_ARRAY = "visualization_msgs/msg/MarkerArray"
MARKER = "visualization_msgs/msg/Marker"
LIFETIME = 1
"""Time [s] for which a viewer shows a marker that is not sent again"""
METRES_PER_NEWTON = 1e-3 / NEWTONS_PER_MM
"""Length of the arrow by its force [m/N]"""
LINE_SCALE = (3e-4, 0.0, 0.0)
"""Width of a line [m]"""
SPHERE_SCALE = (2e-3, 2e-3, 2e-3)
"""Diameters of a sphere [m]"""
ARROW_SCALE = (1e-3, 3e-3, 4e-3)
"""Diameters of an arrow's shaft and head, and length of its head [m]"""
MARKED_NUMBERS = answer_struct(
    "flexion_angle",
    "contact_force",
    "contact_point_x",
    "contact_point_y",
    "contact_point_z",
    "femoral_height",
    "contact_state",
    "femoral_x",
    "normal_x",
    "normal_y",
)
"""Reader of the fields of an answer's row that are drawn"""
MARKER_PERIOD = 1.0 / 30.0
"""Shortest time [s] from one message to the next"""
MARKER_DEPTH = 1
"""Number of messages that the publisher keeps: old pictures are useless"""


class KneeMarkers:
    """Makes markers for RViz: both surfaces in the tibia frame, the contact point and the force on the femur.

    Their namespaces begin with the name of the knee or of the compartment. The model is planar, and so are the markers:
    all lie at z = 0, or those of each compartment at the z of its contact. They are locked to their frame: a viewer
    draws them where the frame is now, not where it was at the stamp.
    """

    def __init__(self, drawings: Sequence[KneeOutlines]) -> None:
        """Make the message once; afterwards its moving parts are changed."""
        self._types: Any = typestore().types
        self._compartments = [self._markers_of(drawing) for drawing in drawings]
        self._message: Any = self._types[MARKER_ARRAY](
            markers=[marker for markers in self._compartments for marker in markers]
        )
        # The encoder is made at its first use, which would delay a tick.
        self.encode_markers(0, "", [bytes(ROW.itemsize)] * len(drawings))

    def encode_markers(self, stamp: int, frame_id: str, rows: Sequence[bytes]) -> bytes:
        """Return the bytes of the MarkerArray of an answer at `stamp` [ns]; `rows` has a row for each compartment.

        Raises:
            ValueError: a ROS message cannot hold the stamp.
        """
        check_stamp(stamp)
        header = self._header(stamp, frame_id)
        for marker in self._message.markers:
            marker.header = header
        for markers, row in zip(self._compartments, rows, strict=True):
            self._move(markers, MARKED_NUMBERS.unpack(row))
        return bytes(typestore().serialize_cdr(self._message, MARKER_ARRAY))

    def _move(self, markers: Sequence[Any], values: tuple[Any, ...]) -> None:
        """Move the markers of a compartment to where an answer has them."""
        angle, force, x, y, z, height, state, femoral_x, normal_x, normal_y = values
        tibia, femur, point, arrow = markers
        tibia.pose = self._pose(0.0, 0.0, z)
        femur.pose = self._pose(femoral_x, height, z, angle)
        point.pose = self._pose(x, y, z)
        point.color = self._colour(colours.STATE_COLOURS[state])
        length = METRES_PER_NEWTON * force
        arrow.points = self._points([(x, y), (x + length * normal_x, y + length * normal_y)], z)
        arrow.action = arrow.ADD if force != 0.0 else arrow.DELETE

    def _markers_of(self, drawing: KneeOutlines) -> list[Any]:
        """Make the markers of a compartment, before they move: tibia, femur, contact point and force."""
        kind = self._types[MARKER]
        apart = colours.STATE_COLOURS[ContactState.SEPARATED]
        tibia, femur = (self._points(line.tolist()) for line in (drawing.tibia, drawing.femur))
        return [
            self._marker(
                f"{drawing.knee}/tibia", kind.LINE_STRIP, LINE_SCALE, colours.SURFACE, tibia
            ),
            self._marker(
                f"{drawing.knee}/femur", kind.LINE_STRIP, LINE_SCALE, colours.SURFACE, femur
            ),
            self._marker(f"{drawing.knee}/contact_point", kind.SPHERE, SPHERE_SCALE, apart, []),
            self._marker(
                f"{drawing.knee}/contact_force_on_femur",
                kind.ARROW,
                ARROW_SCALE,
                colours.FORCE,
                [],
            ),
        ]

    def _marker(
        self, name: str, shape: int, scale: Sequence[float], colour: Any, points: list[Any]
    ) -> Any:
        """Make a marker with its own frame at the origin, and points in that frame."""
        of = self._types
        nothing = np.zeros(0, np.uint8)
        return of[MARKER](
            header=self._header(0, ""),
            ns=name,
            id=0,
            type=shape,
            action=0,
            pose=self._pose(0.0, 0.0, 0.0),
            scale=of["geometry_msgs/msg/Vector3"](*scale),
            color=self._colour(colour),
            lifetime=of["builtin_interfaces/msg/Duration"](sec=LIFETIME, nanosec=0),
            frame_locked=True,
            points=points,
            colors=[],
            texture_resource="",
            texture=of["sensor_msgs/msg/CompressedImage"](self._header(0, ""), "", nothing),
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=of["visualization_msgs/msg/MeshFile"]("", nothing),
            mesh_use_embedded_materials=False,
        )

    def _header(self, stamp: int, frame_id: str) -> Any:
        """Make a header with a stamp [ns]."""
        time = self._types["builtin_interfaces/msg/Time"](*divmod(stamp, NANOSECONDS))
        return self._types["std_msgs/msg/Header"](time, frame_id)

    def _pose(self, x: float, y: float, z: float, turn: float = 0.0) -> Any:
        """Make a pose at x, y, z [m], turned about z by an angle [rad] from x to y."""
        turned = self._types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, math.sin(0.5 * turn), math.cos(0.5 * turn)
        )
        return self._types["geometry_msgs/msg/Pose"](
            self._types["geometry_msgs/msg/Point"](x, y, z), turned
        )

    def _colour(self, rgb: Sequence[int] | NDArray[np.uint8]) -> Any:
        """Make an opaque colour."""
        return self._types["std_msgs/msg/ColorRGBA"](*(part / 255.0 for part in rgb), 1.0)

    def _points(self, line: Sequence[Sequence[float]], z: float = 0.0) -> list[Any]:
        """Make points at z [m] of pairs x, y [m]."""
        return [self._types["geometry_msgs/msg/Point"](x, y, z) for x, y in line]


class MarkerTopic:
    """Publishes markers between ticks, and not with every tick."""

    def __init__(self, publisher: Any, markers: KneeMarkers) -> None:
        """Publish `markers` with the publisher of a MarkerArray."""
        self._publisher = publisher
        self._markers = markers
        self.newest: ContactAnswer | None = None
        """Answer to show next; None if it was shown"""

    def publish_markers(self) -> None:
        """Publish the newest answer, unless it was published or nobody subscribes."""
        if self.newest and self._publisher.get_subscription_count():
            load = self.newest.pair.load
            rows = self.newest.rows
            self.newest = None
            markers = self._markers.encode_markers(load.stamp, load.frame_id, rows)
            self._publisher.publish(markers)
