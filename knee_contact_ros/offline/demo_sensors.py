"""`knee-contact demo --from-sensors`: a leg's sensors to the load node, and its estimate to the contact node.

With a companion the loop closes through the estimate: the torque that it commands stands as `effort` in the joint
states that are played, the load node takes it off the net moment, and load and contact follow, to which the companion
listens.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.bags.recorded_answers import answer_blocks
from knee_contact_ros.bags.topic_names import OWN_NAMES
from knee_contact_ros.core.types import Rows
from knee_contact_ros.messages.cdr import decode_joint_state, encode_joint_state
from knee_contact_ros.messages.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    LOAD_ESTIMATE,
    LOAD_INPUTS,
    MESSAGE_TYPES,
)
from knee_contact_ros.offline.bag_inputs import BagInputs, check_joints, wanted_joints
from knee_contact_ros.offline.demo import Source
from knee_contact_ros.offline.estimate_load import estimate_load, named_joints
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.offline.stage import (
    LOAD_LOG,
    LOAD_RECORDING,
    RECORDING,
    companion_process,
    load_process,
    node_process,
)
from knee_contact_ros.offline.summary import Summary
from knee_contact_ros.parameters.load_schema import LOAD_READING, ActuatedJoint, LoadParameters
from knee_contact_ros.parameters.plausibility import Doubts
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.system.processes import Child
from knee_contact_ros.system.resources import share_folder

BAG, RECORDED = "gait2354_right_sensors", "gait2354_right"
"""Shipped: what a leg's sensors tell, and the joint reaction of the same gait by a musculoskeletal model"""
LOAD_FILE = "load/gait2354.yaml"
"""The parameters for it"""
FORCE_LIMIT = 900.0
"""[N] above which the companion gives way: its own limit is above what the sensors' estimate reaches"""
NOT_KNOWN = (
    "with an actuator's help people pull their muscles against each other otherwise than without, and nothing here "
    "measures that: what the estimate loses is the net moment alone"
)


class Peak(NamedTuple):
    """A joint reaction at its largest."""

    axial: float
    """[N]"""
    deviation: float
    """[N] standard deviation of an estimate; 0 of what is none"""

    def told(self, weight: float) -> str:
        """In N and in body weights of so many N."""
        deviation = f", standard deviation {self.deviation:.0f} N" if self.deviation else ""
        return f"{self.axial:.1f} N ({self.axial / weight:.2f} BW){deviation}"


class Sensors(Source):
    """What a leg's sensors tell, for the load node, and the contact node behind it."""

    inputs: Sequence[str] = LOAD_INPUTS
    heard: Sequence[str] = (
        *(f"knee_load: {topic}" for topic in LOAD_INPUTS),
        *(f"knee_contact: {topic}" for topic in INPUTS),
    )

    def __init__(self, bag: Path | None, files: list[Path], load_files: list[Path], companion: bool) -> None:
        """Read the parameters.

        Args:
            bag: None: the shipped one.
            files: for the contact node; it gets the person's body weight beside them.
            load_files: for the load node.
            companion: whether there is one, which closes the loop.

        Raises:
            UsageError: the parameters cannot be used.
        """
        self._files, self._load_files = files, load_files
        assisted = {"knee.assisted": True} if companion else {}
        self.load_parameters: LoadParameters = LOAD_READING.load([*load_files, assisted])
        self.weight = self.load_parameters.person.constants.weight
        """[N] of the person"""
        parameters = load_parameters([*files, {"body_weight": self.weight}])
        super().__init__(bag or share_folder() / "bags" / BAG, companion, parameters)

    def check(self) -> Doubts:
        """See `Source`."""
        pipeline = Pipeline(self.parameters, compiled=False)
        with BagInputs(self.bag, JOINT_STATES, OWN_NAMES, GROUND_REACTION_FORCE) as inputs:
            check_joints(inputs, named_joints(self.load_parameters))
            check_joints(inputs, wanted_joints(self.parameters))
        return pipeline.doubts

    def processes(self, work: Path) -> Sequence[AbstractContextManager[Child]]:
        """See `Source`."""
        assisted = {"knee.assisted": "true"} if self.companion else {}
        return [
            node_process(self._files, work, values={"body_weight": str(self.weight)}),
            load_process(self._load_files, work, assisted),
            *([companion_process(work, {"force_limit": str(FORCE_LIMIT)})] if self.companion else []),
        ]

    def changed(self, message: RawMessage, torque: float) -> RawMessage:
        """With the companion's torque as the knee's effort."""
        if not self.companion or message.topic != f"/{JOINT_STATES}":
            return message
        return message._replace(data=with_assistance(message.data, self.load_parameters.knee, torque))

    def rows(self, work: Path, summary: Summary) -> dict[str, str]:
        """The estimate beside what was recorded, and the contact with and without assistance."""
        told = "yes" if self.load_parameters.calibrated else "no: for looking, not for gating anything"
        rows = {"load's level": self.load_parameters.chosen_level, "calibrated": told}
        rows["estimated load"] = largest(work / LOAD_RECORDING.parent, LOAD_ESTIMATE).told(self.weight)
        if self.bag.resolve() == (share_folder() / "bags" / BAG).resolve():
            recorded = largest(self.bag.with_name(RECORDED), JOINT_REACTION_FORCE)
            rows["recorded load"] = f"{recorded.told(self.weight)}, by OpenSim from muscles"
        return rows | (self._assisted_rows(work, summary) if self.companion else {})

    def files(self, output: Path) -> dict[str, str]:
        """See `Source`."""
        return {"Load's recording": str(output / LOAD_RECORDING.parent), "Load's log": str(output / LOAD_LOG)}

    def _assisted_rows(self, work: Path, summary: Summary) -> dict[str, str]:
        """The contact beside that of the same bag without assistance, which is computed offline."""
        loads, blocks = work / "without_assistance.mcap", list[Rows]()
        parameters = LOAD_READING.load([self.load_parameters, {"knee.assisted": False}])
        estimate_load(self.bag, parameters, loads, lambda _done, _total: None)
        keep = lambda rows: blocks.append(rows[0])  # noqa: E731
        without = solve(loads, self.parameters, None, lambda _done, _total: None, keep=keep).peaks["contact_force"]
        less = relief(np.concatenate(blocks), np.concatenate([*answer_blocks(work / RECORDING.parent)]))
        return {
            "gives way above": f"{FORCE_LIMIT:.0f} N of contact force",
            "largest contact": f"{without.value:.1f} N without assistance, "
            f"{summary.peaks['contact_force'].value:.1f} N with it",
            "at one moment": f"up to {max(less.max(), 0.0):.1f} N less with assistance, "
            f"or {max(-less.min(), 0.0):.1f} N more",
            "warning": NOT_KNOWN,
        }


def relief(without: Rows, assisted: Rows) -> NDArray[np.float64]:
    """By how much the contact force [N] is less with assistance, at the stamps that both answers have."""
    _, first, second = np.intersect1d(without["stamp"], assisted["stamp"], return_indices=True)
    less: NDArray[np.float64] = without["contact_force"][first] - assisted["contact_force"][second]
    return less


def with_assistance(data: bytes, knee: ActuatedJoint, torque: float) -> bytes:
    """A JointState, as bytes, in which an actuator exerts a torque [N m] that extends the knee.

    An effort is in the sense of its joint's position: where that grows with flexion (`knee.sign` 1), it is minus the
    torque. A message without the knee, or which only ROS can read, stays as it is.
    """
    message = decode_joint_state(data)
    if message is None or knee.joint_name not in message.name:
        return data
    efforts = [*message.effort, *[0.0] * (len(message.name) - len(message.effort))]
    efforts[message.name.index(knee.joint_name)] = -knee.sign * torque
    return encode_joint_state(message._replace(effort=tuple(efforts)))


def largest(bag: Path, topic: str) -> Peak:
    """The largest joint reaction of a bag: of `joint_reaction_force`, or of `load_estimate`."""
    with BagReader(bag, {f"/{topic}": MESSAGE_TYPES[topic]}) as reader:
        messages = [message.message for message in reader.messages()]
    if topic == LOAD_ESTIMATE:
        return max(Peak(message.axial_force, message.standard_deviation) for message in messages)
    return max(Peak(-message.wrench.force.y, 0.0) for message in messages)
