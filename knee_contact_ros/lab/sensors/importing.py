"""The work of `knee-contact import-csv`: check what was read by a map, and make a gait bag of it.

What is `impossible` is never imported; what has `doubts` only if the user insists.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from knee_contact_ros import __version__
from knee_contact_ros.joint_reaction.estimator import LEAST_PEAK, MOST_PEAK, STIFF
from knee_contact_ros.lab.gait_bag import (
    QUANTITIES,
    Angles,
    Reactions,
    check_output,
    common_window,
    cut,
    digest,
    resample,
    with_rate,
    write_bag,
)
from knee_contact_ros.lab.sensors.channels import Bools, SensorMap, Series, read_channels, read_map
from knee_contact_ros.lab.tables import BODY_WEIGHT, FORCE, UNITS, Stamps
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.parameters.build import LIGHTEST, weight_doubt
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import replace, work_folder
from knee_contact_ros.system.terminal import WIDTH, say, shown, warn

WIDEST = math.radians(180.0)
"""Range of motion [rad] beyond that of any knee"""
EXTENDS, FLEXES = math.radians(-30.0), math.radians(170.0)
"""Range of flexion angles of any knee [rad]"""
JUMP = math.radians(30.0)
"""Step [rad] from one row to the next that points to a loose contact, or to a new turn of an encoder"""
USUAL_WEIGHT = (LIGHTEST, 2500.0)
"""Range of body weights [N] that is assumed where the map has none"""
USUAL_PEAK = (1.5, 4.0)
"""Range of peak loads [BW] into which the right unit would bring a peak"""
SLOWEST = 5.0
"""Lowest plausible rate of rows [Hz]"""


def impossible(angle: Series, load: Series | None) -> str:
    """Say why these cannot be an angle and a load at all; empty if they can."""
    low, high = float(angle.values.min()), float(angle.values.max())
    if high - low > WIDEST or max(-low, high) > LARGEST_ANGLE:
        return (
            f"{angle.where} goes from {math.degrees(low):.4g} to {math.degrees(high):.4g} deg, which no knee does: is "
            f"{angle.name}.unit right, and is it an angle's column?"
        )
    if load is None:
        return ""
    least, most = float(load.values.min()), float(load.values.max())
    if most < -least:
        return (
            f"{load.where} pulls the knee apart, by up to {-least:.0f} N, and presses with {most:.0f} N at most: see "
            "load.direction"
        )
    if most > LARGEST_LOAD:
        return f"{load.where} presses with {most:.3g} N, beyond {LARGEST_LOAD:g}: is load.unit right?"
    return ""


def doubts(angle: Series, load: Series | None, sensors: SensorMap) -> list[str]:
    """List what is likely a mistake in the map."""
    weight = "" if sensors.body_weight is None else weight_doubt(sensors.body_weight)
    sentences = [weight, _slow(angle), _still(angle), _outside(angle), _jumps(angle, sensors.max_gap)]
    if load is not None:
        sentences += [_slow(load), _peak(load, sensors)]
    return [sentence for sentence in sentences if sentence]


def _slow(series: Series) -> str:
    rate = NANOSECONDS / float(np.median(np.diff(series.stamps)))
    if rate >= SLOWEST:
        return ""
    return f"{series.path} has {rate:.3g} rows a second: is time.unit right?"


def _still(angle: Series) -> str:
    span = float(np.ptp(angle.values))
    if span >= STIFF:
        return ""
    return (
        f"{angle.where} moves by {math.degrees(span):.3g} deg in all: is {angle.name}.unit right, and is it the knee's?"
    )


def _outside(angle: Series) -> str:
    low, high = float(angle.values.min()), float(angle.values.max())
    if low >= EXTENDS and high <= FLEXES:
        return ""
    return (
        f"{angle.where} is {math.degrees(low):.1f} to {math.degrees(high):.1f} deg of flexion, and a knee has "
        f"{math.degrees(EXTENDS):.0f} to {math.degrees(FLEXES):.0f}: is {angle.name}.sign right, or has the sensor an "
        "offset (knee-contact align)?"
    )


def _jumps(angle: Series, max_gap: float) -> str:
    """Doubt about steps that no knee makes; behind a gap, which is noted elsewhere, any angle is possible."""
    steps = np.where(np.diff(angle.seconds) <= max_gap, np.abs(np.diff(angle.values)), 0.0)
    worst = int(np.argmax(steps))
    if steps[worst] <= JUMP:
        return ""
    at, times = angle.stamps[worst + 1] / NANOSECONDS, np.count_nonzero(steps > JUMP)
    return (
        f"{angle.where} jumps by {math.degrees(steps[worst]):.0f} deg at {at:.7g} s"
        f"{f', and {times} times in all' if times > 1 else ''}: a loose contact, or an encoder's turn?"
    )


def _peak(load: Series, sensors: SensorMap) -> str:
    """Doubt about a peak load that is not of the order of the body weight."""
    peak, weight = float(load.values.max()), sensors.body_weight
    lightest, heaviest = (weight, weight) if weight else USUAL_WEIGHT
    least, most = LEAST_PEAK * lightest, MOST_PEAK * heaviest
    if least <= peak <= most:
        return ""
    measured = f"{peak:.4g} N" + (f", {peak / weight:.3g} body weights" if weight else "")
    usual = f"{least:.0f} to {most:.0f} N" if not weight else f"{LEAST_PEAK:g} to {MOST_PEAK:g}"
    hint = _meant(peak, sensors)
    return f"{load.where} presses with {measured} at most, and a knee that bears its body with {usual}{hint}"


def _meant(peak: float, sensors: SensorMap) -> str:
    """Hint at the unit in which a peak load [N] would be a usual one."""
    assert sensors.load is not None  # noqa: S101  (there is a peak)
    weight, given = sensors.body_weight, sensors.load.unit
    question = f": is load.unit {given} right, and is it a load's column?"
    if weight is None or given == BODY_WEIGHT or given not in UNITS[FORCE]:
        return question
    for unit in ("lbf", "N", "kgf", "kN"):
        there = peak / UNITS[FORCE][given] * UNITS[FORCE][unit] / weight
        if unit != given and USUAL_PEAK[0] <= there <= USUAL_PEAK[1]:
            return f": is load.unit {given} right? In {unit} it would be {there:.2g} body weights"
    return question


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
    window = common_window(angles, reactions, None, None)
    notes += gaps(angle, sensors.max_gap) + gaps(load, sensors.max_gap)
    if sensors.rate:
        angles, reactions = resample(angles, reactions, window, sensors.rate)
        inside = np.all([bridged(angles.stamps, each.stamps, sensors.max_gap) for each in (angle, load)], axis=0)
        if np.count_nonzero(inside) < 2:
            raise UsageError(f"map: rate {sensors.rate:g}: fewer than two samples lie outside gaps (max_gap)")
        angles = Angles(angles.stamps[inside], angles.angle[inside], None)
        reactions = Reactions(reactions.stamps[inside], reactions.force[inside], reactions.torque[inside])
        notes.append(f"both interpolated linearly at {sensors.rate:g} Hz, and nothing where a gap is")
    else:
        rows = len(reactions.stamps) - early
        _, reactions = cut(angles, reactions, window)
        near = (angle.stamps >= max(0, window[0] - BEYOND)) & (angle.stamps <= window[1] + BEYOND)
        angles = Angles(angle.stamps[near], angle.values[near], None)
        outside = rows - len(reactions.stamps)
        notes += [f"{outside} rows of the load left out: no angle at their time"] * (outside > 0)
    return Gait(with_rate(angles), reactions, tuple(notes))


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
