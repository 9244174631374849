"""The work of `knee-contact align`: offset, lag and gain of an angle sensor against a reference, with intervals.

The sensor is modelled as offset + gain x reference(t - lag). The lag is the one with the highest correlation; a cubic
spline through the reference resolves fractions of a sample, and a wrong gain does not bias it. The offset is the mean
difference at that lag, since parameters can correct an offset but not a gain. A jackknife over stretches of about a
second gives the intervals: it leaves each stretch out once, and the spread of the results is the error. It assumes
nothing about errors within a stride (Miller 1974, The jackknife - a review, Biometrika 61:1).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from ..model.types import Floats, Indices
from ..parameters.files import parameter_text
from ..parameters.schema import Parameters
from ..streams.topics import NANOSECONDS
from ..system.errors import UsageError
from ..system.output_files import check_name_free, check_not_input, write_complete
from ..system.terminal import as_json, print_json, safe_cell, say, show_table, warn
from . import checks
from .sensor_map import AngleChannel, read_map
from .sensors import read_channels
from .tables import TimeSeries
from .units import unit_factor

STRETCH = 1.0
"""Duration of a stretch that the jackknife leaves out [s]: about a stride"""
MIN_STRETCHES = 4
"""Smallest number of stretches"""
MAX_STRETCHES = 60
"""Largest number of stretches: each is a further fit"""
MIN_ROWS = 40
"""Smallest number of rows in common"""
MAX_ROWS = 50_000
"""Largest number of rows that are used; longer recordings are thinned evenly"""
MIN_CORRELATION = 0.8
"""Correlation below which two angles are refused as not being of the same knee"""
MAX_GAIN = 5.0
"""Largest gain, and inverse of the smallest: soft tissue gives 0.8, degrees read as radians 57"""
NOTABLE_GAIN = 0.05
"""Deviation of the gain from 1 above which it is reported"""


class ValueWithInterval(NamedTuple):
    """Value with its confidence interval."""

    value: float
    half: float
    """Half width of the 95 % interval"""

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper end of the interval."""
        return self.value - self.half, self.value + self.half


class Alignment(NamedTuple):
    """Offset, lag and gain of an angle sensor against a reference."""

    offset: ValueWithInterval
    """Offset to add to the sensor's angle [rad]"""
    lag: ValueWithInterval
    """Time by which the sensor is late [s]"""
    gain: ValueWithInterval
    """Ratio of the sensor's motion to that of the reference"""
    rows: int
    """Number of rows in common"""
    before: tuple[float, float]
    """Correlation and RMS difference [rad] of the angles as they are"""
    after: tuple[float, float]
    """Correlation and RMS difference [rad] with offset and lag removed"""


def align(
    files: Sequence[Path], maps: Sequence[Path], output: Path, longest_lag: float, overwrite: bool
) -> None:
    """Align the map's angle with its reference, write the parameter file `output`, and print the estimates.

    Lags from -`longest_lag` to `longest_lag` [s] are tried.

    Raises:
        UsageError: a file, the map or the output cannot be used, or the angles are not of the same knee. Nothing is
            written then.
    """
    check_not_input(output, [*files, *maps])
    if not overwrite:
        check_name_free(output)
    sensors = read_map(maps)
    if sensors.reference is None:
        raise UsageError(
            f"map {maps[-1]}: reference: is missing: the angle that `angle` is compared with"
        )
    sensor, reference = read_channels(files, sensors, ("angle", "reference")).values()
    checks.refuse(checks.impossible(sensor) + checks.impossible(reference))
    alignment = aligned(sensor, reference, longest_lag, sensors.max_gap)
    text = overlay(alignment, sensor.columns, reference.columns, sensors.angle)
    write_complete({output: text.encode()})
    show_alignment(alignment, output)
    gain = alignment.gain.value
    least, most = alignment.gain.bounds
    # Offset and delay cannot correct a gain.
    if abs(gain - 1.0) > NOTABLE_GAIN and not least <= 1.0 <= most:
        left = math.degrees(alignment.after[1])
        warn(
            [
                f"the sensor moves {gain:.3f} times as far as the reference, {least:.3f} to {most:.3f}, and "
                f"{left:.1f} deg RMS are left; angle.scale {sensors.angle.scale / gain:.4g} in the map would make up "
                "for it (then align again)"
            ]
        )


class AnglePair:
    """Rows of a sensor, and a cubic spline through those of the reference."""

    def __init__(self, sensor: TimeSeries, reference: TimeSeries, max_gap: float) -> None:
        """Both must share a clock; `rows` skips rows in gaps of the reference longer than `max_gap` [s]."""
        self.times, self._known = (
            (each.stamps - reference.stamps[0]) / NANOSECONDS for each in (sensor, reference)
        )
        self.values = sensor.values
        self._curve = CubicSpline(self._known, reference.values)
        self._wide = np.diff(self._known) > max_gap
        self.step = max(float(np.median(np.diff(times))) for times in (self.times, self._known))
        """Time between rows of the slower of the two [s]"""

    def rows(self, least: float, most: float) -> Indices:
        """Indices of the sensor's rows that have a reference at every lag from `least` to `most` [s].

        Raises:
            UsageError: there are fewer than `MIN_ROWS`.
        """
        there = (self.times - most >= self._known[0]) & (self.times - least <= self._known[-1])
        for begin, end in zip(
            self._known[:-1][self._wide], self._known[1:][self._wide], strict=True
        ):
            there &= (self.times - least <= begin) | (self.times - most >= end)
        rows = np.flatnonzero(there)
        if len(rows) < MIN_ROWS:
            lags = f"with lags from {least:.3g} to {most:.3g} s"
            raise UsageError(
                f"angle and reference have {len(rows)} rows in common ({lags}), and {MIN_ROWS} are needed"
            )
        return rows[:: 1 + len(rows) // MAX_ROWS]

    def reference_at(self, rows: Indices, lag: float) -> Floats:
        """Angles of the reference [rad] at rows of the sensor, which is late by `lag` [s]."""
        return np.asarray(self._curve(self.times[rows] - lag))

    def fit(self, rows: Indices, lag: float, offset: float = 0.0) -> tuple[float, float]:
        """Correlation (0 if one is constant), and RMS difference [rad], with lag [s] and offset [rad] removed."""
        sensor = self.values[rows] + offset
        reference = self.reference_at(rows, lag)
        one = sensor - sensor.mean()
        other = reference - reference.mean()
        scale = math.sqrt(float(one @ one) * float(other @ other))
        correlation = float(one @ other) / scale if scale > 0.0 else 0.0
        return correlation, float(np.sqrt(np.mean((sensor - reference) ** 2)))

    def best(self, rows: Indices, within: tuple[float, float]) -> tuple[float, float, float]:
        """Offset [rad], lag [s] and gain of rows of the sensor, at the lag `within` which both correlate best."""
        found = minimize_scalar(
            lambda lag: -self.fit(rows, lag)[0],
            bounds=within,
            method="bounded",
            options={"xatol": 1e-6},
        )
        lag = float(found.x)
        sensor = self.values[rows]
        reference = self.reference_at(rows, lag)
        around = reference - reference.mean()
        gain = float(around @ sensor) / float(around @ around)
        return float(np.mean(reference - sensor)), lag, gain


def aligned(
    sensor: TimeSeries, reference: TimeSeries, longest: float, max_gap: float
) -> Alignment:
    """Align a sensor with a reference; lags from -`longest` to `longest` [s] are tried.

    Raises:
        UsageError: too few rows are in common, the two do not correlate at any lag, or the gain is implausible.
    """
    pair = AnglePair(sensor, reference, max_gap)
    both = f"{sensor.where} and {reference.where}"
    rows = pair.rows(-longest, longest)
    lags = np.linspace(-longest, longest, 1 + 2 * math.ceil(longest / (0.5 * pair.step)))
    correlations = np.array([pair.fit(rows, lag)[0] for lag in lags])
    at = int(correlations.argmax())
    against = -float(correlations.min())
    if correlations[at] < MIN_CORRELATION:
        why = "are both of one knee, in one time?"
        if against >= MIN_CORRELATION:
            why = f"but in opposite directions with {against:.2f}: is a sign turned?"
        raise UsageError(f"{both} correlate with r = {correlations[at]:.2f} at best; {why}")
    if at in (0, len(lags) - 1):
        raise UsageError(
            f"{both} fit best at the longest lag tried, {lags[at]:g} s: see --longest-lag"
        )
    within = float(lags[at - 1]) - 4.0 * pair.step, float(lags[at + 1]) + 4.0 * pair.step
    rows = pair.rows(*within)  # more of them than with the longest lags
    seconds = pair.times[rows[-1]] - pair.times[rows[0]]
    stretches = min(max(round(seconds / STRETCH), MIN_STRETCHES), MAX_STRETCHES)
    whole = pair.best(rows, within)
    number = np.arange(len(rows)) * stretches // len(rows)
    without = np.array(
        [pair.best(rows[number != stretch], within) for stretch in range(stretches)]
    )
    error = np.sqrt(
        (stretches - 1) / stretches * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    )
    half = float(student.ppf(0.975, stretches - 1)) * error
    offset, lag, gain = (
        ValueWithInterval(value, float(each)) for value, each in zip(whole, half, strict=True)
    )
    if not 1.0 / MAX_GAIN <= gain.value <= MAX_GAIN:
        raise UsageError(
            f"{sensor.where} moves {gain.value:.3g} times as far as {reference.where}: are both units right?"
        )
    before = pair.fit(rows, 0.0)
    after = pair.fit(rows, lag.value, offset.value)
    return Alignment(offset, lag, gain, len(rows), before, after)


def overlay(alignment: Alignment, sensor: str, reference: str, angle: AngleChannel) -> str:
    """Text of the parameter file; `sensor` and `reference` name their columns, `angle` is the map's."""
    offset = alignment.offset
    lag = alignment.lag
    degrees = f"{math.degrees(offset.value):.2f} +- {math.degrees(offset.half):.2f}"
    milliseconds = f"{1e3 * lag.value:.1f} +- {1e3 * lag.half:.1f}"
    comments = [
        f"Written by knee-contact align: {sensor} against {reference}",
        f"offset {degrees} deg, lag {milliseconds} ms (95 %); r {alignment.after[0]:.4f}.",
        *_for_node(angle, offset.value),
    ]
    values = (
        "knee:",
        f"  flexion_offset: {offset.value:.6f}",
        "pairing:",
        f"  angle_delay: {lag.value:.6f}",
    )
    return parameter_text(Parameters, comments, values)


def _for_node(angle: AngleChannel, offset: float) -> list[str]:
    """Sentence on a live node, which has the raw sensor, and of the map neither sign, offset [rad] nor scale."""
    factors = [angle.orientation * angle.scale * weight for weight in angle.weights.values()]
    offset += angle.offset * unit_factor(angle.unit, "angle", "map: angle")
    if [*map(abs, factors)] != [1.0]:
        return [
            "The map scales the angle: do not use this file for a live node, which has the raw sensor."
        ]
    if factors == [1.0] and not angle.offset:
        return []
    live = f"knee.flexion_sign: {factors[0]:.1f}, knee.flexion_offset: {offset:.6f}"
    return [
        f"For a live node, which has the raw sensor without the map's sign and offset: {live}."
    ]


def show_alignment(alignment: Alignment, output: Path) -> None:
    """Print the estimates with their intervals, and the correlation and difference before and after."""
    if as_json():
        print_json(**alignment._asdict(), files={"Parameters": output})
        return
    rows = []
    for name, estimate, factor, digits, parameter in (
        ("offset [deg]", alignment.offset, math.degrees(1.0), 2, "knee.flexion_offset [rad]"),
        ("lag [ms]", alignment.lag, 1e3, 1, "pairing.angle_delay [s]"),
        ("gain", alignment.gain, 1.0, 3, "none; angle.scale in the map"),
    ):
        value, low, high = (
            f"{factor * each:.{digits}f}" for each in (estimate.value, *estimate.bounds)
        )
        rows.append((safe_cell(name), value, f"{low} to {high}", safe_cell(parameter)))
    show_table(("", "value", "95 % interval", "parameter"), rows, right=["value"])
    for label, (r, rms) in {"as they are": alignment.before, "aligned": alignment.after}.items():
        say(f"{label}: r {r:.4f}, {math.degrees(rms):.2f} deg RMS")
    say(f"{alignment.rows} rows in common")
    say("")
    say(f"Parameters: {output}")
