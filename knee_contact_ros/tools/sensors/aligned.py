"""The work of `knee-contact align`: two angles of one knee → what the sensor is off by, as parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from knee_contact_ros.parameters.reading import values_set_in
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.terminal import WIDTH, say, shown, warn
from knee_contact_ros.tools.sensors.alignment import Alignment, aligned
from knee_contact_ros.tools.sensors.channels import read_channels
from knee_contact_ros.tools.sensors.doubts import impossible
from knee_contact_ros.tools.sensors.sensor_map import read_map

GAIN_OFF = 0.05
"""From which on a gain other than 1 is told"""


def align(files: Sequence[Path], map_file: Path, output: Path, longest: float, *, overwrite: bool) -> None:
    """Do what the command line asks for.

    Raises:
        UsageError: file, map or output cannot be used, or the two angles are not of one knee. Nothing is then written.
    """
    sensors = read_map(map_file)
    if sensors.reference is None:
        raise UsageError(f"map {map_file}: reference: is missing, the angle that `angle` is held against")
    if output.exists() and not overwrite:
        raise UsageError(f"{output} exists already; give another --output, or --overwrite")
    channels = read_channels(files, sensors, ("angle", "reference"))
    sensor, reference = channels["angle"], channels["reference"]
    fault = impossible(sensor, None) or impossible(reference, None)
    if fault:
        raise UsageError(fault)
    found = aligned(sensor, reference, longest, sensors.max_gap)
    output.write_text(overlay(found, sensor.columns, reference.columns, sensors.angle.sign), encoding="utf-8")
    values_set_in(output)
    show(found, output)
    warn(doubts(found, sensors.angle.scale))


def overlay(found: Alignment, sensor: str, reference: str, sign: float) -> str:
    """The parameter file."""
    said = [
        f"Written by knee-contact align: {sensor} against {reference}",
        f"offset {_degrees(found.offset)} deg, lag {_milliseconds(found.lag)} ms (95 %); r {found.after[0]:.4f}.",
        *["The sensor falls in flexion: live, give knee.flexion_sign: -1.0 too; import-csv has turned it."][: sign < 0],
    ]
    return (
        "".join(f"# {' '.join(line.split())}\n" for line in said)
        + "/**/knee_contact:\n  ros__parameters:\n"
        + f"    knee:\n      flexion_offset: {found.offset.value:.6f}\n"
        + f"    pairing:\n      angle_delay: {found.lag.value:.6f}\n"
    )


def show(found: Alignment, output: Path) -> None:
    """Print the estimates with their intervals, and what is left."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "value", "95 % interval", "parameter"):
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=True)
    for name, estimate, factor, digits, parameter in (
        ("offset [deg]", found.offset, math.degrees(1.0), 2, "knee.flexion_offset [rad]"),
        ("lag [ms]", found.lag, 1e3, 1, "pairing.angle_delay [s]"),
        ("gain", found.gain, 1.0, 3, "none; angle.scale in the map"),
    ):
        value, interval = f"{factor * estimate.value:.{digits}f}", _interval(estimate, factor, digits)
        table.add_row(shown(name), value, interval, shown(parameter))
    Console(width=WIDTH).print(table, highlight=False)
    for label, (r, rms) in {"as they are": found.before, "aligned": found.after}.items():
        say(f"{label}: r {r:.4f}, {math.degrees(rms):.2f} deg RMS")
    say(f"{found.rows} rows in common, intervals from {found.stretches} stretches")
    say("")
    say(f"Parameters: {output}")


def doubts(found: Alignment, scale: float) -> list[str]:
    """What offset and delay cannot make right."""
    least, most = found.gain.bounds
    off = abs(found.gain.value - 1.0) > GAIN_OFF and not least <= 1.0 <= most
    told = (
        f"the sensor moves {found.gain.value:.3f} times as far as the reference, {least:.3f} to {most:.3f}, and "
        f"{math.degrees(found.after[1]):.1f} deg RMS are left; angle.scale {scale / found.gain.value:.4g} in the map "
        "would make up for it (then align again)"
    )
    return [told] if off else []


def _interval(estimate: tuple[float, float], factor: float, digits: int) -> str:
    value, half = (factor * number for number in estimate)
    return f"{value - half:.{digits}f} to {value + half:.{digits}f}"


def _degrees(estimate: tuple[float, float]) -> str:
    value, half = (math.degrees(number) for number in estimate)
    return f"{value:.2f} +- {half:.2f}"


def _milliseconds(estimate: tuple[float, float]) -> str:
    return f"{1e3 * estimate[0]:.1f} +- {1e3 * estimate[1]:.1f}"
