"""Joint states that are spread over messages, as where each joint's driver publishes its own."""

import math
from collections.abc import Collection

from ..system.errors import list_names
from .messages import JointState, RefusedSampleError
from .topics import NANOSECONDS


class SpreadJoints:
    """Joins the messages of a topic that each hold some of the wanted joints, or only others."""

    def __init__(self, wanted: Collection[str], max_gap: int) -> None:
        """Begin without messages.

        Args:
            wanted: Names of the joints; the stamp of the first one is that of all.
            max_gap: Largest difference [ns] of the stamps of joints that belong together.
        """
        self._wanted = list(wanted)
        self._max_gap = max_gap
        self._missing = set(wanted)  # joints that have never come
        self._others: dict[str, None] = {}  # names that have come, in order
        self._first: int | None = None  # stamp of the first message
        self._new: dict[str, JointState] = {}  # messages of one joint each, since the last join

    def are_in(self, message: JointState) -> bool:
        """Whether a message has all wanted joints."""
        return set(self._wanted) <= set(message.name)

    def note_complete(self) -> None:
        """Note that a message had all joints: others then concern other joints."""
        self._missing = set()

    def join(self, message: JointState) -> JointState | None:
        """Take a message without all wanted joints; return one of all, or None until each has come anew.

        Raises:
            RefusedSampleError: a joint has never come although the stamps cover `max_gap`, or the message has no
                joint, or not a value for each, or the joints' stamps are too far apart.
        """
        names, stamp = message.name, message.stamp
        self._first = stamp if self._first is None else self._first
        self._others |= dict.fromkeys(names[: len(self._wanted) + 20])
        self._missing -= set(names)
        if not names or (self._missing and abs(stamp - self._first) > self._max_gap):
            missing = next(joint for joint in self._wanted if joint in self._missing or not names)
            known = list_names(list(self._others if names else names))
            text = f"joint_states has no joint {missing!r}; it has {known}"
            raise RefusedSampleError("joint_missing", text)
        for joint in set(names) & set(self._wanted):
            self._new[joint] = _only(message, joint)
        if len(self._new) < len(self._wanted):
            return None
        parts = [self._new[joint] for joint in self._wanted]
        self._new = {}
        stamps = [part.stamp for part in parts]
        apart = max(stamps) - min(stamps)
        if apart > self._max_gap:
            text = f"joint_states: the joints come in messages {apart / NANOSECONDS:.3f} s apart"
            raise RefusedSampleError("joints_apart", f"{text}, above pairing.max_gap")
        return JointState(
            parts[0].stamp,
            parts[0].frame_id,
            tuple(self._wanted),
            _together([part.position for part in parts]),
            _together([part.velocity for part in parts]),
            _together([part.effort for part in parts]),
        )


def _only(message: JointState, joint: str) -> JointState:
    """Part of a message that concerns one joint."""
    index, number = message.name.index(joint), len(message.name)
    values = message.position, message.velocity, message.effort
    for given in values:
        if len(given) not in (0, number):
            counted = f"{number} names and {len(given)} values of one kind"
            raise RefusedSampleError("lengths_differ", f"joint_states has {counted}")
    one = [given[index : index + 1] for given in values]
    return JointState(message.stamp, message.frame_id, (joint,), *one)


def _together(values: list[tuple[float, ...]]) -> tuple[float, ...]:
    """Values of all joints from one or none of each; NaN for a joint without one, none if all are without."""
    return tuple(each[0] if each else math.nan for each in values) if any(values) else ()
