"""The paired samples of a leg's sensors in a bag, held in memory for callers that estimate from them many times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros.bags.topic_names import Names
from knee_contact_ros.joint_reaction.leg import Ground, Joints, Motion
from knee_contact_ros.offline.estimate_load import MESSAGES_PER_ADVANCE, leg_pipeline
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.pairing import PairedSample
from knee_contact_ros.streams.topics import JOINT_STATES


class Sensed(NamedTuple):
    """Inputs of the load estimator at a stamp."""

    stamp: int
    """Stamp [ns] of the ground force"""
    joints: Joints
    motion: Motion
    ground: Ground
    status: int
    """Bits of `Status`"""


class SensedBag(NamedTuple):
    """The inputs of the load estimator in a bag, in the order of their stamps."""

    samples: list[Sensed]
    refused: Counter[str]
    """Number of refused messages by reason"""
    damage: list[str]
    """Damage of the bag, as sentences"""


def sensed_in(bag: Path, parameters: LoadParameters, names: Names, advance: Callable[[int, int], None]) -> SensedBag:
    """Read a bag and pair its samples as `estimate_load` does; `advance` is called with messages done and in all.

    Raises:
        UsageError: the bag cannot be used, or lacks one of the joints that the parameters name.
    """
    with leg_pipeline(bag, parameters, names) as (inputs, pipeline):
        pairs: list[PairedSample] = []
        for number, message in enumerate(inputs.messages(), start=1):
            take = pipeline.take_joint_state if message.topic == f"/{JOINT_STATES}" else pipeline.take_force
            pairs += take(message.data)
            if number % MESSAGES_PER_ADVANCE == 0:
                advance(number, inputs.reader.count)
        pairs += pipeline.synchroniser.finish()
        damage = list(inputs.reader.damage)
    samples = [Sensed(pair.load.stamp, *pipeline.sense(pair), pair.status) for pair in pairs]
    return SensedBag(samples, pipeline.synchroniser.refused, damage)
