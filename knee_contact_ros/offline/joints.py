"""Tell a wrong joint name at once, and not after a whole bag of refused samples."""

from __future__ import annotations

from collections.abc import Mapping

from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.offline.bag_inputs import BagInputs
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.samples import Decoder, RefusedSampleError
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.printable import listed


def wanted_joints(parameters: Parameters) -> dict[str, str]:
    """Joints that the contact node needs, by the parameters that name them."""
    wanted = {"knee.joint_name": parameters.knee.joint_name}
    if parameters.drive == "displacement":
        wanted["knee.height_joint_name"] = parameters.knee.height_joint_name
    return wanted


def check_joints(bag: BagInputs, wanted: Mapping[str, str]) -> None:
    """Look for the first sample with the joints that are wanted, by the parameters that name them.

    As a rule that is the first of the bag.

    Raises:
        UsageError: no sample has one of them; lists the joints of the bag.
    """
    decoder = Decoder(deserialize)
    found: dict[str, None] = {}  # a set that keeps the order
    for message in bag.angles():
        try:
            names = decoder.joint_state(message.data)[0].name
        except RefusedSampleError:
            continue
        found |= dict.fromkeys(names)
        if found.keys() >= set(wanted.values()):
            return
    for parameter, joint in wanted.items():
        if found and joint not in found:
            known = listed(list(found))
            text = f"{bag.source} has no joint {joint!r}; it has {known} (parameter {parameter})"
            raise UsageError(f"bag {bag.path}: {text}")
