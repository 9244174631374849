"""Read trials of an instrumented knee from CSV files: weighted sums of columns, and files joined by their times."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD
from knee_contact_ros.parameters.plausibility import LEAST_PEAK, MOST_PEAK, STIFF
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import read_regular

Floats = NDArray[np.float64]
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
