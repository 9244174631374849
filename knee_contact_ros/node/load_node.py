"""The ROS 2 node `knee_load`.

Subscribes to `joint_states` (sensor_msgs/JointState: knee, hip and ankle, effort of actuators) and
`ground_reaction_force` (geometry_msgs/WrenchStamped, what the ground exerts on the foot). Publishes
`joint_reaction_force` (geometry_msgs/WrenchStamped, what the femur exerts on the tibia) and `load_estimate`
(knee_contact_ros/LoadEstimate), one each per ground force, and `/diagnostics` once a second.
Parameters: `parameters/schema.py`.
"""

import time
from functools import partial

from geometry_msgs.msg import WrenchStamped
from rclpy.lifecycle import LifecycleNode

from ..bags.provenance import provenance_record
from ..joint_reaction.estimator import Level
from ..msg import LoadEstimate
from ..parameters.load_schema import LoadParameters
from ..streams.load_pipeline import LoadAnswer, LoadPipeline
from ..streams.output import LOAD_PROVENANCE, RecordedKnee
from ..streams.topics import (
    JOINT_REACTION_FORCE,
    LOAD_ESTIMATE,
    LOAD_RECORDED,
    TickOutput,
)
from .diagnostics import Health
from .inputs import HandedInputs, HandOver
from .parameters import NodeKind
from .session import OUTPUT_DEPTH, Session

CHANGEABLE_LOAD_PARAMETERS = frozenset(
    {
        "person.mass",
        "person.height",
        "person.moment_arm_scale",
        "person.co_contraction",
        "person.tone",
        "person.electromechanical_delay",
        "calibrated",
        "standard_deviation",
        "deadline",
        "record.path",
        "knee.offset",
        "hip.offset",
        "ankle.offset",
    }
)
"""Parameters that may change while the node is configured: numbers of the person, and the next recording's name"""


class LoadHealth(Health):
    """Health of a load node."""

    _pipeline: LoadPipeline

    def doubts(self) -> list[str]:
        """Sentences about conventions of angles and ground force that are likely others."""
        return self._pipeline.conventions.sentences


class LoadSession(Session):
    """Configured life of a load node."""

    pipeline: LoadPipeline
    parameters: LoadParameters

    def __init__(
        self,
        node: LifecycleNode,
        parameters: LoadParameters,
        takers: HandedInputs | None = None,
    ) -> None:
        """Build the estimator and open the outputs.

        Args:
            node: The node.
            parameters: Parameters of the node.
            takers: Where angles and joint reactions are handed to, in addition to their topics.

        Raises:
            UsageError: an output file cannot be written.
        """
        pipeline = LoadPipeline(parameters)
        health = LoadHealth(node, parameters, pipeline, Level, "level")
        super().__init__(node, parameters, pipeline, health)
        self.inputs = self._input_streams()
        self._names = {topic: node.resolve_topic_name(topic) for topic in LOAD_RECORDED}
        self._advertise(
            {
                JOINT_REACTION_FORCE: (WrenchStamped, OUTPUT_DEPTH),
                LOAD_ESTIMATE: (LoadEstimate, OUTPUT_DEPTH),
            }
        )
        self._takers = takers or HandedInputs(HandOver(), HandOver())
        self._takers.angles.source = parameters.inputs()[0]
        self._open_outputs()
        trust = "not calibrated: nothing may be limited or triggered by it"
        if parameters.calibrated:
            trust = "calibrated"
        node.get_logger().info(f"estimating the joint reaction at level {pipeline.level}, {trust}")

    def _recorded_knee(self, parameters: LoadParameters) -> RecordedKnee:
        provenance = provenance_record(self.parameters, ticks_before=self.pipeline.ticks)
        return RecordedKnee(parameters, {}, self._names, provenance, LOAD_PROVENANCE)

    def _on_joint_state(self, data: bytes) -> None:
        try:
            self._takers.angles.give_message(data)
        finally:  # a failure there is reported, and no reason to lose the message here
            super()._on_joint_state(data)

    def _publish(self, answer: LoadAnswer, begin: float) -> None:
        try:
            self._takers.forces.give_message(
                answer.reaction
            )  # the contact is what somebody waits for
        finally:
            self._publish_estimate(answer, begin)

    def _publish_estimate(self, answer: LoadAnswer, begin: float) -> None:
        """Publish, record and count an answer whose computation began at a time [s]."""
        self._publishers[JOINT_REACTION_FORCE].publish(answer.reaction)
        end = time.perf_counter()
        self._publishers[LOAD_ESTIMATE].publish(answer.message)
        self.outputs.put_item(TickOutput.of(b"", answer.records()))
        latency = end - answer.pair.load.arrived
        level = int(answer.estimate.level)
        status = answer.estimate.status
        deadline = self.parameters.deadline
        self.health.counts.count_answer(level, status, end - begin, latency, deadline)


LOAD_NODE = NodeKind(LoadParameters, CHANGEABLE_LOAD_PARAMETERS, LoadSession)


def load_and_contact() -> tuple[NodeKind, NodeKind]:
    """Kinds of both nodes, `knee_load` first, in one process: the first hands its angles and answers to the second.

    Sending a message over a topic takes longer than estimate and contact together. All topics are still published.
    """
    from .contact_node import (
        CONTACT_NODE,
        ContactSession,
    )  # which a load node alone does not need

    handed = HandedInputs(HandOver(), HandOver())
    return (
        LOAD_NODE._replace(session=partial(LoadSession, takers=handed)),
        CONTACT_NODE._replace(session=partial(ContactSession, handed=handed)),
    )
