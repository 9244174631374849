"""Bags whose angles come from ros2_control, and whose forces come in a sensor's frame: the answers of the plain bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.bags.reader import BagReader, RawMessage, metadata_records, names_in_bag
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.sources import DYNAMIC_JOINT_STATE
from knee_contact_ros.streams.frames import (
    FORCE_TURNED,
    TF_MESSAGE,
    TF_STATIC,
    Transform,
    decode_transforms,
    encode_transforms,
)
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    _types,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import MESSAGE_TYPES
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import Mcap

STEP = 5_000_000
STAMPS = [i * STEP for i in range(60)]
ANGLES = [0.2 + 0.1 * float(np.sin(0.3 * i)) for i in range(60)]
AXIAL = [900.0 + 400.0 * float(np.sin(0.4 * i)) for i in range(60)]
TURN = (0.5, 0.5, 0.5, 0.5)
"""The tibia's x lies along the sensor's y, its y along z, its z along x: exact in floating point"""
SAME = {"knee.joint_name": "knee_r"}


def dynamic(stamp: int, **positions: float) -> bytes:
    """As a joint state broadcaster writes it: a joint without a position before, and efforts beside positions."""
    types = _types().types
    interface = types["control_msgs/msg/InterfaceValue"]
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "")
    values = [interface(["effort"], np.array([3.0]))]
    values += [interface(["velocity", "position"], np.array([np.nan, at])) for at in positions.values()]
    message = types[DYNAMIC_JOINT_STATE](header, ["motor", *positions], values)
    return bytes(_types().serialize_cdr(message, DYNAMIC_JOINT_STATE))


def bag_of(path: Path, angles: list[bytes], forces: list[bytes], angle_topic: tuple[str, str], *more: bytes) -> Path:
    """A bag of angles and forces at `STAMPS`; `more` are messages of `/tf_static`."""
    mcap = Mcap(path)
    angle, force = (
        mcap.channel(*angle_topic),
        mcap.channel("/joint_reaction_force", MESSAGE_TYPES["joint_reaction_force"]),
    )
    transforms = mcap.channel(TF_STATIC, TF_MESSAGE)
    for data in more:
        mcap.write(transforms, RawMessage(TF_STATIC, STAMPS[-1], data))
    for stamp, *both in zip(STAMPS, angles, forces, strict=True):
        for channel, data in zip((angle, force), both, strict=True):
            mcap.write(channel, RawMessage("", stamp, data))
    return mcap.close()


PLAIN = ("/joint_states", MESSAGE_TYPES["joint_states"])


def plain_angles() -> list[bytes]:
    pairs = zip(STAMPS, ANGLES, strict=True)
    return [encode_joint_state(JointState(stamp, "", ("knee_r",), (angle,), (), ())) for stamp, angle in pairs]


def forces(frame: str, turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)) -> list[bytes]:
    """What a sensor says that is turned so in the tibia frame."""
    down = np.round(Rotation.from_quat(turn).inv().apply([0.0, -1.0, 0.0]))
    pairs = zip(STAMPS, AXIAL, strict=True)
    return [encode_wrench_stamped(WrenchStamped(t, frame, tuple(axial * down), (0.0, 0.0, 0.0))) for t, axial in pairs]


def answers(path: Path) -> list[bytes]:
    with BagReader(path, {"/knee_contact": MESSAGE_TYPES["knee_contact"]}) as reader:
        return [message.data for message in reader.raw_messages()]


@pytest.fixture
def plain(tmp_path: Path) -> list[bytes]:
    """The answers to the plain bag."""
    bag = bag_of(tmp_path / "plain.mcap", plain_angles(), forces("tibia"), PLAIN)
    solve(bag, load_parameters(SAME), tmp_path / "plain_out.mcap", lambda *_: None)
    return answers(tmp_path / "plain_out.mcap")


def test_angles_of_ros2_control_give_the_same_answers(plain: list[bytes], tmp_path: Path) -> None:
    states = [dynamic(stamp, hip_r=9.9, knee_r=angle) for stamp, angle in zip(STAMPS, ANGLES, strict=True)]
    topic = ("/left/dynamic_joint_states", DYNAMIC_JOINT_STATE)
    bag = bag_of(tmp_path / "dynamic.mcap", states, forces("tibia"), topic)
    how, out, again = load_parameters(SAME | {"knee.source": "dynamic_joint_states"}), tmp_path / "o", tmp_path / "p"
    names = names_in_bag(["dynamic_joint_states:=/left/dynamic_joint_states"])
    solve(bag, how, out, lambda *_: None, names=names)
    assert answers(out) == plain
    recorded = read_provenance(out)
    assert recorded is not None
    solve(out, recorded, again, lambda *_: None)  # what is recorded are JointStates
    assert answers(again) == plain
    with pytest.raises(UsageError, match=r"has no topic /joint_states"):
        solve(bag, load_parameters(SAME), tmp_path / "q", lambda *_: None)


def test_forces_in_a_sensors_frame_give_the_same_answers(plain: list[bytes], tmp_path: Path) -> None:
    """The transform stands at the end of the bag: it holds for all of it."""
    transform = encode_transforms([Transform("tibia", "sensor", (0.0, 0.0, 0.0), TURN)], 0)
    assert decode_transforms(transform) == [Transform("tibia", "sensor", (0.0, 0.0, 0.0), TURN)]
    bag = bag_of(tmp_path / "s.mcap", plain_angles(), forces("sensor", TURN), PLAIN, transform)
    how, out = load_parameters(SAME | {"frame.tibia": "tibia"}), tmp_path / "out.mcap"
    solve(bag, how, out, lambda *_: None)
    assert answers(out) == plain
    note = next(record.metadata for record in metadata_records(out) if record.name == FORCE_TURNED)
    assert (note["from"], note["to"]) == ("sensor", "tibia")
    recorded = read_provenance(out)
    assert recorded is not None
    solve(recorded.recording, recorded, tmp_path / "again.mcap", lambda *_: None)  # it needs no transform any more
    assert answers(tmp_path / "again.mcap") == plain


def test_a_bag_whose_frame_changes_loses_what_is_in_the_other(plain: list[bytes], tmp_path: Path) -> None:
    mixed = [
        other if i >= 40 else same for i, (same, other) in enumerate(zip(forces("tibia"), forces("x"), strict=True))
    ]
    bag = bag_of(tmp_path / "m.mcap", plain_angles(), mixed, PLAIN)
    summary = solve(bag, load_parameters(SAME), tmp_path / "out.mcap", lambda *_: None)
    assert summary.refused == {"frame_changed": 20}
    assert answers(tmp_path / "out.mcap") == plain[:40]
