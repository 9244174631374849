"""`knee-contact fit-share`: from the forces in an instrumented knee to a table of medial shares.

Trials are CSV files; forces and flexion are weighted sums of their columns. The fit minimises the error of the force,
not of the share, so a share counts by the square of its load. Every trial has the same weight, however long it is, as
its strides are similar. Two forms are fitted. The curve a x / sqrt(1 + x^2), x = load / b, rises with the load and
saturates; its constants are the share a at large loads and the load b. The table over flexion and load is bounded
linear least squares with a penalty on differences between neighbours (P-splines of first order: Eilers & Marx 1996,
Statistical Science 11:89-121). Penalty and form are chosen by cross-validation: trials, or quarters of a single trial,
are left out in turn. The curve is written unless the table is clearly better there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, combinations
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from knee_contact_ros import __version__
from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.joint_reaction.estimator import LEAST_PEAK, MOST_PEAK, STIFF
from knee_contact_ros.lab.checks import IN_SECONDS, LARGEST_MOMENT, rate_doubts
from knee_contact_ros.lab.gait_bag import bridged
from knee_contact_ros.lab.tables import (
    Table,
    TableFormat,
    TimeColumn,
    check_unit,
    header_of,
    read_columns,
)
from knee_contact_ros.model.knee import LARGEST_ANGLE
from knee_contact_ros.model.types import Floats, Stamps
from knee_contact_ros.parameters.files import SHARE_COLUMNS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import check_name_free, check_not_input, write_complete
from knee_contact_ros.system.terminal import safe_cell, say, show_table, warn

TERM = re.compile(
    r"\s*([+-])?\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)\s*\*?\s*)?([^\W\d]\w*|'[^']+'|\"[^\"]+\")\s*"
)
"""A term of a sum: sign, factor, column; the column is quoted unless it has only letters, digits and _"""
Term = tuple[float, str]
"""Weight and name of a column"""
FEWEST = 20
"""Smallest number of samples of a trial"""
LONGEST_GAP = 0.1
"""Longest time between rows [s] that is interpolated"""
LEAST_FLEXION = -10.0
"""Smallest mean flexion [deg] of a trial: no knee is more extended on average"""
LARGEST_EXCESS = 0.15
"""Fraction of the axial peak by which a medial force may exceed the axial one or be below 0: load cells have noise, and
one implant's medial side pulled by a tenth in swing"""
SMOOTHINGS = tuple(10.0 ** (0.5 * power) for power in range(-8, 3))
"""Penalties [BW^2] to try, for a step of 1 between neighbours, relative to the mean square error of the force"""
EARNED = 0.95
"""Ratio of the cross-validated RMS errors of table and curve below which the table is written"""
LEAST_LOAD, MOST_LOAD = 0.05, 5.0
"""Range of the load b [body weights]; at its ends the share is constant, or linear in the load"""
QUARTERS = 4
CURVE_FLEXION, CURVE_STEP, CURVE_END = (-0.5, 2.7), 0.1, 6.0
"""Flexion [rad] of a written curve's two rows, and step and last of its loads [body weights]"""
SPACINGS = 0.02, 0.15
"""Plausible spacings [m] of the compartments: 64 to 93 mm in two implants; contacts are about 40 mm apart"""
OUTLIER = 0.1
"""Error of the medial force [body weights] beyond which a sample counts less in the fit of the spacing"""
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
    moment: Floats
    """Frontal moment [m times the body weight], as torque.x of the joint reaction; NaN where it is not known"""
    body_weight: float
    """Body weight [N]"""
    doubts: tuple[str, ...] = ()
    """What is likely a mistake, or was left out, a sentence each"""


def run_fit_share(
    files: Sequence[Sequence[Path]],
    time: str,
    sums: Mapping[str, str],
    degrees: bool,
    body_weight: Sequence[float],
    form: str,
    source: str,
    output: Path,
    overwrite: bool,
) -> None:
    """Fit medial shares to trials, write them as a table, and print the errors.

    Args:
        files: Files of each trial.
        time: Column with the time [s], in every file.
        sums: Sums of columns by option: `--axial` and `--medial` [N], `--flexion`, and if known `--moment` [N m].
        degrees: Whether flexion is in degrees.
        body_weight: Body weight [N] of all trials, or of each.
        form: curve, table, or auto: the one with the smaller cross-validated error.
        source: Source of the data, for the comments of the table.
        output: CSV file to write.
        overwrite: Whether to replace it.

    Raises:
        UsageError: a trial, an option or the output cannot be used.
    """
    check_not_input(output, chain.from_iterable(files))
    if not overwrite:
        check_name_free(output)
    if len(body_weight) not in (1, len(files)):
        raise UsageError(
            f"--body-weight: {len(body_weight)} for {len(files)} trials; give one, or one for each"
        )
    weights = list(body_weight) * (len(files) // len(body_weight))
    terms = {option: _terms(option, text) for option, text in sums.items()}
    trials = [
        read_trial(paths, time, terms, degrees, weight)
        for paths, weight in zip(files, weights, strict=True)
    ]
    for one, other in combinations(trials, 2):
        if np.array_equal(one.load, other.load) and np.array_equal(one.medial, other.medial):
            fault = (
                f"trials {one.name} and {other.name} are the same, and each is left out in turn"
            )
            raise UsageError(f"--trial: {fault}")
    found = chosen(trials, form)
    text = _csv(found, trials, source)
    write_complete({output: text.encode()})
    _show(trials, found)
    say(f"Written: {output}")
    warn(doubt for trial in trials for doubt in trial.doubts)


def read_trial(
    paths: Sequence[Path],
    time: str,
    sums: Mapping[str, Sequence[Term]],
    degrees: bool,
    body_weight: float,
) -> Trial:
    """Read a trial from one file, or from several that share a clock.

    Columns are found by name in all files. The trial has the samples of the first file that all files cover in time;
    columns of the other files are interpolated, except in gaps longer than `LONGEST_GAP`.

    Args:
        paths: The files.
        time: Column with the time [s].
        sums: Weights and names of columns by option, see `run_fit_share`.
        degrees: Whether flexion is in degrees.
        body_weight: Body weight [N].

    Raises:
        UsageError: a file cannot be read, a column is missing or twice, times do not increase or do not overlap, or
            values cannot be those of a knee.
    """
    name = paths[0].stem
    needed = list(dict.fromkeys(column for terms in sums.values() for _, column in terms))
    found: dict[str, tuple[Stamps, Floats]] = {}
    clocks, known, doubts = list[Stamps](), list[str](), list[str]()
    day: int | str | None = None
    for path in paths:
        header = header_of(path, [time, *needed], TableFormat())
        header.place(time)
        known += header.names
        table = read_columns(
            header,
            [each for each in needed if header.places(each)],
            TimeColumn(column=time),
            TableFormat(),
        )
        day = day if clocks else table.day
        if table.day != day:
            raise UsageError(
                f"{path}: trial {name} begins on another day than in {paths[0]}, or has another clock"
            )
        clocks.append(table.stamps)
        doubts += [
            *table.notes,
            *rate_doubts(path, table.stamps, IN_SECONDS),
            *_unit_notes(table, sums, degrees),
        ]
        for column, values in zip(table.names, table.values.T, strict=True):
            if column in found:
                raise UsageError(
                    f"{path}: column {column} is in another file of trial {name}, too"
                )
            if not np.isfinite(values).all():
                raise UsageError(
                    f"{path}: column {column} of trial {name} has values that are not numbers"
                )
            found[column] = clocks[-1], values
    for option, terms in sums.items():
        for _, column in terms:
            if column not in found:
                raise UsageError(
                    f"{option}: trial {name} has no column {column}; it has {', '.join(known)}"
                )
    first, last = max(clock[0] for clock in clocks), min(clock[-1] for clock in clocks)
    kept = clocks[0][(clocks[0] >= first) & (clocks[0] <= last)]
    near = np.all([bridged(kept, clock, LONGEST_GAP) for clock in clocks], axis=0)
    lost = f"trial {name}: {np.count_nonzero(~near)} of {len(kept)} samples left out"
    doubts += [f"{lost}, as they lie in gaps longer than {LONGEST_GAP:g} s"] * (not near.all())
    kept = kept[near]
    if len(kept) < FEWEST:
        fault = f"{len(kept)} samples at which all files have some; at least {FEWEST} are needed"
        raise UsageError(f"trial {name}: {'; '.join([fault, *doubts])}")
    axial, medial, flexion, *moments = (
        sum(
            (weight * np.interp(kept, *found[column]) for weight, column in terms),
            np.zeros(len(kept)),
        )
        for terms in sums.values()
    )
    flexion = np.radians(flexion) if degrees else flexion
    hint = "" if degrees else "; --angle-unit deg, if it is in degrees"
    moment = moments[0] / body_weight if moments else np.full(len(axial), np.nan)
    _refuse_impossible(name, flexion, axial, medial, moment, body_weight, hint)
    moment = np.where(np.abs(moment) <= LARGEST_MOMENT, moment, np.nan)
    told = tuple(dict.fromkeys(doubts))
    return Trial(
        name, flexion, axial / body_weight, medial / body_weight, moment, body_weight, told
    )


def _unit_notes(table: Table, sums: Mapping[str, Sequence[Term]], degrees: bool) -> list[str]:
    """Refuse columns in another unit than that of their sum; return notes on units that are not known."""
    units, notes = {"--flexion": "deg" if degrees else "rad", "--moment": "N*m"}, list[str]()
    for option, terms in sums.items():
        unit, times = units.get(option, "N"), max(abs(weight) for weight, _ in terms) or 1.0
        for _, column in terms:
            said = table.units.get(column, "")
            notes += check_unit(
                table.path, column, said, unit, f"{option} must be in", times=times, cure=""
            )
    return notes


def _terms(option: str, text: str) -> list[Term]:
    """Read a weighted sum of columns: weights and names."""
    place, terms = 0, []
    while place < len(text):
        term = TERM.match(text, place)
        if term is None or (place and not term[1]):
            raise UsageError(
                f"{option} {text!r}: it must be a sum of columns, for example '0.98 am + 0.97 pm - al'"
            )
        sign, weight, column = term.groups()
        terms.append(((-1.0 if sign == "-" else 1.0) * float(weight or 1.0), column.strip("'\"")))
        place = term.end()
    if not terms:
        raise UsageError(f"{option}: it must be a sum of columns")
    return terms


def _refuse_impossible(
    trial: str,
    flexion: Floats,
    axial: Floats,
    medial: Floats,
    moment: Floats,
    weight: float,
    unit: str,
) -> None:
    """Refuse flexion [rad], forces [N] and moments [m times the body weight] that no walking knee has."""
    mean, span, most = (
        math.degrees(flexion.mean()),
        math.degrees(np.ptp(flexion)),
        float(axial.max()),
    )
    excess = max(float((medial - axial).max()), float((-medial).max()))
    for wrong, reason in (
        (
            (reached := np.abs(flexion).max()) > LARGEST_ANGLE,
            f"flexion reaches {reached:g} rad, beyond {LARGEST_ANGLE:g}{unit}",
        ),
        (
            mean < LEAST_FLEXION,
            f"flexion is {mean:.0f} degrees on average; it must be positive in flexion: change the "
            "sign in --flexion",
        ),
        (
            span < math.degrees(STIFF),
            f"flexion moves by {span:.3g} degrees in all, less than a walking knee: is "
            "--angle-unit right?",
        ),
        (
            not LEAST_PEAK <= most / weight <= MOST_PEAK,
            f"the axial force reaches {most / weight:.3g} body weights, and "
            f"a knee that bears its body {LEAST_PEAK:g} to {MOST_PEAK:g}: are both in N, and is --body-weight a force "
            "and not a mass?",
        ),
        (
            excess > LARGEST_EXCESS * most,
            f"the medial force is {excess:g} N beyond 0 or the whole; look at --axial and "
            "--medial",
        ),
        (not moment.any(), "--moment is 0 throughout"),
        (
            (above := float(np.mean(np.abs(moment) > LARGEST_MOMENT))) > 0.5,
            f"--moment exceeds {LARGEST_MOMENT:g} m "
            f"times the body weight in {above:.0%} of the samples: is it in N m?",
        ),
    ):
        if wrong:
            raise UsageError(f"trial {trial}: {reason}")


def fit_table(trials: Sequence[Trial], smoothing: float) -> ShareTable:
    """Fit the table to some trials; its rows and columns are the standard ones that the data cover.

    Args:
        trials: The trials.
        smoothing: Penalty, see `SMOOTHINGS`.
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
    solution = lsq_linear(
        system, np.concatenate((*wanted, np.zeros(len(steps)))), (0.0, 1.0), method="bvls"
    )
    return ShareTable(
        flexion, load, np.clip(solution.x, 0.0, 1.0).reshape(len(flexion), len(load))
    )


def _within(places: Floats, values: Floats) -> Floats:
    """Select increasing places from the one nearest the smallest value to the one nearest the largest; two at least."""
    nearest = np.abs(values[[values.argmin(), values.argmax()], None] - places).argmin(axis=1)
    first = min(int(nearest[0]), len(places) - 2)
    return places[first : max(int(nearest[1]), first + 1) + 1]


def _hats(places: Floats, values: Floats) -> Floats:
    """Return weights of linear interpolation between places, constant beyond them; shape (values, places)."""
    return np.array([np.interp(values, places, unit) for unit in np.eye(len(places))]).T


class Curve(NamedTuple):
    """A share that rises with the load and saturates."""

    share: float
    """Medial share of a large load"""
    load: float
    """Load [body weights] at which the share is 0.71 times `share`"""

    def at(self, load: Floats) -> Floats:
        """Return the shares at loads [body weights]."""
        ratio = np.maximum(load, 0.0) / self.load
        return np.asarray(self.share * ratio / np.sqrt(1.0 + ratio * ratio))

    @property
    def table(self) -> ShareTable:
        """The curve as a table that is constant along flexion."""
        load = np.round(np.arange(0.0, CURVE_END + 0.5 * CURVE_STEP, CURVE_STEP), 3)
        return ShareTable(np.array(CURVE_FLEXION), load, np.stack([self.at(load)] * 2))


def fit_curve(trials: Sequence[Trial], weights: Sequence[float] | None = None) -> Curve:
    """Fit the curve to some trials with `weights`, or with one weight each."""
    parts = np.sqrt(np.ones(len(trials)) if weights is None else np.asarray(weights))

    def misfit(constants: Floats) -> Floats:
        curve = Curve(*constants)
        each = [
            part / np.sqrt(len(trial.load)) * (curve.at(trial.load) * trial.load - trial.medial)
            for part, trial in zip(parts, trials, strict=True)
        ]
        return np.concatenate(each)

    found = least_squares(misfit, (0.6, 0.5), bounds=((0.0, LEAST_LOAD), (1.0, MOST_LOAD)))
    return Curve(*found.x.tolist())


def constant(trials: Sequence[Trial]) -> float:
    """Return the constant share that fits the medial forces best; all trials have the same weight."""
    above = sum(float((trial.medial * trial.load).mean()) for trial in trials)
    return above / sum(float((trial.load**2).mean()) for trial in trials)


def spacing(trials: Sequence[Trial]) -> float:
    """Return the distance [m] between the compartments that fits the frontal moments best; NaN if none are known.

    The medial force is half of the load less the moment over the spacing. Spikes of moments, where feet change plates,
    count little (a loss that is linear beyond `OUTLIER`).
    """
    known = [np.isfinite(trial.moment) for trial in trials]
    counts = [int(seen.sum()) for seen in known]
    if not all(counts):
        return math.nan
    mean = sum(counts) / len(counts)

    def misfit(inverse: Floats) -> Floats:
        each = [
            (0.5 * trial.load - trial.moment * inverse - trial.medial)[seen]
            * math.sqrt(mean / count)
            for trial, seen, count in zip(trials, known, counts, strict=True)
        ]
        return np.concatenate(each)

    found = least_squares(misfit, 15.0, loss="soft_l1", f_scale=OUTLIER)
    return 1.0 / float(found.x[0])


class Found(NamedTuple):
    """Result of a fit."""

    table: ShareTable
    """Shares that are written"""
    curve: Curve | None
    """The curve that the shares follow; None: they are a fitted table"""
    smoothing: float
    """Penalty of the table"""
    errors: dict[str, list[float]]
    """RMS error of the medial force [body weights] in every trial, by the rule for the share. Fitted rules are
    cross-validated: the fit saw the other trials, or the rest of a single one"""
    spacing: float
    """Distance between the compartments [m] for moment_balance; NaN if no moment is known"""

    @property
    def form(self) -> str:
        """What is written, in words."""
        if self.curve:
            return f"the curve {self.curve.share:.3f} x / sqrt(1 + x^2), x = load / {self.curve.load:.3f} BW"
        return f"a table, smoothing {self.smoothing:.3g}"


def chosen(trials: Sequence[Trial], form: str) -> Found:
    """Fit curve and table, and choose by their cross-validated errors; see `run_fit_share`."""
    parts = list(trials)
    if len(trials) == 1:
        quarters = (np.array_split(column, QUARTERS) for column in trials[0][1:5])
        parts = [
            trials[0]._replace(flexion=flexion, load=load, medial=medial, moment=moment)
            for flexion, load, medial, moment in zip(*quarters, strict=True)
        ]

    def missed(share: Callable[[Sequence[Trial], Trial], Any]) -> list[float]:
        """RMS errors of the medial force in every part, with shares fitted to the others."""
        errors = []
        for place, part in enumerate(parts):
            found = share([*parts[:place], *parts[place + 1 :]], part)
            errors.append(float(np.sqrt(np.nanmean((found * part.load - part.medial) ** 2))))
        return errors if len(trials) > 1 else [math.sqrt(fmean(error**2 for error in errors))]

    def tabled(penalty: float) -> list[float]:
        return missed(
            lambda known, part: MeasuredShare(fit_table(known, penalty), 1.0).share(
                part.load, part.flexion
            )
        )

    errors = {
        "share of 1/2": missed(lambda _, __: 0.5),
        "constant": missed(lambda known, _: constant(known)),
        "curve": missed(lambda known, part: fit_curve(known).at(part.load)),
    }
    tried = {penalty: tabled(penalty) for penalty in SMOOTHINGS}
    best = min(tried, key=lambda penalty: float(np.mean(np.square(tried[penalty]))))
    errors["table"] = tried[best]
    if not any(np.isnan(trial.moment).all() for trial in trials):
        errors["moment\nbalance"] = missed(
            lambda known, part: 0.5 - part.moment / (spacing(known) * np.maximum(part.load, 1e-9))
        )
    earned = np.mean(np.square(errors["table"])) < EARNED**2 * np.mean(np.square(errors["curve"]))
    if form == "table" or (form == "auto" and earned):
        return Found(fit_table(trials, best), None, best, errors, spacing(trials))
    curve = fit_curve(trials)
    return Found(curve.table, curve, best, errors, spacing(trials))


def _csv(found: Found, trials: Sequence[Trial], source: str) -> str:
    """Write the table as the text of a CSV file; four digits of a share are a tenth of a newton."""
    names = ", ".join(
        f"{trial.name} ({len(trial.load)} samples, {trial.body_weight:g} N)" for trial in trials
    )
    written = "curve" if found.curve else "table"
    missed = ", ".join(f"{error:.3f}" for error in found.errors[written])
    left_out = "the trial was left out" if len(trials) > 1 else "quarters of it were left out"
    notes = [
        f"Fitted by knee-contact fit-share {__version__} to {names}: {found.form}.",
        f"RMS error of the medial force where {left_out} [BW]: {missed}.",
    ]
    if not math.isnan(found.spacing):
        notes.append(f"Its frontal moments fit load.compartment_spacing {found.spacing:.4f} m.")
    return share_csv(
        found.table,
        [*(f"Source: {line.strip()}" for line in source.splitlines() if line.strip()), *notes],
    )


def share_csv(table: ShareTable, notes: Sequence[str]) -> str:
    """Text of a CSV file with a table, and `notes` as comments."""
    rows = [
        f"{angle:.6f},{load:g},{share:.4f}"
        for angle, shares in zip(table.flexion, table.share, strict=True)
        for load, share in zip(table.load, shares, strict=True)
    ]
    lines = [
        "# Medial share of the axial knee load over flexion [rad] and axial load [BW]; between the points bilinear,",
        "# beyond them as at the edge. For load.compartment: measured_share (load.share_file).",
        *(f"# {note}" for note in notes),
        ",".join(SHARE_COLUMNS),
    ]
    return "\n".join([*lines, *rows]) + "\n"


def _show(trials: Sequence[Trial], found: Found) -> None:
    """Print the RMS errors of the medial force in every trial, in N and in body weights, and what was chosen."""
    fitted_to = "the others" if len(trials) > 1 else "other quarters"
    title = f"RMS error of the medial force; fitted rules were fitted to {fitted_to}"
    rows = []
    for place, trial in enumerate(trials):
        errors = [each[place] for each in found.errors.values()]
        rows.append(
            [
                safe_cell(trial.name),
                *(f"{error * trial.body_weight:.1f} N\n{error:.3f} BW" for error in errors),
            ]
        )
    show_table(
        ["trial", *found.errors], rows, right=found.errors, title=title, title_justify="left"
    )
    say(f"Fitted to all: {found.form}")
    if not math.isnan(found.spacing):
        say(f"For moment_balance: load.compartment_spacing: {found.spacing:.4f}")
        if not SPACINGS[0] <= found.spacing <= SPACINGS[1]:
            hint = "look at the sign and the unit of --moment, which is torque.x of the joint reaction"
            warn([f"a spacing of {found.spacing:.3g} m fits no knee: {hint}"])
