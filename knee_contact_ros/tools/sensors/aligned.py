"""The work of `knee-contact align`: write offset and lag of an angle sensor as parameters."""

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
"""Deviation of the gain from 1 from which on it is reported"""


def align(files: Sequence[Path], map_file: Path, output: Path, longest: float, *, overwrite: bool) -> None:
    """Align the map's angle with its reference, write the parameter file `output`, and print the estimates.

    Lags from -`longest` to `longest` [s] are tried.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the angles are not those of the same knee. Nothing
            is then written.
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
    alignment = aligned(sensor, reference, longest, sensors.max_gap)
    output.write_text(overlay(alignment, sensor.columns, reference.columns, sensors.angle.sign), encoding="utf-8")
    values_set_in(output)
    show(alignment, output)
    warn(doubts(alignment, sensors.angle.scale))


def overlay(alignment: Alignment, sensor: str, reference: str, sign: float) -> str:
    """Text of the parameter file; `sensor` and `reference` name their columns, `sign` is that of the map's angle."""
    offset, lag = alignment.offset, alignment.lag
    degrees = f"{math.degrees(offset.value):.2f} +- {math.degrees(offset.half):.2f}"
    milliseconds = f"{1e3 * lag.value:.1f} +- {1e3 * lag.half:.1f}"
    comments = [
        f"Written by knee-contact align: {sensor} against {reference}",
        f"offset {degrees} deg, lag {milliseconds} ms (95 %); r {alignment.after[0]:.4f}.",
        *["The sensor falls in flexion: live, give knee.flexion_sign: -1.0 too; import-csv has turned it."][: sign < 0],
    ]
    return (
        "".join(f"# {' '.join(line.split())}\n" for line in comments)
        + "/**/knee_contact:\n  ros__parameters:\n"
        + f"    knee:\n      flexion_offset: {offset.value:.6f}\n"
        + f"    pairing:\n      angle_delay: {lag.value:.6f}\n"
    )


def show(alignment: Alignment, output: Path) -> None:
    """Print the estimates with their intervals, and the correlation and difference before and after."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "value", "95 % interval", "parameter"):
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=True)
    for name, estimate, factor, digits, parameter in (
        ("offset [deg]", alignment.offset, math.degrees(1.0), 2, "knee.flexion_offset [rad]"),
        ("lag [ms]", alignment.lag, 1e3, 1, "pairing.angle_delay [s]"),
        ("gain", alignment.gain, 1.0, 3, "none; angle.scale in the map"),
    ):
        value, half = factor * estimate.value, factor * estimate.half
        interval = f"{value - half:.{digits}f} to {value + half:.{digits}f}"
        table.add_row(shown(name), f"{value:.{digits}f}", interval, shown(parameter))
    Console(width=WIDTH, emoji=False).print(table, highlight=False)
    for label, (r, rms) in {"as they are": alignment.before, "aligned": alignment.after}.items():
        say(f"{label}: r {r:.4f}, {math.degrees(rms):.2f} deg RMS")
    say(f"{alignment.rows} rows in common, intervals from {alignment.stretches} stretches")
    say("")
    say(f"Parameters: {output}")


def doubts(alignment: Alignment, scale: float) -> list[str]:
    """Warn of a gain, which offset and delay cannot correct; `scale` is that of the map's angle."""
    gain = alignment.gain.value
    least, most = alignment.gain.bounds
    if abs(gain - 1.0) <= GAIN_OFF or least <= 1.0 <= most:
        return []
    return [
        f"the sensor moves {gain:.3f} times as far as the reference, {least:.3f} to {most:.3f}, and "
        f"{math.degrees(alignment.after[1]):.1f} deg RMS are left; angle.scale {scale / gain:.4g} in the map "
        "would make up for it (then align again)"
    ]
