"""The work of `knee-contact import-csv`: make a gait bag from a laboratory's files and a map."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from knee_contact_ros import __version__
from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.offline.gait_files import knee_gait
from knee_contact_ros.offline.gait_files.gait_bag import QUANTITIES, check_output, digest, write_bag
from knee_contact_ros.offline.gait_files.knee_gait import Angles, Reactions
from knee_contact_ros.offline.gait_files.storage import Stamps
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.terminal import WIDTH, say, shown, warn
from knee_contact_ros.system.work_folder import replace, work_folder
from knee_contact_ros.tools.sensors.channels import Bools, Series, read_channels
from knee_contact_ros.tools.sensors.doubts import doubts, impossible
from knee_contact_ros.tools.sensors.sensor_map import SensorMap, read_map

INSIST = "--anyway"
BEYOND = NANOSECONDS
"""Time [ns] before and behind the loads within which angles are kept: as far as `pairing.angle_delay` reaches"""


class Gait(NamedTuple):
    """Gait that is written into the bag."""

    angles: Angles
    reactions: Reactions
    notes: tuple[str, ...]
    """What was converted or left out, as sentences"""


def import_csv(files: Sequence[Path], map_file: Path, output: Path, *, overwrite: bool, anyway: bool) -> None:
    """Import files by a map into the bag `output`, and print a summary.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the values are not those of a knee: with `anyway`
            only if that is impossible, and not just unlikely. Nothing is then written.
    """
    sensors = read_map(map_file)
    if sensors.load is None:
        raise UsageError(f"map {map_file}: load: is missing; only align needs none")
    check_output(output, overwrite)
    channels = read_channels(files, sensors, ("angle", "load", "moment"))
    fault = impossible(channels["angle"], channels["load"])
    if fault:
        raise UsageError(fault)
    doubtful = doubts(channels["angle"], channels["load"], sensors)
    if doubtful and not anyway:
        raise UsageError(f"{doubtful[0]} ({INSIST} imports it as it is)")
    gait = gait_of(channels, sensors)
    origin = origin_record(files, sensors, channels, gait, doubtful)
    with work_folder(output.parent) as work:
        write_bag(sensors.side, gait.angles, gait.reactions, work / output.name, origin, sensors.angle.joint)
        replace(work / output.name, output)
    show(channels, gait, sensors, output)
    warn(doubtful)


def gait_of(channels: dict[str, Series], sensors: SensorMap) -> Gait:
    """Make angles and reactions over the time that angle and load have in common.

    Raises:
        UsageError: there is no such time, or fewer than two samples are left.
    """
    angle, load = channels["angle"], channels["load"]
    notes = [note for series in channels.values() for note in series.notes]
    force, torque = np.zeros((len(load.values), 3)), np.zeros((len(load.values), 3))
    force[:, 1] = 0.0 - load.values  # no minus zero
    if "moment" in channels:
        moment = channels["moment"]
        if moment.stamps[0] > load.stamps[0] or moment.stamps[-1] < load.stamps[-1]:
            raise UsageError(f"{moment.where} spans less than the load")
        torque[:, 0] = np.interp(load.stamps, moment.stamps, moment.values)
    angles, reactions = Angles(angle.stamps, angle.values, None), Reactions(load.stamps, force, torque)
    early = int(np.count_nonzero(load.stamps < 0))
    notes += [f"{early} rows of the load lie before time 0, which no stamp does, and are left out"] * (early > 0)
    window = knee_gait.common_window(angles, reactions, None, None)
    notes += gaps(angle, sensors.max_gap) + gaps(load, sensors.max_gap)
    if sensors.rate:
        angles, reactions = knee_gait.resample(angles, reactions, window, sensors.rate)
        inside = np.all([bridged(angles.stamps, each.stamps, sensors.max_gap) for each in (angle, load)], axis=0)
        if np.count_nonzero(inside) < 2:
            raise UsageError(f"map: rate {sensors.rate:g}: fewer than two samples lie outside gaps (max_gap)")
        angles = Angles(angles.stamps[inside], angles.angle[inside], None)
        reactions = Reactions(reactions.stamps[inside], reactions.force[inside], reactions.torque[inside])
        notes.append(f"both interpolated linearly at {sensors.rate:g} Hz, and nothing where a gap is")
    else:
        rows = len(reactions.stamps) - early
        _, reactions = knee_gait.cut(angles, reactions, window)
        near = (angle.stamps >= max(0, window[0] - BEYOND)) & (angle.stamps <= window[1] + BEYOND)
        angles = Angles(angle.stamps[near], angle.values[near], None)
        outside = rows - len(reactions.stamps)
        notes += [f"{outside} rows of the load left out: no angle at their time"] * (outside > 0)
    return Gait(knee_gait.with_rate(angles), reactions, tuple(notes))


def gaps(series: Series, longest: float) -> list[str]:
    """Note on the gaps between rows that are longer than `longest` [s], if there are any."""
    steps = np.diff(series.stamps) / NANOSECONDS
    wide = steps > longest
    if not wide.any():
        return []
    worst = int(np.argmax(steps))
    return [
        f"{series.name}: {np.count_nonzero(wide)} gaps longer than {longest:g} s, the longest of {steps[worst]:.3g} s "
        f"at {series.stamps[worst] / NANOSECONDS:.7g} s; answers there are flagged STALE_INPUT"
    ]


def bridged(stamps: Stamps, known: Stamps, longest: float) -> Bools:
    """Which stamps lie on a row or between rows that are at most `longest` [s] apart; truth values, shape (n,)."""
    after = np.clip(np.searchsorted(known, stamps, "left"), 1, len(known) - 1)
    near: Bools = (known[after] - known[after - 1] <= longest * NANOSECONDS) | np.isin(stamps, known)
    return near


def origin_record(
    files: Sequence[Path], sensors: SensorMap, channels: dict[str, Series], gait: Gait, doubtful: Sequence[str]
) -> dict[str, str]:
    """Content of the bag's metadata record; nothing in it depends on where or when it is written."""
    record = {"package": f"knee_contact_ros {__version__}", "source": "CSV", "side": sensors.side}
    for number, path in enumerate(files, start=1):
        record |= {f"file {number}": path.name, f"file {number}_sha256": digest(path)}
    record |= {f"columns of {name}": series.columns for name, series in channels.items()}
    record |= {"map": json.dumps(sensors.model_dump(exclude_defaults=True)), "conversions": "\n".join(gait.notes)}
    return record | ({"doubts": "\n".join(doubtful)} if doubtful else {}) | QUANTITIES


def show(channels: dict[str, Series], gait: Gait, sensors: SensorMap, bag: Path) -> None:
    """Print the columns, the ranges of their values, what was left out, and where the bag is."""
    rows = Table(box=None, show_header=False, pad_edge=False)
    rows.add_column(no_wrap=True)
    rows.add_column(overflow="fold")
    degrees, load = np.degrees(gait.angles.angle), -gait.reactions.force[:, 1]
    peak = f", largest {load.max():.1f} N"
    peak += f" ({load.max() / sensors.body_weight:.2f} BW)" if sensors.body_weight else ""
    at = f" at {gait.reactions.stamps[int(load.argmax())] / NANOSECONDS:.3f} s"
    ranges = {
        "angle": f"{span(gait.angles.stamps)}, {degrees.min():.1f} to {degrees.max():.1f} deg",
        "load": f"{span(gait.reactions.stamps)}{peak}{at}",
    }
    for name, series in channels.items():
        rows.add_row(name, shown(f"{series.columns} of {series.path.name}"))
        if name in ranges:
            rows.add_row("", ranges[name])
    Console(width=WIDTH, emoji=False).print(rows, highlight=False)
    for line in ("", *(f"- {note}" for note in gait.notes), *[""][: len(gait.notes)], f"Bag: {bag}"):
        say(line, hang=2)


def span(stamps: Stamps) -> str:
    """Text with the number of rows and their first and last time."""
    return f"{len(stamps)} rows, {stamps[0] / NANOSECONDS:.3f} to {stamps[-1] / NANOSECONDS:.3f} s"
