"""What sensors of a leg tell in a bag, paired once and held, for what goes through it many times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.bags.topic_names import Names
from knee_contact_ros.joint_reaction.sensed import Ground, Joints
from knee_contact_ros.messages.topics import GROUND_REACTION_FORCE, JOINT_STATES
from knee_contact_ros.offline.bag_inputs import BagInputs, learn_transforms
from knee_contact_ros.offline.estimate_load import FEWEST_BETWEEN_NEWS, named_joints
from knee_contact_ros.offline.joints import check_joints
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.pipeline.load_pipeline import LoadPipeline
from knee_contact_ros.pipeline.synchronise import PairedSample


class Sensed(NamedTuple):
    """What an estimator takes at a stamp."""

    stamp: int
    """[ns] of the ground force"""
    joints: Joints
    ground: Ground
    status: int
    """Bits of `Status`"""


class SensedBag(NamedTuple):
    """All of a bag, in its order."""

    samples: list[Sensed]
    refused: Counter[str]
    """Messages by reason"""
    damage: list[str]
    """What is wrong with the bag"""


def sensed_in(
    bag: Path, parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]
) -> SensedBag:  # fmt: skip
    """Read and pair a bag as `estimate_load` does.

    Raises:
        UsageError: the bag cannot be used, or has none of the joints that the parameters name.
    """
    with BagInputs(bag, JOINT_STATES, names, GROUND_REACTION_FORCE) as inputs:
        check_joints(inputs, named_joints(parameters))
        pipeline = LoadPipeline(parameters)
        if parameters.frame.ground:
            learn_transforms(bag, pipeline.frame)
        pairs: list[PairedSample] = []
        for number, message in enumerate(inputs.messages(), start=1):
            take = pipeline.take_joint_state if message.topic == f"/{JOINT_STATES}" else pipeline.take_force
            pairs += take(message.data)
            if number % FEWEST_BETWEEN_NEWS == 0:
                advance(number, inputs.reader.count)
        pairs += pipeline.synchroniser.finish()
        damage = list(inputs.reader.damage)
    samples = [Sensed(pair.load.stamp, *pipeline.sensed(pair), pair.status) for pair in pairs]
    return SensedBag(samples, pipeline.synchroniser.refused, damage)
