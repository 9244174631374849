"""The work of `knee-contact fit-share`: read trials, fit, judge by leaving trials out, write."""

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
"""Behind the point, of a share in the file: a tenth of a newton"""
ANGLE_DIGITS = 6


class FitOptions(NamedTuple):
    """What the command line says."""

    trials: Sequence[Sequence[Path]]
    wanted: Wanted
    body_weight: Sequence[float]
    """[N] of all trials, or of each"""
    smoothing: float
    source: str
    output: Path
    overwrite: bool = False


def run_fit_share(asked: FitOptions) -> list[Errors]:
    """Fit a table to trials and write it; give the errors.

    Raises:
        UsageError: a trial, an option or the output cannot be used.
    """
    if not asked.overwrite:
        refuse_existing(asked.output)
    weights = list(asked.body_weight)
    if len(weights) not in (1, len(asked.trials)):
        raise UsageError(f"--body-weight: {len(weights)} for {len(asked.trials)} trials; give one, or one for each")
    weights *= len(asked.trials) // len(weights)
    trials = [read_trial(paths, asked.wanted, weight) for paths, weight in zip(asked.trials, weights, strict=True)]
    text = csv(fit(trials, asked.smoothing), trials, asked.source, asked.smoothing)
    table = read_share_table(asked.output.name, text)  # as it is written
    found = errors(trials, asked.smoothing, table)
    try:
        partial_name(asked.output).write_text(text, encoding="utf-8")
        partial_name(asked.output).replace(asked.output)
    except OSError as problem:
        raise UsageError(f"cannot write {asked.output}: {problem.strerror}") from None
    return found


def csv(table: ShareTable, trials: Sequence[Trial], source: str, smoothing: float) -> str:
    """The file's text."""
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
