"""The work of `knee-contact fit-share`: read trials, fit a table, judge it by leaving trials out, and write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from knee_contact_ros import __version__
from knee_contact_ros.parameters.measured_share import COLUMNS, ShareTable, read_share_table
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name, refuse_existing
from knee_contact_ros.tools.shares.fit import Errors, errors, fit
from knee_contact_ros.tools.shares.trials import Trial, Wanted, read_trial

DIGITS = 4
"""Digits of a share in the file after the decimal point: a tenth of a newton"""
ANGLE_DIGITS = 6
"""Digits of a flexion angle [rad] in the file after the decimal point"""


class FitOptions(NamedTuple):
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


def run_fit_share(options: FitOptions) -> list[Errors]:
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
        ",".join(COLUMNS),
    ]
    return "\n".join([*lines, *rows]) + "\n"
