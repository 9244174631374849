"""The work of `knee-contact calibrate`: a table → a parameter file with what was fitted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros import __version__
from knee_contact_ros.parameters.reading import values_set_in
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name, refuse_existing, refuse_impossible, write_new
from knee_contact_ros.tools.calibration.in_memory import Calibration, calibrated
from knee_contact_ros.tools.calibration.measured import ANSWERS


class CalibrateOptions(NamedTuple):
    """What the command line says."""

    table: Path
    params: Sequence[Path]
    values: Mapping[str, Any]
    free: Sequence[str]
    sigma: Sequence[str]
    """As penetration_depth=1e-6"""
    loss: str
    level: float
    with_intervals: bool
    starts: int
    output: Path
    overwrite: bool = False


def run_calibrate(asked: CalibrateOptions) -> Calibration:
    """Fit, and write the parameter file.

    Raises:
        UsageError: table, parameters, an option or the output cannot be used. Nothing is written then.
    """
    refuse_impossible(asked.output)
    if not asked.overwrite:
        refuse_existing(asked.output)
    found = calibrated(
        asked.table, list(asked.params), asked.free, asked.values, sigma=_sigma(asked.sigma), loss=asked.loss,
        level=asked.level, with_intervals=asked.with_intervals, starts=asked.starts,
    )  # fmt: skip
    partial = partial_name(asked.output)
    try:
        write_new(partial, parameter_file(found, asked).encode())
        partial.replace(asked.output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UsageError(f"cannot write {asked.output}: {error.strerror}") from None
    values_set_in(asked.output)
    return found


def parameter_file(found: Calibration, asked: CalibrateOptions) -> str:
    """The file's text: the fitted values alone, and in comments how they were made."""
    files = ", ".join(path.name for path in asked.params)
    others = "".join(f", {name} {value}" for name, value in asked.values.items())
    noise = [f"{name} {found.rms[name]:.4g} {ANSWERS[name]}" for name in found.rms]
    said = [
        f"Written by knee-contact calibrate {__version__}, loss {found.loss}; all other parameters: {files}{others}.",
        f"Data: {asked.table.name}, sha256 {found.measured.digest}.",
        f"RMS of what is left: {', '.join(noise)}.",
        *(f"{name}: {interval_text(found, name)}." for name in found.intervals),
        *(f"Warning: {warning}." for warning in found.warnings),
    ]
    lines = [f"# {' '.join(line.split())}" for line in said]
    lines += ["/**/knee_contact:", "  ros__parameters:"]
    sections: dict[str, list[str]] = {}
    for name, value in found.to_parameters().items():
        section, inner = name.split(".")
        sections.setdefault(section, []).append(f"      {inner}: {value:.9e}")
    for section, entries in sections.items():
        lines += [f"    {section}:", *entries]
    return "\n".join(lines) + "\n"


def interval_text(found: Calibration, name: str) -> str:
    """An interval in words."""
    low, high, low_open, high_open = found.intervals[name]
    below = "not bounded below" if low_open else f"{low:.6g}"
    above = "not bounded above" if high_open else f"{high:.6g}"
    between = f"{below} to {above}" if not (low_open or high_open) else f"{below}, {above}"
    return f"{100.0 * found.level:g} % interval {between}"


def _sigma(given: Sequence[str]) -> dict[str, float]:
    """Standard deviations by column."""
    found = {}
    for each in given:
        name, _, told = each.partition("=")
        try:
            found[name] = float(told)
        except ValueError:
            found[name] = math.nan
        if not 0.0 < found[name] < math.inf:
            raise UsageError(f"--sigma {each}: it must be COLUMN=NUMBER, the number > 0, as penetration_depth=1e-6")
    return found
