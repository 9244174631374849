"""The frame in which a force comes: checked at every sample, and turned into the tibia frame where that is asked for.

Turned is by static transforms only (`/tf_static`), and what is recorded is the turned force. So an answer depends on
samples and not on when a transform arrived, and a recording needs none to be computed again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from knee_contact_ros.messages.cdr import WrenchStamped, encode_wrench_stamped
from knee_contact_ros.messages.transforms import Transform
from knee_contact_ros.pipeline.samples import RefusedSampleError
from knee_contact_ros.system.printable import LONGEST, printable

Pose = NDArray[np.float64]
"""Homogeneous matrix, shape (4, 4): coordinates in the child frame to those in the parent frame, [m]"""
ISB = "_isb"
"""How a tibia frame (x anterior, y superior, z right) is named whose bone has a frame by REP 103 of the same name"""
HALF = 0.5**0.5
FROM_REP_103 = (HALF, 0.0, 0.0, HALF)
"""x forward, y left, z up to x anterior, y superior, z right: a quarter turn about x; quaternion x, y, z, w"""
FORCE_TURNED = "force_turned"
"""Name of the metadata record that tells how forces are turned from there on"""
MOST_FRAMES = 10_000
UNIT = 1e-3
"""By how much the length of a quaternion may differ from 1"""


def isb_transform(frame: str) -> Transform | None:
    """Where the tibia frame lies in the tibia's frame by REP 103; None if its name tells of none."""
    bone = frame.removesuffix(ISB)
    return Transform(bone, frame, (0.0, 0.0, 0.0), FROM_REP_103) if bone and bone != frame else None


class StaticTransforms:
    """A tree of frames; the last that was said of a frame holds."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Pose]] = {}

    def add(self, transform: Transform) -> bool:
        """Learn where a frame lies; whether that is news.

        Raises:
            ValueError: a number is not finite, the quaternion is none, a name is missing or is that of both frames, or
                there are too many.
        """
        parent, child, translation, rotation = transform
        length = float(np.linalg.norm(rotation))
        if not (np.isfinite([*translation, *rotation]).all() and abs(length - 1.0) < UNIT):
            raise ValueError(f"transform from {parent!r} to {child!r}: {translation}, {rotation} are no pose")
        if not parent or not child or parent == child:
            raise ValueError(f"a transform from {parent!r} to {child!r} has no meaning")
        if child not in self._parents and len(self._parents) >= MOST_FRAMES:
            raise ValueError(f"a transform to {child!r} is one more than the {MOST_FRAMES} that are remembered")
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(rotation).as_matrix(), translation
        known = self._parents.get(child)
        self._parents[child] = (parent, pose)
        return known is None or known[0] != parent or not np.array_equal(known[1], pose)

    def between(self, frame: str, wanted: str) -> Pose | None:
        """Coordinates in a frame to those in the wanted one; None if no transforms connect them."""
        up, down = self._up(frame), self._up(wanted)
        common = next((ancestor for ancestor in up if ancestor in down), None)
        return None if common is None else np.linalg.inv(down[common]) @ up[common]

    def _up(self, frame: str) -> dict[str, Pose]:
        """A frame's ancestors, itself first, each with what takes coordinates there."""
        found, pose = {frame: np.eye(4)}, np.eye(4)
        while frame in self._parents:
            frame, step = self._parents[frame]
            if frame in found:  # a circle
                break
            pose = step @ pose
            found[frame] = pose
        return found


class ForceFrame:
    """Takes forces in one frame, that of the first, and turns them if that is not the wanted one."""

    def __init__(self, wanted: str = "") -> None:
        """`wanted` is the name of the tibia frame, `frame.tibia`; empty: forces are taken to be in it as they come."""
        self.wanted = wanted
        self.turn_note: dict[str, str] = {}
        """What is to be told of a turn that is new: see `told`"""
        self._frame: str | None = None  # in which forces come
        self._pose: Pose | None = None  # where that lies in the wanted one; None if nothing is turned
        self._transforms = StaticTransforms()
        own = isb_transform(wanted)
        if own:
            self._transforms.add(own)

    def told(self) -> dict[str, str]:
        """What is to be told of a turn that is new, once."""
        note, self.turn_note = self.turn_note, {}
        return note

    def forget(self) -> None:
        """Take the next force in whatever frame it comes."""
        self._frame = self._pose = None

    def learn(self, transform: Transform) -> None:
        """Learn where a frame lies, from now on.

        Raises:
            ValueError: it makes no sense.
        """
        if not self._transforms.add(transform) or self._frame is None or self._pose is None:
            return
        pose = self._transforms.between(self._frame.removeprefix("/"), self.wanted)
        if pose is None or not np.array_equal(pose, self._pose):
            self.forget()

    def goes_on(self, frame: str) -> bool:
        """Whether a force in this frame is one more of those before, or the first, and needs no turning."""
        if self._frame is None and frame == (self.wanted or frame):
            self._frame = frame
        return frame == self._frame and self._pose is None

    def turned(self, wrench: WrenchStamped, data: bytes) -> tuple[WrenchStamped, bytes]:
        """A force as it acts at the origin of the tibia frame and along its axes, and the bytes to record.

        Raises:
            RefusedSampleError: it is in another frame than those before, or no transform leads to the wanted one.
        """
        if self.goes_on(wrench.frame_id):
            return wrench, data
        if self._frame is None:
            self._take_up(wrench.frame_id)
        elif wrench.frame_id != self._frame:
            text = (
                f"joint_reaction_force is in frame {_short(wrench.frame_id)}, and was in {_short(self._frame)} before"
            )
            raise RefusedSampleError("frame_changed", text)
        assert self._pose is not None  # noqa: S101  (nothing else goes on without turning)
        turned = turned_wrench(wrench, self._pose, self.wanted)
        return turned, encode_wrench_stamped(turned)

    def _take_up(self, frame: str) -> None:
        pose = self._transforms.between(frame.removeprefix("/"), self.wanted)
        if pose is None:
            text = f"joint_reaction_force is in frame {_short(frame)}, and no static transform leads to {self.wanted!r}"
            raise RefusedSampleError("frame_unknown", text)
        self._frame, self._pose = frame, pose
        turn, place = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(), pose[:3, 3].tolist()
        self.turn_note = {
            "from": printable(frame), "to": self.wanted,
            "rotation_xyzw": " ".join(map(repr, turn)), "translation": " ".join(map(repr, place)),
        }  # fmt: skip


def _short(name: str) -> str:
    return repr(name if len(name) <= LONGEST else f"{name[:LONGEST]}...")


def turned_wrench(wrench: WrenchStamped, pose: Pose, frame: str) -> WrenchStamped:
    """The same wrench at the origin and along the axes of another frame: F' = R F, M' = R M + p × F'."""
    turn: Any = pose[:3, :3]
    force = turn @ wrench.force
    torque = turn @ wrench.torque + np.cross(pose[:3, 3], force)
    return WrenchStamped(wrench.stamp, frame, tuple(force.tolist()), tuple(torque.tolist()))
