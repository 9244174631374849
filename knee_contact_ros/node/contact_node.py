"""The ROS 2 node `knee_contact`.

Subscribes to `joint_states` (sensor_msgs/JointState) and `joint_reaction_force` (geometry_msgs/WrenchStamped, what the
femur exerts on the tibia, tibia frame). Publishes `knee_contact` (knee_contact_ros/KneeContact) and
`knee_contact/wrench` (geometry_msgs/WrenchStamped), one each per force sample, `/diagnostics` once a second, and while
somebody looks `knee_contact/markers` (visualization_msgs/MarkerArray) and, once a stride, `knee_contact/stride`
(sensor_msgs/JointState).
Parameters: `parameters/schema.py`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from importlib.util import find_spec
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState
from visualization_msgs.msg import MarkerArray

from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.provenance import provenance_record
from knee_contact_ros.model.kernel import is_built
from knee_contact_ros.model.types import ROW, ContactState, answer_struct
from knee_contact_ros.msg import KneeContact
from knee_contact_ros.node.diagnostics import ContactHealth
from knee_contact_ros.node.inputs import HandedInputs
from knee_contact_ros.node.parameters import NodeKind
from knee_contact_ros.node.session import OUTPUT_DEPTH, Session
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.schema import LATERAL_PREFIX, Parameters, has_two_compartments
from knee_contact_ros.streams.contact_pipeline import ContactAnswer, ContactPipeline
from knee_contact_ros.streams.messages import JointState as StrideNumbers
from knee_contact_ros.streams.messages import check_stamp, encode_joint_state
from knee_contact_ros.streams.output import RecordedKnee
from knee_contact_ros.streams.strides import CERTAIN, Stride, Strides
from knee_contact_ros.streams.timeline import LoadSample
from knee_contact_ros.streams.topics import (
    KNEE_CONTACT,
    KNEE_CONTACT_MARKERS,
    KNEE_CONTACT_STRIDE,
    KNEE_CONTACT_WRENCH,
    NANOSECONDS,
    TickOutput,
    knee_name,
    recorded_topics,
    typestore,
)
from knee_contact_ros.system.processes import OWN_PROCESS_GROUP, python_module, start_process
from knee_contact_ros.view import colours
from knee_contact_ros.view.anatomy import (
    NEWTONS_PER_MM,
    KneeOutlines,
    compartments_of,
    outlines_of_compartments,
)
from knee_contact_ros.view.output import server_address

COUNTED = answer_struct("fidelity", "status")
"""Reader of the fields of an answer's rows that the health of the node depends on"""
_LIVE = frozenset(
    {
        "knee.flexion_offset",
        "load.share",
        "load.compartment_spacing",
        "femur.mass",
        "contact.stiffness",
        "contact.exponent",
        "contact.damping",
        "contact.layer_depth",
        "contact.stiffness_2",
        "contact.restitution",
        "contact.least_impact_speed",
        "fidelity.level",
        "fidelity.tolerance",
        "fidelity.force_tolerance",
        "fidelity.budget",
        "deadline",
        "record.path",
    }
)
LIVE = _LIVE | {LATERAL_PREFIX + name for name in _LIVE if name.startswith(("femur.", "contact."))}
"""Parameters that may change while the node is configured: numbers of the model and of its inputs, and the
name of the next recording. They take effect between two ticks."""


class ContactSession(Session):
    """Configured life of a contact node."""

    pipeline: ContactPipeline
    health: ContactHealth
    parameters: Parameters

    def __init__(
        self,
        node: LifecycleNode,
        parameters: Parameters,
        qos_given: Collection[str],
        handed: HandedInputs | None = None,
    ) -> None:
        """Build the model and open the outputs.

        Args:
            node: The node.
            parameters: Parameters of the node.
            qos_given: Names of the QoS overrides that the user has given.
            handed: Source of the inputs if another node in this process hands them over.

        Raises:
            UsageError: a profile cannot be used or an output file cannot be written.
        """
        self._curves = curve_texts(parameters, {})
        pipeline = ContactPipeline(parameters, compiled=False, curves=self._curves)
        super().__init__(node, parameters, pipeline)
        self.health = ContactHealth(self)
        self.inputs = self._input_streams(qos_given, handed)
        for doubt in pipeline.doubts_about_parameters:
            node.get_logger().warning(doubt)
        topics = recorded_topics(has_two_compartments(parameters))
        self._names = {topic: node.resolve_topic_name(topic) for topic in topics}
        models = [compartment.model for compartment in pipeline.compartments]
        knees = compartments_of(knee_name(self._names[KNEE_CONTACT]), models)
        markers = KneeMarkers(outlines_of_compartments(models, knees, parameters.body_weight))
        contacts = [compartment.topic for compartment in pipeline.compartments]
        self._offer(
            {
                **dict.fromkeys(contacts, (KneeContact, OUTPUT_DEPTH)),
                KNEE_CONTACT_WRENCH: (WrenchStamped, OUTPUT_DEPTH),
                KNEE_CONTACT_STRIDE: (JointState, OUTPUT_DEPTH),
                KNEE_CONTACT_MARKERS: (MarkerArray, MARKER_DEPTH),
            }
        )
        # Bytes go straight to rclpy's own publisher: ticks come only while the node is active, which is all that a
        # lifecycle publisher would check.
        self._publish_contact = [self._publishers[topic].handle.publish_raw for topic in contacts]
        self._publish_wrench = self._publishers[KNEE_CONTACT_WRENCH].handle.publish_raw
        self._markers = MarkerTopic(self._publishers[KNEE_CONTACT_MARKERS], markers)
        self._strides = StrideTopic(self._publishers[KNEE_CONTACT_STRIDE], parameters.body_weight)
        self._leg = DrawnLeg()
        self._open()
        if parameters.rerun.mode in ("serve", "spawn"):
            url = server_address(parameters.rerun.port)
            node.get_logger().info(
                f"the scene is served on this machine at {url}; to see it: knee-contact view {url}"
            )

    def make_ready(self, interrupting: Callable[[], AbstractContextManager[None]]) -> None:
        """Load the library of the model; if that is not possible, the plain model computes.

        A library that is missing is built in its own process, which can simply be killed: a signal while LLVM works
        would leave its objects half made, and crash at the end. A signal while that process starts waits until the
        process is known; otherwise it would go on.
        """
        if find_spec("numba") and not is_built():
            self.node.get_logger().info("building the model, once, which takes about 8 s")
            process = start_process(
                output=None,
                **OWN_PROCESS_GROUP,
                **python_module("knee_contact_ros.model.kernel"),
            )
            try:
                with interrupting():
                    process.wait()
            finally:
                process.kill()
                process.wait()
        with interrupting():
            self.pipeline.compile_model()

    def stop(self) -> None:
        """Close the inputs, answer waiting samples, and stop showing markers."""
        super().stop()
        self._markers.newest = None

    def _regular_acts(self) -> list[tuple[float, Callable[[], None]]]:
        acts = (
            (MARKER_PERIOD, self._markers.publish),
            (STRIDE_PERIOD, self._strides.publish),
            (0.97, self.health.take),
        )
        return [*super()._regular_acts(), *acts]

    def retune(self, parameters: Parameters, changes: dict[str, Any]) -> None:
        """Continue with changed parameters, and warn of those that are implausible; see `Session.retune`."""
        self.health.take()  # by the limits that held for these answers
        known = self.pipeline.doubts_about_parameters
        super().retune(parameters, changes)
        for doubt in self.pipeline.doubts_about_parameters:
            if doubt not in known:
                self.node.get_logger().warning(doubt)

    def _described(self, parameters: Parameters) -> RecordedKnee:
        provenance = provenance_record(
            self.parameters, self._curves, ticks_before=self.pipeline.ticks
        )
        models = {
            compartment.topic: compartment.model for compartment in self.pipeline.compartments
        }
        return RecordedKnee(parameters, models, self._names, provenance)

    def _publish(self, answer: ContactAnswer, begin: float) -> None:
        for publish, message in zip(self._publish_contact, answer.messages, strict=True):
            publish(message)
        end = time.perf_counter()
        self._publish_wrench(answer.wrench)
        load = answer.pair.load
        latency = end - load.arrived
        rows = answer.rows_with_latency(latency)
        self.outputs.put(TickOutput.of(rows, self._leg.records_with_leg(answer)))
        self._markers.newest = (load, rows)
        self.health.rows.append(rows)
        if self._strides.rows is not None:
            self._strides.rows.append(rows)
            self._strides.frame_id = load.frame_id
        levels, flags = zip(*COUNTED.iter_unpack(rows), strict=True)
        self.count(levels[-1], flags[0] | flags[-1], end - begin, latency)


CONTACT_NODE = NodeKind(Parameters, LIVE, ContactSession)


STRIDE_PERIOD = 0.05
"""Time [s] between two looks for strides"""


class StrideTopic:
    """Publishes the strides between ticks, while somebody listens; without a listener a tick costs nothing more."""

    def __init__(self, publisher: Any, body_weight: float) -> None:
        """Publish with the publisher of a JointState the strides of a person with this body weight [N]."""
        self.rows: list[bytes] | None = None
        """Rows of the answers since the last look; None while nobody listens"""
        self.frame_id = ""
        self._publisher, self._body_weight = publisher, body_weight

    def publish(self) -> None:
        """Publish the strides that have become certain."""
        if not self._publisher.get_subscription_count():
            self.rows = None
        elif self.rows is None:
            self.rows, self._strides = [], Strides(self._body_weight)
        elif self.rows:
            rows = np.frombuffer(b"".join([row[: ROW.itemsize] for row in self.rows]), ROW)
            self.rows = []
            for stride in self._strides.add(rows):
                self._publisher.publish(
                    encode_stride(stride, self.frame_id, int(rows["stamp"][-1]))
                )


STRIDE_NUMBERS = (
    "peak_force",
    "peak_depth",
    "impulse",
    "stance_impulse",
    "loading_rate",
    "stance_time",
    "stride_time",
    "phase",
    "usable",
)
"""Names of the numbers of a stride's message"""


def encode_stride(stride: Stride, frame_id: str, now: int) -> bytes:
    """Bytes of the message of a stride: a JointState with a number for each of `STRIDE_NUMBERS`.

    Its stamp is the heel strike that ends the stride. `phase` is that of the answer at the stamp `now` [ns] in the
    stride that follows, if this lasts as long; NaN if stamps have jumped since.
    """
    span = stride.span
    since = now - span.end if 0 <= now - span.end <= CERTAIN else math.nan
    numbers = (
        stride.peak_force,
        stride.peak_depth,
        stride.impulse,
        stride.stance_impulse,
        stride.loading_rate,
        1e-9 * (span.toe_off - span.start),
        span.duration,
        since / (span.end - span.start),
        float(stride.usable),
    )
    return encode_joint_state(StrideNumbers(span.end, frame_id, STRIDE_NUMBERS, numbers, (), ()))


MARKER_ARRAY, MARKER = "visualization_msgs/msg/MarkerArray", "visualization_msgs/msg/Marker"
LIFETIME = 1
"""Time [s] for which a viewer shows a marker that is not sent again"""
LENGTH = 1e-3 / NEWTONS_PER_MM
"""Length of the arrow by its force [m/N]"""
LINE, BALL, ARROW = (3e-4, 0.0, 0.0), (2e-3, 2e-3, 2e-3), (1e-3, 3e-3, 4e-3)
"""Scales of the markers [m]: width of a line; diameters of a sphere; diameters of an arrow's shaft and head, and head
length"""
SHOWN = answer_struct(
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
        self.encode(
            0, "", bytes(len(drawings) * ROW.itemsize)
        )  # the encoder is made at its first use

    def encode(self, stamp: int, frame_id: str, rows: bytes) -> bytes:
        """Return the bytes of the MarkerArray of an answer at `stamp` [ns]; `rows` has a row for each compartment.

        Raises:
            ValueError: a ROS message cannot hold the stamp.
        """
        check_stamp(stamp)
        header = self._header(stamp, frame_id)
        for marker in self._message.markers:
            marker.header = header
        for number, markers in enumerate(self._compartments):
            self._move(markers, SHOWN.unpack_from(rows, number * ROW.itemsize))
        return bytes(typestore().serialize_cdr(self._message, MARKER_ARRAY))

    def _move(self, markers: Sequence[Any], values: tuple[Any, ...]) -> None:
        """Move the markers of a compartment to where an answer has them."""
        angle, force, x, y, z, height, state, femoral_x, normal_x, normal_y = values
        tibia, femur, point, arrow = markers
        tibia.pose, femur.pose = self._pose(0.0, 0.0, z), self._pose(femoral_x, height, z, angle)
        point.pose, point.color = self._pose(x, y, z), self._colour(colours.STATE_COLOURS[state])
        length = LENGTH * force
        arrow.points = self._points([(x, y), (x + length * normal_x, y + length * normal_y)], z)
        arrow.action = arrow.ADD if force != 0.0 else arrow.DELETE

    def _markers_of(self, drawing: KneeOutlines) -> list[Any]:
        """Make the markers of a compartment, before they move: tibia, femur, contact point and force."""
        kind, apart = self._types[MARKER], colours.STATE_COLOURS[ContactState.SEPARATED]
        tibia, femur = (self._points(line.tolist()) for line in (drawing.tibia, drawing.femur))
        return [
            self._marker(f"{drawing.knee}/tibia", kind.LINE_STRIP, LINE, colours.SURFACE, tibia),
            self._marker(f"{drawing.knee}/femur", kind.LINE_STRIP, LINE, colours.SURFACE, femur),
            self._marker(f"{drawing.knee}/contact_point", kind.SPHERE, BALL, apart, []),
            self._marker(
                f"{drawing.knee}/contact_force_on_femur", kind.ARROW, ARROW, colours.FORCE, []
            ),
        ]

    def _marker(
        self, name: str, shape: int, scale: Sequence[float], colour: Any, points: list[Any]
    ) -> Any:
        """Make a marker with its own frame at the origin, and points in that frame."""
        of, nothing = self._types, np.zeros(0, np.uint8)
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
        self.publisher = publisher
        self.newest: tuple[LoadSample, bytes] | None = None
        """Answer to show next: its load, and the bytes of its row; None if it was shown"""
        self._markers = markers

    def publish(self) -> None:
        """Publish the newest answer, unless it was published or nobody subscribes."""
        if self.newest and self.publisher.get_subscription_count():
            load, row = self.newest
            self.newest = None
            self.publisher.publish(self._markers.encode(load.stamp, load.frame_id, row))
