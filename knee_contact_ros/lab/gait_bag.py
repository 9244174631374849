"""A knee's gait in SI units and the package's signs and frames, and its way into a bag of rosbag2.

An importer reads signals from files (`tables.py`), checks them (`checks.py`), and writes them by this module.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..bags.bag import DOUBTS, GAIT_EVENTS, ORIGIN
from ..bags.folder import MCAP, folder_content
from ..bags.metadata_file import METADATA
from ..bags.recorder import BagWriter
from ..model.types import Floats, Stamps
from ..streams import topics
from ..streams.gait_events import GaitEvent
from ..streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from ..streams.topics import NANOSECONDS
from ..system.errors import UsageError
from ..system.files import sha256_of
from ..system.output_files import replace
from ..system.terminal import safe_cell, say, show_pairs, warn

JOINT = "knee"
"""Name of the knee in a bag, whatever its name in the model: the default of `knee.joint_name`"""
_QUANTITIES = {
    "angle": "knee flexion, rad, positive in flexion",
    "force": "joint reaction on the tibia at its frame's origin, in the tibia frame (x anterior, y superior, z to the "
    "right; a left knee is mirrored)",
}
_NET_QUANTITIES = {
    "net_load": "what the thigh exerts on the shank at the knee without muscles: force y < 0 in compression, torque "
    "z > 0 in extension, N and N m"
}
_LEG_QUANTITIES = {
    "joints": "knee flexion; hip, the angle between thigh and vertical in the sagittal plane, positive when the knee "
    "is ahead of the hip; ankle, positive in dorsiflexion, 0 at a right angle; rad",
    "ground_force": "what the ground exerts on the foot, N, and N m about the ankle joint's centre (x forward, y up, z "
    "to the right; a left leg is mirrored)",
}
MIRROR = np.array([1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
"""Signs that turn the wrench on a left knee or foot into that on a right one: force z, torque x and y"""
_BLOCK_ROWS = 8192
"""Number of rows converted to messages at a time: hours of them would take gigabytes"""


class Signal(NamedTuple):
    """Values over time, with stamps of their own.

    Either an angle [rad], optionally with its rate [rad/s] and an actuator's torque [N m] in the same sense; or a
    wrench: force [N] and torque [N m], x y z each.
    """

    stamps: Stamps
    """[ns], increasing; shape (n,)"""
    values: Floats
    """Shape (n, columns)"""

    def rows(self, kept: Any) -> Signal:
        """Select rows by a slice or by booleans, shape (n,)."""
        return Signal(self.stamps[kept], self.values[kept])

    def at(self, stamps: Stamps) -> Signal:
        """Interpolate linearly at other stamps [ns]; beyond the known stamps the end values are kept."""
        first = self.stamps[0]  # nanoseconds since 1970 have more digits than a float
        columns = [
            np.interp(stamps - first, self.stamps - first, column) for column in self.values.T
        ]
        return Signal(stamps, np.column_stack(columns))

    def inside(self, window: tuple[int, int]) -> Signal:
        """Select the rows within a window [ns]."""
        return self.rows((self.stamps >= window[0]) & (self.stamps <= window[1]))

    def around(self, window: tuple[int, int]) -> Signal:
        """Select the rows within a window [ns] and one more at each end, so that all of it can be interpolated."""
        first = max(int(np.searchsorted(self.stamps, window[0], "right")) - 1, 0)
        return self.rows(slice(first, int(np.searchsorted(self.stamps, window[1], "left")) + 1))

    def with_rate(self) -> Signal:
        """Return an angle with its rate: derived by differences of second order if there is none."""
        if self.values.shape[1] > 1:
            return self
        seconds = (self.stamps - self.stamps[0]) / NANOSECONDS
        return Signal(
            self.stamps, np.column_stack([self.values, np.gradient(self.values[:, 0], seconds)])
        )

    @property
    def span(self) -> str:
        """Text with the number of rows and their first and last time."""
        return f"{len(self.stamps)} rows, {self.stamps[0] / NANOSECONDS:.3f} to {self.stamps[-1] / NANOSECONDS:.3f} s"


class ImportedGait(NamedTuple):
    """Gait of a knee, with its origin."""

    side: str
    """`right` or `left`"""
    joints: dict[str, Signal]
    """Angles and rates by the joints' names in the bag, the knee first, all at the same stamps"""
    wrenches: dict[str, Signal]
    """One or both, with x forward, y up and z to the right

    `load`: of the femur on the tibia at the tibia frame's origin, in that frame. `ground_force`: of the ground on the
    foot about the ankle joint's centre, in upright axes. `net_load`: as `load`, without muscles.
    """
    columns: dict[str, str]
    """Names of the columns and of their file, by quantity"""
    notes: list[str]
    """What was converted or left out, as sentences"""
    doubts: Sequence[str] = ()
    """What is likely a mistake, as sentences"""
    weight: float | None = None
    """Body weight [N], if it is known"""
    events: Sequence[GaitEvent] = ()
    """Heel strikes and toe-offs, if they are known"""


def common_window(
    *known: Stamps, start: float | None = None, end: float | None = None
) -> tuple[int, int]:
    """Return the first and last stamp [ns] that all signals cover, between `start` and `end` [s].

    Times before 0 are left out.

    Raises:
        UsageError: they have no time in common, or none within `start` and `end`.
    """
    spans = list(dict.fromkeys((int(each[0]), int(each[-1])) for each in known))
    first = max(0, *(span[0] for span in spans))
    last = min(span[1] for span in spans)
    if first >= last:
        covered = " and ".join(f"{_seconds(a)} to {_seconds(b)} s" for a, b in spans)
        positive = " from 0 s on" if last <= 0 else ""
        raise UsageError(f"the files have no time in common{positive}: {covered}")
    begin = first if start is None else round(start * NANOSECONDS)
    stop = last if end is None else round(end * NANOSECONDS)
    window = max(first, begin), min(last, stop)
    if window[0] >= window[1]:
        raise UsageError(
            f"--start {_seconds(begin)} --end {_seconds(stop)}: nothing is left of "
            f"{_seconds(first)} to {_seconds(last)} s"
        )
    return window


def _seconds(stamp: int) -> str:
    """Return the text of a stamp [ns] in seconds."""
    return f"{stamp / NANOSECONDS:.13g}"


def sampled(
    side: str,
    joints: Mapping[str, Sequence[Signal]],
    wrenches: Mapping[str, Signal],
    others: Mapping[str, Signal] | None = None,
    *,
    rate: float | None,
    max_gap: float,
    start: float | None = None,
    end: float | None = None,
    beyond: int = 0,
) -> ImportedGait:
    """Make a gait from the time that all signals cover, between `start` and `end` [s].

    With a `rate` [Hz] all signals are interpolated at it, except in gaps longer than `max_gap` [s]. Without a rate
    every row keeps its stamp: wrenches their own, and angles those of the first joint, except in such gaps of another.
    Angles begin and end `beyond` [ns] and one row further out, so that every wrench lies between two angles.

    Args:
        side: `right` or `left`; of a left leg the ground's wrench is mirrored.
        joints: For each joint's name in the bag an angle, with or without its rate, then an actuator's torque if any.
        wrenches: `load` or `ground_force` or both.
        others: Other signals by name, whose time must be covered, and whose gaps are told.
        rate: Rate of the samples.
        max_gap: Longest time between rows that is interpolated.
        start: First time.
        end: Last time.
        beyond: Time that the angles cover before and after the wrenches.

    Raises:
        UsageError: fewer than two samples are left.
    """
    of_joints = [signal.stamps for signals in joints.values() for signal in signals]
    named = {"angle": next(iter(joints.values()))[0], **wrenches, **(others or {})}
    every = [*of_joints, *(signal.stamps for signal in (*wrenches.values(), *named.values()))]
    window = common_window(*every, start=start, end=end)
    notes = []
    for name, signal in named.items():
        notes += _gaps(name, signal.around(window).stamps, max_gap)
    if rate:
        at = _regular_stamps(window, rate)
        at = at[np.all([bridged(at, each, max_gap) for each in every], axis=0)]
        inside = {name: wrench.at(at) for name, wrench in wrenches.items()}
        notes.append(f"interpolated linearly at {rate:g} Hz, with gaps left out")
    else:
        wide = named["angle"].around((window[0] - beyond, window[1] + beyond))
        at = wide.inside(common_window(*of_joints)).stamps
        at = at[np.all([bridged(at, each, max_gap) for each in of_joints], axis=0)]
        inside = {name: wrench.inside(window) for name, wrench in wrenches.items()}
        for name, wrench in inside.items():
            if outside := len(wrenches[name].stamps) - len(wrench.stamps):
                notes.append(
                    f"{name}: {outside} rows left out, before time 0 or where another signal or time is not"
                )
    counts = {"angle": len(at), **{name: len(wrench.stamps) for name, wrench in inside.items()}}
    if short := [name for name, count in counts.items() if count < 2]:
        at_rate = f" at {rate:g} Hz, outside gaps of {max_gap:g} s" if rate else ""
        raise UsageError(
            f"fewer than two rows of the {short[0]} are within "
            f"{_seconds(window[0])} to {_seconds(window[1])} s{at_rate}"
        )
    if side == "left" and "ground_force" in inside:
        ground = inside["ground_force"]
        inside["ground_force"] = ground._replace(values=ground.values * MIRROR)
        notes.append("ground: left leg mirrored to a right one (force z, torque x and y turned)")
    moved = {}
    for name, (angle, *torques) in joints.items():
        columns = [angle.at(at).with_rate().values, *(torque.at(at).values for torque in torques)]
        moved[name] = Signal(at, np.hstack(columns))
    return ImportedGait(side, moved, inside, {}, notes)


def _regular_stamps(window: tuple[int, int], rate: float) -> Stamps:
    """Return the stamps [ns] within a window that are multiples of the period of a rate [Hz]."""
    period = NANOSECONDS / rate
    # A millionth of a period is left for rounding.
    steps = np.arange(np.ceil(window[0] / period - 1e-6), np.floor(window[1] / period + 1e-6) + 1)
    return np.clip(np.rint(steps * period).astype(np.int64), *window)


def _gaps(name: str, known: Stamps, longest: float) -> list[str]:
    """Note the gaps between rows at stamps `known` that are longer than `longest` [s], if there are any."""
    steps = np.diff(known) / NANOSECONDS
    wide = int(np.count_nonzero(steps > longest))
    if not wide:
        return []
    worst = int(np.argmax(steps))
    return [
        f"{name}: {wide} gap{'s' * (wide > 1)} longer than {longest:g} s, the longest of {steps[worst]:.3g} s "
        f"at {known[worst] / NANOSECONDS:.13g} s; answers there are flagged STALE_INPUT"
    ]


def bridged(stamps: Stamps, known: Stamps, longest: float) -> NDArray[np.bool_]:
    """Return which stamps lie on a row or between rows at most `longest` [s] apart; booleans, shape (n,)."""
    after = np.clip(np.searchsorted(known, stamps, "left"), 1, len(known) - 1)
    near = known[after] - known[after - 1] <= longest * NANOSECONDS
    return np.asarray(near | np.isin(stamps, known))


def write_bag(gait: ImportedGait, folder: Path, origin: dict[str, str]) -> None:
    """Write a new rosbag2 folder, messages in the order of their stamps; an angle comes before forces of its stamp.

    `origin` is the metadata record.

    Raises:
        UsageError: the folder cannot be written.
    """
    streams = {topics.JOINT_STATES: _joint_messages(gait.joints)}
    for name, topic, frame in (
        ("load", topics.JOINT_REACTION_FORCE, f"tibia_{gait.side[0]}"),
        ("ground_force", topics.GROUND_REACTION_FORCE, "ground"),
        (topics.NET_LOAD, topics.NET_LOAD, f"tibia_{gait.side[0]}"),
    ):
        if name in gait.wrenches:
            streams[topic] = _wrench_messages(gait.wrenches[name], topic, frame)
    with BagWriter(folder / f"{folder.name}_0.mcap") as bag:
        for topic in streams:
            bag.add_topic(f"/{topic}", topics.MESSAGE_TYPES[topic])
        bag.add_metadata(ORIGIN, origin)
        for stamp, topic, data in heapq.merge(*streams.values(), key=itemgetter(0)):
            bag.write_message(f"/{topic}", stamp, data)


def _joint_messages(joints: dict[str, Signal]) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp [ns], topic and bytes of a JointState for every stamp."""
    names = tuple(joints)
    missing = [3 - each.values.shape[1] for each in joints.values()]
    has_torques = not all(missing)
    # Angle, rate and torque of each joint; one without an actuator has no torque.
    padded = [
        np.pad(each.values, ((0, 0), (0, columns)), constant_values=np.nan)
        for each, columns in zip(joints.values(), missing, strict=True)
    ]
    stamps = joints[names[0]].stamps
    for stamp, (angles, rates, torques) in _rows(stamps, np.stack(padded, axis=2)):
        efforts = tuple(torques) if has_torques else ()
        message = JointState(stamp, "", names, tuple(angles), tuple(rates), efforts)
        yield stamp, topics.JOINT_STATES, encode_joint_state(message)


def _wrench_messages(wrench: Signal, topic: str, frame: str) -> Iterator[tuple[int, str, bytes]]:
    """Yield stamp [ns], topic and bytes of a WrenchStamped for every row."""
    for stamp, values in _rows(*wrench):
        message = WrenchStamped(stamp, frame, tuple(values[:3]), tuple(values[3:]))
        yield stamp, topic, encode_wrench_stamped(message)


def _rows(*columns: Any) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of arrays as plain numbers, block by block."""
    for begin in range(0, len(columns[0]), _BLOCK_ROWS):
        block = (column[begin : begin + _BLOCK_ROWS].tolist() for column in columns)
        yield from zip(*block, strict=True)


def store(
    bags: Mapping[Path, ImportedGait],
    source: str,
    files: dict[str, Path],
    more: dict[str, str],
    work: Path,
) -> None:
    """Write bags, first into the folder `work`, then print summaries and doubts.

    The metadata record gets `files`, named by their use, and `more`; nothing in it depends on the time of writing.
    """
    for bag, gait in bags.items():
        origin = {
            "package": f"knee_contact_ros {__version__}",
            "source": source,
            "side": gait.side,
        }
        for name, path in files.items():
            origin |= {name: path.name, f"{name}_sha256": digest(path)}
        origin |= {f"columns of {name}": columns for name, columns in gait.columns.items()}
        origin |= {"conversions": "\n".join(gait.notes)} | _QUANTITIES
        if "ground_force" in gait.wrenches:
            origin |= _LEG_QUANTITIES
        if topics.NET_LOAD in gait.wrenches:
            origin |= _NET_QUANTITIES
        origin |= more
        if gait.weight:
            origin["body_weight"] = f"{gait.weight:.7g} N"
        if gait.events:
            origin[GAIT_EVENTS] = "\n".join(f"{each.stamp} {each.kind}" for each in gait.events)
        if gait.doubts:
            origin[DOUBTS] = "\n".join(gait.doubts)
        write_bag(gait, work / bag.name, origin)
    for bag in bags:
        replace(work / bag.name, bag)
    for bag, gait in bags.items():
        _show(gait, bag)
        warn(gait.doubts)


def _show(gait: ImportedGait, bag: Path) -> None:
    """Print the columns with the ranges of their values, what was converted, and where the bag is."""
    ranges = {}
    for name, signal in zip(("angle", "hip", "ankle"), gait.joints.values(), strict=False):
        low, high = np.degrees([signal.values[:, 0].min(), signal.values[:, 0].max()])
        ranges[name] = f"{signal.span}, {low:.1f} to {high:.1f} deg"
    for name, wrench in gait.wrenches.items():
        force = np.abs(wrench.values[:, 1])
        weight = f" ({force.max() / gait.weight:.2f} BW)" if gait.weight else ""
        at = wrench.stamps[int(force.argmax())] / NANOSECONDS
        ranges[name] = f"{wrench.span}, largest {force.max():.1f} N{weight} at {at:.3f} s"
    say(f"{gait.side} knee")
    show_pairs(
        (name, f"{safe_cell(text)}\n{ranges.get(name, '')}".rstrip())
        for name, text in gait.columns.items()
    )
    say("")
    for note in gait.notes:
        say(f"- {note}", hang=2)
    if gait.notes:
        say("")
    say(f"Bag: {bag}", hang=2)


def check_bag_output(folder: Path, overwrite: bool) -> None:
    """Refuse an output folder that exists, unless it is a bag and may be replaced, and a file's name.

    Raises:
        UsageError: the folder exists, or its name ends with `.mcap`.
    """
    if folder.suffix == MCAP:
        raise UsageError(
            f"--output {folder}: a bag is written as a folder; give its name without {MCAP}"
        )
    if not folder.exists():
        return
    if not overwrite:
        raise UsageError(f"{folder} exists already; give another --output, or --overwrite")
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file and not a bag's folder; it is not replaced")
    others = {path.name for path in folder.iterdir()}
    with suppress(UsageError):  # it is no bag
        contents = folder_content(folder)
        if not contents.faults:
            others -= {METADATA, *(name for name in contents.names if name.endswith(MCAP))}
    if others:
        raise UsageError(
            f"{folder} is not replaced: it has {min(others)}, and no {METADATA} says that it belongs to a bag"
        )


def digest(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal text."""
    with path.open("rb") as file:
        return sha256_of(file)
