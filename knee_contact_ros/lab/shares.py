"""Read trials of an instrumented knee from CSV files: weighted sums of columns, and files joined by their times.

Fit the table of medial shares that leaves the smallest errors of the medial force [N], with smoothing.

The force and not the share is fitted, so that a share counts by the square of the load that it divides. Every trial has
the same weight, however long it is, as its strides are much alike. Differences between neighbours in the table are
penalised (P-splines of first order: Eilers & Marx 1996, Statistical Science 11:89-121), so that a point without data
gets the values of its neighbours; and shares are bounded. The method is linear least squares with bounds.

The work of `knee-contact fit-share`: read trials, fit a table, judge it by leaving trials out, and write it.

The table that `fit-share` prints.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from scipy.optimize import lsq_linear

from knee_contact_ros import __version__
from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.joint_reaction.estimator import LEAST_PEAK, MOST_PEAK, STIFF
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.model.types import Floats
from knee_contact_ros.parameters.files import SHARE_COLUMNS, read_share_table
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_regular
from knee_contact_ros.system.output_files import partial_name, refuse_existing
from knee_contact_ros.system.terminal import WIDTH, say, shown

LARGEST_FILE = 2**28
"""Largest size [B] of a file"""
TERM = re.compile(r"\s*([+-])?\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*\*?\s*)?([A-Za-z_]\w*)\s*")
"""A term of a sum: sign, factor, column"""
FEWEST = 20
"""The least number of samples of a trial"""
LEAST_FLEXION = -math.radians(10.0)
"""The least mean flexion [rad] of a trial: no knee is straighter on average"""
LEAST_TOTAL, LARGEST_EXCESS = 50.0, 0.05
"""The least peak [N] of the axial force; and the part of that peak by which a medial force may be above the axial one
or below 0, as load cells have noise"""


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
    files = [_columns(path) for path in paths]
    name = paths[0].stem
    times = [_column(file, wanted.time, path) for file, path in zip(files, paths, strict=True)]
    for time, path in zip(times, paths, strict=True):
        if not (np.diff(time) > 0.0).all():
            raise UsageError(f"{path}: column {wanted.time} does not grow")
    first, last = max(time[0] for time in times), min(time[-1] for time in times)
    kept = times[0][(times[0] >= first) & (times[0] <= last)]
    if len(kept) < FEWEST:
        raise UsageError(
            f"trial {name}: {len(kept)} samples at which all files have some; at least {FEWEST} are needed"
        )
    known: dict[str, Floats] = {}
    for file, time, path in zip(files, times, paths, strict=True):
        for column, values in file.items():
            if column != wanted.time and column in known:
                raise UsageError(f"{path}: column {column} is in another file of trial {name}, too")
            known[column] = np.interp(kept, time, values)
    axial, medial, flexion = (
        _sum(option, text, known, name)
        for option, text in (("--axial", wanted.axial), ("--medial", wanted.medial), ("--flexion", wanted.flexion))
    )
    return _checked(
        Trial(name, np.radians(flexion) if wanted.degrees else flexion, axial, medial, body_weight), wanted.degrees
    )


def _checked(trial: Trial, degrees: bool) -> Trial:
    """Check a trial whose forces are still in N, and turn them into body weights; refuse values that no knee has."""
    reached = np.abs(trial.flexion).max()
    if reached > LARGEST_ANGLE:
        hint = "" if degrees else "; --angle-unit deg, if it is in degrees"
        raise UsageError(f"trial {trial.name}: flexion reaches {reached:g} rad, beyond {LARGEST_ANGLE:g}{hint}")
    if trial.flexion.mean() < LEAST_FLEXION:
        raise UsageError(
            f"trial {trial.name}: flexion is {math.degrees(trial.flexion.mean()):.0f} degrees on average; it must be "
            "positive in flexion: turn the sign in --flexion"
        )
    span = math.degrees(np.ptp(trial.flexion))
    if span < math.degrees(STIFF):
        raise UsageError(
            f"trial {trial.name}: flexion moves by {span:.3g} degrees in all, which is no knee's that walks: is "
            "--angle-unit right?"
        )
    total, most = trial.load, float(np.abs(trial.load).max())
    if most > LARGEST_LOAD or total.max() < LEAST_TOTAL:
        raise UsageError(
            f"trial {trial.name}: the axial force reaches {total.max():g} N; allowed: {LEAST_TOTAL:g} to "
            f"{LARGEST_LOAD:g} N of compression"
        )
    peak = float(total.max()) / trial.body_weight
    if not LEAST_PEAK <= peak <= MOST_PEAK:
        raise UsageError(
            f"trial {trial.name}: the axial force reaches {peak:.3g} body weights, and a knee that bears its body "
            f"{LEAST_PEAK:g} to {MOST_PEAK:g}: are both in N, and --body-weight no mass?"
        )
    excess = max(float((trial.medial - total).max()), float((-trial.medial).max()))
    if excess > LARGEST_EXCESS * total.max():
        raise UsageError(
            f"trial {trial.name}: the medial force is {excess:g} N beyond 0 or the whole; look at --axial and --medial"
        )
    return trial._replace(load=total / trial.body_weight, medial=trial.medial / trial.body_weight)


def _columns(path: Path) -> dict[str, Floats]:
    """Read the columns of a CSV file, by name."""
    try:
        text = read_regular(path, LARGEST_FILE).decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"cannot read {path}: it is not a text file in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    names = [entry.strip() for entry in lines[0].split(",")] if lines else []
    values = np.empty((max(len(lines) - 1, 0), len(names)))
    for number, line in enumerate(lines[1:]):
        try:
            values[number] = [float(entry) for entry in line.split(",")]
        except ValueError:
            raise UsageError(f"{path}: row {number + 1} does not hold {len(names)} numbers: {line[:60]}") from None
    if not len(values):
        raise UsageError(f"{path}: it must hold a line of column names, and rows of numbers")
    return {name: values[:, place] for place, name in enumerate(names)}


def _column(file: dict[str, Floats], name: str, path: Path) -> Floats:
    if name not in file:
        raise UsageError(f"{path} has no column {name}; it has {', '.join(file)}")
    if not np.isfinite(file[name]).all():
        raise UsageError(f"{path}: column {name} has values that are no numbers")
    return file[name]


def _sum(option: str, text: str, known: dict[str, Floats], trial: str) -> Floats:
    """Compute a weighted sum of columns."""
    place, total = 0, np.zeros(len(next(iter(known.values()))))
    while place < len(text):
        term = TERM.match(text, place)
        if term is None or (place and not term[1]):
            raise UsageError(f"{option} {text!r}: it must be a sum of columns, as '0.98 am + 0.97 pm - al'")
        sign, factor, column = term.groups()
        if column not in known:
            raise UsageError(f"{option}: trial {trial} has no column {column}; it has {', '.join(known)}")
        if not np.isfinite(known[column]).all():
            raise UsageError(f"{option}: column {column} of trial {trial} has values that are no numbers")
        total += (-1.0 if sign == "-" else 1.0) * float(factor or 1.0) * known[column]
        place = term.end()
    if not place:
        raise UsageError(f"{option}: it must be a sum of columns")
    return total


SMOOTHING = 1e-3
"""Penalty [BW^2] of a step of 1 between neighbours, relative to the mean square error of the medial force"""
FLEXION = (-10.0, 0.0, 10.0, 20.0, 40.0, 70.0, 100.0, 130.0)
"""Flexion [deg] of the table's rows, as far as there are data: denser where the knee is in stance"""
LOAD = (0.0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.6, 4.2, 4.8)
"""Axial load [body weights] of the table's columns, as far as there are data"""


class Errors(NamedTuple):
    """RMS errors of the medial force [N] in a trial, by several rules for the share."""

    trial: str
    """Name of the trial"""
    samples: int
    """Number of samples"""
    body_weight: float
    """Body weight [N]"""
    half: float
    """Error with a share of one half"""
    constant: float
    """Error with the best constant share of the other trials; not a number if there are none"""
    left_out: float
    """Error with the table that is fitted to the other trials; not a number if there are none"""
    fitted: float
    """Error with the table that is fitted to all trials"""


def grid(trials: Sequence[Trial]) -> tuple[Floats, Floats]:
    """Give flexion [rad] and load [BW] of the table: the standard points between those nearest to the data's ends."""
    flexion = np.concatenate([trial.flexion for trial in trials])
    load = np.concatenate([trial.load for trial in trials])
    return _within(np.radians(FLEXION), flexion), _within(np.array(LOAD), load)


def _within(places: Floats, values: Floats) -> Floats:
    """Select from increasing places those between the ones nearest to the least and the largest value; two at least."""
    nearest = np.abs(values[[values.argmin(), values.argmax()], None] - places).argmin(axis=1)
    first = min(int(nearest[0]), len(places) - 2)
    return places[first : max(int(nearest[1]), first + 1) + 1]


def fit(
    trials: Sequence[Trial], smoothing: float = SMOOTHING, places: tuple[Floats, Floats] | None = None
) -> ShareTable:
    """Fit the table to some trials.

    Args:
        trials: The trials.
        smoothing: Penalty, see `SMOOTHING`.
        places: Flexion [rad] and load [BW] of the table; None: see `grid`.
    """
    flexion, load = places or grid(trials)
    rows, wanted = [], []
    for trial in trials:
        weight = 1.0 / np.sqrt(len(trial.load) * len(trials))
        along, up = _hats(flexion, trial.flexion), _hats(load, trial.load)
        each = (along[:, :, None] * up[:, None, :]).reshape(len(trial.load), -1)
        rows.append(each * (weight * trial.load)[:, None])
        wanted.append(weight * trial.medial)
    steps = np.sqrt(smoothing) * _steps(len(flexion), len(load))
    system, right = np.vstack((*rows, steps)), np.concatenate((*wanted, np.zeros(len(steps))))
    solution = lsq_linear(system, right, (0.0, 1.0), method="bvls")
    return ShareTable(flexion, load, np.clip(solution.x, 0.0, 1.0).reshape(len(flexion), len(load)))


def _hats(places: Floats, values: Floats) -> Floats:
    """Give the weights of places in linear interpolation at values, constant at the ends; shape (values, places)."""
    return np.array([np.interp(values, places, unit) for unit in np.eye(len(places))]).T


def _steps(rows: int, columns: int) -> Floats:
    """Give the matrix that turns the values of a table into the differences between neighbours."""
    down, across = (np.diff(np.eye(number), axis=0) for number in (rows, columns))
    return np.vstack((np.kron(down, np.eye(columns)), np.kron(np.eye(rows), across)))


def constant(trials: Sequence[Trial]) -> float:
    """Give the constant share that fits the medial forces best, where all trials have the same weight."""
    above = sum(float((trial.medial * trial.load).mean()) for trial in trials)
    return above / sum(float((trial.load**2).mean()) for trial in trials)


def error(trial: Trial, table: ShareTable) -> float:
    """Compute the RMS error [N] of the medial force in a trial with a table."""
    share = MeasuredShare(table, 1.0).share(trial.load, trial.flexion)
    return _rms(trial, share)


def errors(trials: Sequence[Trial], smoothing: float, table: ShareTable) -> list[Errors]:
    """Compute the errors in every trial, with what is fitted to the other trials, and with the `table` for all."""
    rows = []
    for place, trial in enumerate(trials):
        others = [*trials[:place], *trials[place + 1 :]]
        best = _rms(trial, constant(others)) if others else np.nan
        left_out = error(trial, fit(others, smoothing)) if others else np.nan
        half, fitted = _rms(trial, 0.5), error(trial, table)
        rows.append(Errors(trial.name, len(trial.load), trial.body_weight, half, best, left_out, fitted))
    return rows


def _rms(trial: Trial, share: Floats | float) -> float:
    return float(trial.body_weight * np.sqrt(np.mean((share * trial.load - trial.medial) ** 2)))


DIGITS = 4
"""Digits of a share in the file after the decimal point: a tenth of a newton"""
ANGLE_DIGITS = 6
"""Digits of a flexion angle [rad] in the file after the decimal point"""


class ShareOptions(NamedTuple):
    """Options of the command."""

    trials: Sequence[Sequence[Path]]
    """Files of each trial"""
    wanted: Wanted
    body_weight: Sequence[float]
    """Body weight [N] of all trials, or of each"""
    smoothing: float
    """Penalty, see `fit.SMOOTHING`"""
    source: str
    """Source of the data, for the comments of the file"""
    output: Path
    overwrite: bool = False


def run_fit_share(options: ShareOptions) -> list[Errors]:
    """Fit a table to trials, write it, and return its errors.

    Raises:
        UsageError: a trial, an option or the output cannot be used.
    """
    output, smoothing = options.output, options.smoothing
    if not options.overwrite:
        refuse_existing(output)
    weights = list(options.body_weight)
    if len(weights) not in (1, len(options.trials)):
        raise UsageError(f"--body-weight: {len(weights)} for {len(options.trials)} trials; give one, or one for each")
    weights *= len(options.trials) // len(weights)
    trials = [read_trial(paths, options.wanted, weight) for paths, weight in zip(options.trials, weights, strict=True)]
    text = csv(fit(trials, smoothing), trials, options.source, smoothing)
    rows = errors(trials, smoothing, read_share_table(output.name, text))  # of the table as it is written
    try:
        partial_name(output).write_text(text, encoding="utf-8")
        partial_name(output).replace(output)
    except OSError as problem:
        raise UsageError(f"cannot write {output}: {problem.strerror}") from None
    return rows


def csv(table: ShareTable, trials: Sequence[Trial], source: str, smoothing: float) -> str:
    """Write the table as the text of a CSV file."""
    names = ", ".join(f"{trial.name} ({len(trial.load)} samples, {trial.body_weight:g} N)" for trial in trials)
    rows = [
        f"{angle:.{ANGLE_DIGITS}f},{load:g},{share:.{DIGITS}f}"
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


def show_errors(errors: Sequence[Errors], output: Path) -> None:
    """Print the RMS errors of the medial force in every trial, and the output file."""
    console = Console(width=WIDTH, emoji=False)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, title="RMS error of the medial force", title_justify="left")
    table.add_column("trial", overflow="fold")
    for name in ("share of 1/2", "constant of\nthe others", "table of\nthe others", "table of\nall trials"):
        table.add_column(name, justify="right")
    for trial in errors:
        values = (trial.half, trial.constant, trial.left_out, trial.fitted)
        table.add_row(shown(trial.trial), *(_both(value, trial.body_weight) for value in values))
    console.print(table)
    if len(errors) == 1:
        console.print("One trial: nothing says how well the table holds on another.", highlight=False)
    say(f"Written: {output}")


def _both(force: float, body_weight: float) -> str:
    """Return a force [N] as text in N and in body weights; a dash for NaN."""
    return "-" if math.isnan(force) else f"{force:.1f} N\n{force / body_weight:.3f} BW"
