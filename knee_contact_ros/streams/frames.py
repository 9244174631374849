"""The frame of the forces: checked at every sample; a parameter can request a transform to the tibia frame.

Only static transforms (`/tf_static`) are used, and the transformed force is recorded. So answers depend on samples and
not on when a transform arrived, and a recording can be computed again without transforms.
"""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..system.errors import MAX_NAME_LENGTH, printable
from .messages import (
    HEADER,
    LARGEST_MESSAGE,
    RefusedSampleError,
    WrenchStamped,
    encode_wrench_stamped,
)
from .topics import JOINT_REACTION_FORCE, NANOSECONDS, typestore

TF_MOVING, TF_STATIC = "/tf", "/tf_static"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
Pose = NDArray[np.float64]
"""Homogeneous matrix, shape (4, 4): coordinates in the child frame to those in the parent frame, [m]"""
ISB_SUFFIX = "_isb"
"""Suffix of a tibia frame (x anterior, y superior, z right) whose bone has a frame by REP 103 without the suffix"""
TIBIA_FRAME = "tibia"
"""Name of the tibia frame if forces are turned and no parameter names it"""
SQRT_HALF = 0.5**0.5
FROM_REP_103 = (SQRT_HALF, 0.0, 0.0, SQRT_HALF)
"""Rotation from x forward, y left, z up to x anterior, y superior, z right, a quarter turn about x; as x, y, z, w"""
NOT_OF_A_TIBIA = frozenset({"world", "map", "odom", "earth", "base_link", "base_footprint"})
"""Names of frames that do not turn with a shank, by REP 105 and REP 120"""
MOST_MOVING = 1000
"""Number of messages of `/tf` that are looked at, for the sentence about a missing static transform"""
FORCE_TURNED = "force_turned"
"""Name of the metadata record that describes how later forces are transformed"""
MAX_CHAIN = 100
"""Largest number of transforms followed from a frame to its ancestors"""
MAX_DISTANCE = 1e6
"""Largest distance [m] from one frame to the next"""
MAX_NORM_ERROR = 0.01
"""Largest difference of the square of a quaternion's length from 1, as in tf2"""


class Transform(NamedTuple):
    """Pose of a child frame in its parent frame: p_parent = rotation · p_child + translation."""

    parent: str
    """Name of the parent frame"""
    child: str
    """Name of the child frame"""
    translation: tuple[float, float, float]
    """Translation x, y, z [m]"""
    rotation: tuple[float, float, float, float]
    """Rotation as a quaternion x, y, z, w"""


def decode_transforms(data: bytes) -> list[Transform]:
    """Transforms in the bytes of a TFMessage.

    Raises:
        ValueError: the bytes are not such a message, or so many that reading them would delay other messages.
    """
    if len(data) > LARGEST_MESSAGE:
        raise ValueError(
            f"a message of {len(data)} bytes is not read; at most {LARGEST_MESSAGE} are"
        )
    try:
        message: Any = typestore().deserialize_cdr(data, TF_MESSAGE)
        return [
            _transform(one.header.frame_id, one.child_frame_id, one.transform)
            for one in message.transforms
        ]
    except Exception as error:  # whatever broken bytes provoke
        raise ValueError(
            f"{len(data)} bytes are not a {TF_MESSAGE} ({' '.join(str(error).split())})"
        ) from None


def encode_transform(transform: Transform, stamp: int) -> bytes:
    """Bytes of a TFMessage with a transform at a stamp [ns]."""
    pack, parent, child = _packer(transform.parent, transform.child)
    times = divmod(stamp, NANOSECONDS)
    names = len(parent), parent, len(child), child
    return pack(HEADER, 1, *times, *names, *transform.translation, *transform.rotation)


@lru_cache(maxsize=16)
def _packer(parent: str, child: str) -> tuple[Callable[..., bytes], bytes, bytes]:
    """Packer of a message with one transform, and the names of its frames as they are written."""
    one, other = f"{parent}\0".encode(), f"{child}\0".encode()
    first = -len(one) % 4
    second = -(16 + len(one) + first + 4 + len(other)) % 8
    return Struct(f"<4sIiII{len(one)}s{first}xI{len(other)}s{second}x7d").pack, one, other


def _transform(parent: str, child: str, transform: Any) -> Transform:
    place, turn = transform.translation, transform.rotation
    return Transform(
        parent.removeprefix("/"),
        child.removeprefix("/"),
        (place.x, place.y, place.z),
        (turn.x, turn.y, turn.z, turn.w),
    )


def isb_transform(frame: str) -> Transform | None:
    """Pose of a tibia frame in the bone's frame by REP 103; None if its name lacks the suffix."""
    bone = frame.removesuffix(ISB_SUFFIX)
    return (
        Transform(bone, frame, (0.0, 0.0, 0.0), FROM_REP_103) if bone and bone != frame else None
    )


class StaticTransforms:
    """Tree of frames; a later transform of a frame replaces an earlier one."""

    def __init__(self) -> None:
        self._known: dict[str, Transform] = {}  # by child frame

    def add_transform(self, transform: Transform) -> bool:
        """Add a transform, and return whether it changes the tree.

        Raises:
            ValueError: a number is not finite or too large, the quaternion is not of unit length, a name is missing, or
                both names are equal.
        """
        parent, child, translation, rotation = transform
        label = f"transform from {_short(parent)} to {_short(child)}"
        if not parent or not child or parent == child:
            raise ValueError(f"{label}: it has no meaning")
        length = sum(part * part for part in rotation)
        if not (
            all(abs(part) <= MAX_DISTANCE for part in translation)
            and abs(length - 1.0) < MAX_NORM_ERROR
        ):
            raise ValueError(f"{label}: {translation}, {rotation} are not a pose")
        news = self._known.get(child) != transform
        self._known[child] = transform
        return news

    def between(self, frame: str, wanted: str) -> Pose | None:
        """Pose that converts coordinates from a frame to the wanted one; None if no transforms connect them."""
        up, down = self._up(frame), self._up(wanted)
        common = next((ancestor for ancestor in up if ancestor in down), None)
        return None if common is None else np.linalg.inv(down[common]) @ up[common]

    def _up(self, frame: str) -> dict[str, Pose]:
        """Ancestors of a frame, itself first, each with the pose that converts coordinates to it."""
        ancestors, pose = {frame: np.eye(4)}, np.eye(4)
        while frame in self._known and len(ancestors) <= MAX_CHAIN:
            step = self._known[frame]
            frame = step.parent
            if frame in ancestors:  # a cycle
                break
            pose = _pose(step) @ pose
            ancestors[frame] = pose
        return ancestors


def _pose(transform: Transform) -> Pose:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = (
        _rotations().from_quat(transform.rotation).as_matrix(),
        transform.translation,
    )
    return pose


def _rotations() -> Any:
    """SciPy's class of rotations, imported when it is needed."""
    from scipy.spatial.transform import (
        Rotation,
    )  # a fifth of a second to import; most forces are not turned

    return Rotation


def rotation_pose(numbers: Sequence[float]) -> Pose | None:
    """Pose with the rotation by these numbers (`rotation_numbers`); None without numbers."""
    if not numbers:
        return None
    turn, pose = _rotations(), np.eye(4)
    one = turn.from_quat(numbers) if len(numbers) == 4 else turn.from_euler("xyz", numbers)
    pose[:3, :3] = one.as_matrix()
    return pose


class ForceFrame:
    """Checks that all forces come in one frame, and transforms them if that is not the wanted one."""

    def __init__(
        self, wanted: str = "", topic: str = JOINT_REACTION_FORCE, rotation: Sequence[float] = ()
    ) -> None:
        """Expect forces of `topic`; `wanted` names the tibia frame, or is empty if forces need no transform.

        A `rotation` (`rotation_numbers`) turns all forces, without transforms. It is a parameter, so the forces are
        recorded as they came, and turned again when the recording is computed.
        """
        self.wanted, self._topic = wanted, topic
        self.is_known = False
        """Whether all forces are known to be in the tibia frame, as in a recording; then nothing is checked"""
        self.turn_note: dict[str, str] = {}
        """Metadata record of a turn that is new; see `take_turn_note`"""
        self._frame: str | None = None  # of the forces as they come
        self._pose: Pose | None = (
            None  # its pose in the wanted frame; None if nothing is transformed
        )
        self._candidate: Pose | None = None  # that pose for the last force, while no frame is held
        self._rotation = rotation_pose(rotation)
        self._transforms = StaticTransforms()
        self._with_moving = StaticTransforms()  # those of `/tf`, too
        if wanted:
            _rotations()  # now, and not while a force waits
        own = isb_transform(wanted)
        if own:
            self.add_transforms([own])

    @property
    def doubt(self) -> str:
        """Sentence that the forces' frame does not turn with the tibia, and they are not turned; else empty."""
        name = (self._frame or "").rpartition("/")[2]
        if self.wanted or self._rotation is not None or name.lower() not in NOT_OF_A_TIBIA:
            return ""
        return (
            f"the forces are in frame {_short(self._frame or '')}, which does not turn with the tibia, and are taken "
            "as if it were the tibia's: publish them in a frame of the shank; frame.tibia or load.rotation turn those "
            "of a sensor that is fixed to it"
        )

    def take_turn_note(self) -> dict[str, str]:
        """Metadata record of a new turn, or an empty one; each record is returned once."""
        note, self.turn_note = self.turn_note, {}
        return note

    def forget_frame(self) -> None:
        """Accept the next force in any frame."""
        self._frame = self._pose = None

    def add_transforms(self, transforms: Iterable[Transform]) -> list[str]:
        """Use transforms from now on; return messages about invalid ones, which are ignored."""
        problems, news = [], False
        for transform in transforms:
            try:
                news |= self._transforms.add_transform(transform)
                self._with_moving.add_transform(transform)
            except ValueError as error:
                problems.append(str(error))
        if news and self._frame is not None and self._pose is not None:
            pose = self._transforms.between(self._frame.removeprefix("/"), self.wanted)
            if pose is None:
                self.forget_frame()
            elif not np.array_equal(pose, self._pose):
                self._turn_by(pose, self._frame)
        return problems

    def note_moving(self, transforms: Iterable[Transform]) -> None:
        """Remember transforms that move, which are not used, for the sentence about a missing static one."""
        for transform in transforms:
            with suppress(ValueError):
                self._with_moving.add_transform(transform)

    def needs_no_turn(self, frame: str) -> bool:
        """Whether a force in this frame is accepted, is in the same frame as earlier ones, and needs no transform."""
        if self._rotation is not None:
            return False
        if self.is_known:
            return True
        if self._frame == "" and not self.wanted:  # a publisher that did not know its frame yet
            return True
        expected = (self.wanted or frame) if self._frame is None else self._frame
        return frame == expected and self._pose is None

    @property
    def is_held(self) -> bool:
        """Whether a force with the name of a frame was accepted, so that all others are expected in it."""
        return bool(self._frame)

    def hold_frame(self, frame: str) -> None:
        """Expect forces in the frame of the last one, which was accepted."""
        self._frame = frame
        if self._candidate is not None:
            self._turn_by(self._candidate, frame)

    def turn_wrench(self, wrench: WrenchStamped, data: bytes) -> tuple[WrenchStamped, bytes]:
        """Transform a force to the origin and the axes of the tibia frame; return it, and the bytes to record.

        Raises:
            RefusedSampleError: its frame differs from earlier forces', or no transform leads to the wanted one.
        """
        frame = wrench.frame_id
        self._candidate = None
        if self.needs_no_turn(frame):
            return wrench, data
        if self._frame not in (None, frame) and not self.is_known:
            text = f"{self._topic} is in frame {_short(frame)}, and was in {_short(self._frame)} before"
            text += "; if the new one is right, ~/reset takes it"
            raise RefusedSampleError("frame_changed", text)
        if self._rotation is not None:
            return turned_wrench(wrench, self._rotation, self.wanted or TIBIA_FRAME), data
        pose = self._pose
        if pose is None:
            self._candidate = pose = self._transforms.between(frame.removeprefix("/"), self.wanted)
        if pose is None:
            text = f"{self._topic} is in frame {_short(frame)}, and no static transform leads to {self.wanted!r}"
            if self._with_moving.between(frame.removeprefix("/"), self.wanted) is not None:
                text += f"; the way there on {TF_MOVING} moves, and only {TF_STATIC} is used"
            raise RefusedSampleError("frame_unknown", text)
        turned = turned_wrench(wrench, pose, self.wanted)
        return turned, encode_wrench_stamped(turned)

    def _turn_by(self, pose: Pose, frame: str) -> None:
        turn, place = (
            _rotations().from_matrix(pose[:3, :3]).as_quat().tolist(),
            pose[:3, 3].tolist(),
        )
        self._pose = pose
        self.turn_note = {
            "from": printable(frame),
            "to": self.wanted,
            "rotation_xyzw": " ".join(map(repr, turn)),
            "translation": " ".join(map(repr, place)),
        }


def _short(name: str) -> str:
    return repr(name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}...")


def turned_wrench(wrench: WrenchStamped, pose: Pose, frame: str) -> WrenchStamped:
    """Transform a wrench to the origin and the axes of another frame: F' = R F, M' = R M + p × F'."""
    *rows, _ = pose.tolist()
    fx, fy, fz = force = _turned(rows, wrench.force)
    mx, my, mz = _turned(rows, wrench.torque)
    px, py, pz = (row[3] for row in rows)
    torque = mx + py * fz - pz * fy, my + pz * fx - px * fz, mz + px * fy - py * fx
    return WrenchStamped(wrench.stamp, frame, force, torque)


def _turned(
    rows: list[list[float]], vector: tuple[float, float, float]
) -> tuple[float, float, float]:
    x, y, z = vector
    one, two, three = (a * x + b * y + c * z for a, b, c, _ in rows)
    return one, two, three
