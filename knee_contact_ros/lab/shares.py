"""`knee-contact fit-share`: from what an instrumented knee measured to a table of medial shares.

Trials are CSV files; forces and flexion are weighted sums of their columns. The force and not the share is fitted, so
that a share counts by the square of the load that it divides. Every trial has the same weight, however long it is, as
its strides are much alike. Differences between neighbours in the table are penalised (P-splines of first order: Eilers
& Marx 1996, Statistical Science 11:89-121), so that a point without data gets the values of its neighbours; and shares
are bounded. The method is linear least squares with bounds.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.optimize import lsq_linear

from knee_contact_ros import __version__
from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.joint_reaction.estimator import LEAST_PEAK, MOST_PEAK, STIFF
from knee_contact_ros.lab.tables import TableFormat, TimeColumn, header_of, read_columns
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.model.types import NANOSECOND, Floats
from knee_contact_ros.parameters.files import SHARE_COLUMNS, read_share_table
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import refuse_existing, write_complete
from knee_contact_ros.system.terminal import WIDTH, say, shown

TERM = re.compile(r"\s*([+-])?\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*\*?\s*)?([^\W\d]\w*|'[^']+'|\"[^\"]+\")\s*")
"""A term of a sum: sign, factor, column, in quotes if it has other signs than letters and digits"""
FEWEST = 20
"""The least number of samples of a trial"""
LEAST_FLEXION = -10.0
"""The least mean flexion [deg] of a trial: no knee is straighter on average"""
LEAST_TOTAL, LARGEST_EXCESS = 50.0, 0.05
"""The least peak [N] of the axial force; and the part of that peak by which a medial force may be above the axial one
or below 0, as load cells have noise"""
SMOOTHING = 1e-3
"""Penalty [BW^2] of a step of 1 between neighbours, relative to the mean square error of the medial force"""
FLEXION = (-10.0, 0.0, 10.0, 20.0, 40.0, 70.0, 100.0, 130.0)
"""Flexion [deg] of the table's rows, as far as there are data: denser where the knee is in stance"""
LOAD = (0.0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.6, 4.2, 4.8)
"""Axial load [body weights] of the table's columns, as far as there are data"""


class Trial(NamedTuple):
    """Measurements of a trial, shape (n,) each."""

    name: str
    """Name of the trial's first file without its suffix"""
    flexion: Floats
    """Flexion angle [rad]"""
    load: Floats
    """Axial force [body weights], positive in compression"""
    medial: Floats
    """Medial force [body weights], positive in compression"""
    body_weight: float
    """Body weight [N]"""


class Wanted(NamedTuple):
    """The columns of a trial's files that are read; forces and flexion may be sums like `0.98 am + 0.97 pm - al`."""

    time: str
    """Time [s], a column of every file"""
    axial: str
    """Axial force [N], positive in compression"""
    medial: str
    """Medial force [N], positive in compression"""
    flexion: str
    """Flexion angle, in radians or degrees"""
    degrees: bool
    """Whether flexion is in degrees"""


def run_fit_share(
    files: Sequence[Sequence[Path]], wanted: Wanted, body_weight: Sequence[float], smoothing: float, source: str,
    output: Path, overwrite: bool,
) -> None:  # fmt: skip
    """Fit a table to trials, write it, and print its errors.

    Args:
        files: Files of each trial.
        wanted: The columns of these files.
        body_weight: Body weight [N] of all trials, or of each.
        smoothing: Penalty, see `SMOOTHING`.
        source: Source of the data, for the comments of the table.
        output: CSV file to write.
        overwrite: Whether to replace it.

    Raises:
        UsageError: a trial, an option or the output cannot be used.
    """
    if not overwrite:
        refuse_existing(output)
    if len(body_weight) not in (1, len(files)):
        raise UsageError(f"--body-weight: {len(body_weight)} for {len(files)} trials; give one, or one for each")
    weights = list(body_weight) * (len(files) // len(body_weight))
    trials = [read_trial(paths, wanted, weight) for paths, weight in zip(files, weights, strict=True)]
    text = _csv(fit(trials, smoothing), trials, source, smoothing)
    rows = errors(trials, smoothing, read_share_table(output.name, text))  # of the table as it is written
    write_complete({output: text.encode()})
    _show(trials, rows)
    say(f"Written: {output}")


def read_trial(paths: Sequence[Path], wanted: Wanted, body_weight: float) -> Trial:
    """Read a trial from one file, or from several that share a clock.

    Columns of all files are identified by their names. The trial has the samples of the first file that are within the
    time of all files; columns of the others are interpolated in time.

    Args:
        paths: The files.
        wanted: The columns.
        body_weight: Body weight [N].

    Raises:
        UsageError: a file cannot be read, a column is missing or twice, times do not increase or do not overlap, or
            values cannot be those of a knee.
    """
    name = paths[0].stem
    sums = {"--axial": wanted.axial, "--medial": wanted.medial, "--flexion": wanted.flexion}
    terms = {option: _terms(option, text) for option, text in sums.items()}
    needed = list(dict.fromkeys(column for each in terms.values() for _, column in each))
    times: list[Any] = []
    found: dict[str, tuple[Floats, Floats]] = {}
    known: list[str] = []
    for path in paths:
        header = header_of(path, [wanted.time, *needed], TableFormat())
        header.place(wanted.time)
        known += header.names
        table = read_columns(
            path, [each for each in needed if header.places(each)], TimeColumn(column=wanted.time), TableFormat()
        )
        times.append(table.stamps * NANOSECOND)
        for place, column in enumerate(table.names):
            if column in found:
                raise UsageError(f"{path}: column {column} is in another file of trial {name}, too")
            if not np.isfinite(table.values[:, place]).all():
                raise UsageError(f"{path}: column {column} of trial {name} has values that are no numbers")
            found[column] = times[-1], table.values[:, place]
    first, last = max(time[0] for time in times), min(time[-1] for time in times)
    kept = times[0][(times[0] >= first) & (times[0] <= last)]
    if len(kept) < FEWEST:
        raise UsageError(
            f"trial {name}: {len(kept)} samples at which all files have some; at least {FEWEST} are needed"
        )
    for option, each in terms.items():
        for _, column in each:
            if column not in found:
                raise UsageError(f"{option}: trial {name} has no column {column}; it has {', '.join(known)}")
    axial, medial, flexion = (
        sum((weight * np.interp(kept, *found[column]) for weight, column in each), np.zeros(len(kept)))
        for each in terms.values()
    )
    flexion = np.radians(flexion) if wanted.degrees else flexion
    hint = "" if wanted.degrees else "; --angle-unit deg, if it is in degrees"
    _refuse_impossible(name, flexion, axial, medial, body_weight, hint)
    return Trial(name, flexion, axial / body_weight, medial / body_weight, body_weight)


def _terms(option: str, text: str) -> list[tuple[float, str]]:
    """Read a weighted sum of columns: weights and names."""
    place, terms = 0, []
    while place < len(text):
        term = TERM.match(text, place)
        if term is None or (place and not term[1]):
            raise UsageError(f"{option} {text!r}: it must be a sum of columns, as '0.98 am + 0.97 pm - al'")
        sign, weight, column = term.groups()
        terms.append(((-1.0 if sign == "-" else 1.0) * float(weight or 1.0), column.strip("'\"")))
        place = term.end()
    if not terms:
        raise UsageError(f"{option}: it must be a sum of columns")
    return terms


def _refuse_impossible(trial: str, flexion: Floats, axial: Floats, medial: Floats, weight: float, unit: str) -> None:
    """Refuse flexion [rad] and forces [N] that cannot be those of a walking knee."""
    mean, span, most = math.degrees(flexion.mean()), math.degrees(np.ptp(flexion)), float(axial.max())
    excess = max(float((medial - axial).max()), float((-medial).max()))
    for wrong, reason in (
        ((reached := np.abs(flexion).max()) > LARGEST_ANGLE, f"flexion reaches {reached:g} rad, beyond "
         f"{LARGEST_ANGLE:g}{unit}"),
        (mean < LEAST_FLEXION, f"flexion is {mean:.0f} degrees on average; it must be positive in flexion: turn the "
         "sign in --flexion"),
        (span < math.degrees(STIFF), f"flexion moves by {span:.3g} degrees in all, which is no knee's that walks: is "
         "--angle-unit right?"),
        (np.abs(axial).max() > LARGEST_LOAD or most < LEAST_TOTAL, f"the axial force reaches {most:g} N; allowed: "
         f"{LEAST_TOTAL:g} to {LARGEST_LOAD:g} N of compression"),
        (not LEAST_PEAK <= most / weight <= MOST_PEAK, f"the axial force reaches {most / weight:.3g} body weights, and "
         f"a knee that bears its body {LEAST_PEAK:g} to {MOST_PEAK:g}: are both in N, and --body-weight no mass?"),
        (excess > LARGEST_EXCESS * most, f"the medial force is {excess:g} N beyond 0 or the whole; look at --axial and "
         "--medial"),
    ):  # fmt: skip
        if wrong:
            raise UsageError(f"trial {trial}: {reason}")


def fit(trials: Sequence[Trial], smoothing: float = SMOOTHING) -> ShareTable:
    """Fit the table to some trials; its places are the standard ones between those nearest to the data's ends.

    Args:
        trials: The trials.
        smoothing: Penalty, see `SMOOTHING`.
    """
    flexion = _within(np.radians(FLEXION), np.concatenate([trial.flexion for trial in trials]))
    load = _within(np.array(LOAD), np.concatenate([trial.load for trial in trials]))
    rows, wanted = [], []
    for trial in trials:
        weight = 1.0 / np.sqrt(len(trial.load) * len(trials))
        along, up = _hats(flexion, trial.flexion), _hats(load, trial.load)
        each = (along[:, :, None] * up[:, None, :]).reshape(len(trial.load), -1)
        rows.append(each * (weight * trial.load)[:, None])
        wanted.append(weight * trial.medial)
    down, across = (np.diff(np.eye(len(places)), axis=0) for places in (flexion, load))
    steps = np.vstack((np.kron(down, np.eye(len(load))), np.kron(np.eye(len(flexion)), across)))
    system = np.vstack((*rows, np.sqrt(smoothing) * steps))
    solution = lsq_linear(system, np.concatenate((*wanted, np.zeros(len(steps)))), (0.0, 1.0), method="bvls")
    return ShareTable(flexion, load, np.clip(solution.x, 0.0, 1.0).reshape(len(flexion), len(load)))


def _within(places: Floats, values: Floats) -> Floats:
    """Select from increasing places those between the ones nearest to the least and the largest value; two at least."""
    nearest = np.abs(values[[values.argmin(), values.argmax()], None] - places).argmin(axis=1)
    first = min(int(nearest[0]), len(places) - 2)
    return places[first : max(int(nearest[1]), first + 1) + 1]


def _hats(places: Floats, values: Floats) -> Floats:
    """Give the weights of places in linear interpolation at values, constant at the ends; shape (values, places)."""
    return np.array([np.interp(values, places, unit) for unit in np.eye(len(places))]).T


def constant(trials: Sequence[Trial]) -> float:
    """Give the constant share that fits the medial forces best, where all trials have the same weight."""
    above = sum(float((trial.medial * trial.load).mean()) for trial in trials)
    return above / sum(float((trial.load**2).mean()) for trial in trials)


class Errors(NamedTuple):
    """RMS errors of the medial force [N] in a trial, by several rules for the share."""

    half: float
    """Error with a share of one half"""
    constant: float
    """Error with the best constant share of the other trials; not a number if there are none"""
    left_out: float
    """Error with the table that is fitted to the other trials; not a number if there are none"""
    fitted: float
    """Error with the table that is fitted to all trials"""


def errors(trials: Sequence[Trial], smoothing: float, table: ShareTable) -> list[Errors]:
    """Compute the errors in every trial, with what is fitted to the other trials, and with the `table` for all."""
    rows = []
    for place, trial in enumerate(trials):
        others = [*trials[:place], *trials[place + 1 :]]
        best, left_out = (constant(others), _shares(fit(others, smoothing), trial)) if others else (np.nan, np.nan)
        shares = (0.5, best, left_out, _shares(table, trial))
        rows.append(Errors(*(_rms(trial, share) for share in shares)))
    return rows


def _shares(table: ShareTable, trial: Trial) -> Any:
    return MeasuredShare(table, 1.0).share(trial.load, trial.flexion)


def _rms(trial: Trial, share: Floats | float) -> float:
    return float(trial.body_weight * np.sqrt(np.mean((share * trial.load - trial.medial) ** 2)))


def _csv(table: ShareTable, trials: Sequence[Trial], source: str, smoothing: float) -> str:
    """Write the table as the text of a CSV file; four digits of a share are a tenth of a newton."""
    names = ", ".join(f"{trial.name} ({len(trial.load)} samples, {trial.body_weight:g} N)" for trial in trials)
    rows = [
        f"{angle:.6f},{load:g},{share:.4f}"
        for angle, shares in zip(table.flexion, table.share, strict=True)
        for load, share in zip(table.load, shares, strict=True)
    ]
    lines = [
        "# Medial share of the axial knee load over flexion [rad] and axial load [BW]; between the points bilinear,",
        "# beyond them as at the edge. For load.compartment: measured_share (load.share_file).",
        *(f"# Source: {line.strip()}" for line in source.splitlines() if line.strip()),
        f"# Fitted by knee-contact fit-share {__version__}, smoothing {smoothing:g}, to {names}.",
        ",".join(SHARE_COLUMNS),
    ]
    return "\n".join([*lines, *rows]) + "\n"


def _show(trials: Sequence[Trial], rows: Sequence[Errors]) -> None:
    """Print the RMS errors of the medial force in every trial, in N and in body weights."""
    console = Console(width=WIDTH, emoji=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title="RMS error of the medial force", title_justify="left")
    table.add_column("trial", overflow="fold")
    for name in ("share of 1/2", "constant of\nthe others", "table of\nthe others", "table of\nall trials"):
        table.add_column(name, justify="right")
    for trial, row in zip(trials, rows, strict=True):
        cells = ["-" if math.isnan(force) else f"{force:.1f} N\n{force / trial.body_weight:.3f} BW" for force in row]
        table.add_row(shown(trial.name), *cells)
    console.print(table)
    if len(trials) == 1:
        console.print("One trial: nothing says how well the table holds on another.", highlight=False)
