"""The work of `knee-contact calibrate`: fit parameters to a table or a bag, and write them into a parameter file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros import __version__
from knee_contact_ros.parameters.declared import NodeReading
from knee_contact_ros.parameters.load_schema import LOAD_READING
from knee_contact_ros.parameters.reading import READING
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import partial_name, refuse_existing, refuse_impossible, write_new
from knee_contact_ros.tools.calibration.in_memory import Calibration, FitOptions, calibrated, is_bag
from knee_contact_ros.tools.calibration.measured import ANSWERS
from knee_contact_ros.tools.calibration.reference import AXIAL_FORCE
from knee_contact_ros.tools.calibration.unknowns import nested

UNITS = ANSWERS | {AXIAL_FORCE: "N"}
"""Units of all columns that can be measured"""


class CalibrateOptions(NamedTuple):
    """Options of the command."""

    data: Path
    """The table or the bag"""
    params: Sequence[Path]
    """Parameter files; none: the healthy knee, or for a bag the load node's defaults"""
    values: Mapping[str, Any]
    """Values of single parameters, by name"""
    free: Sequence[str]
    """Names of the free parameters, also with ranges, as contact.damping=1000:20000"""
    sigma: Sequence[str]
    """Standard deviations of columns, as penetration_depth=1e-6"""
    loss: str
    level: float
    with_intervals: bool
    starts: int
    output: Path
    overwrite: bool = False
    remaps: Sequence[str] = ()
    """Other names of a bag's topics, as joint_reaction_force:=/implant/force"""
    namespace: str = ""
    """Namespace of a bag's topics"""


def run_calibrate(options: CalibrateOptions) -> Calibration:
    """Fit, and write the parameter file.

    Raises:
        UsageError: data, parameters, an option or the output cannot be used. Nothing is written then.
    """
    refuse_impossible(options.output)
    if not options.overwrite:
        refuse_existing(options.output)
    fit_options = FitOptions(
        _sigma(options.sigma), options.loss, options.level, options.with_intervals, options.starts, options.remaps,
        options.namespace,
    )  # fmt: skip
    calibration = calibrated(options.data, list(options.params), options.free, options.values, fit_options)
    partial = partial_name(options.output)
    try:
        write_new(partial, parameter_file(calibration, options).encode())
        partial.replace(options.output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UsageError(f"cannot write {options.output}: {error.strerror}") from None
    _reading(options).set_in(options.output)
    return calibration


def _reading(options: CalibrateOptions) -> NodeReading[Any]:
    """Give the reading of parameters of the node for which the file is."""
    return LOAD_READING if is_bag(options.data) else READING


def parameter_file(calibration: Calibration, options: CalibrateOptions) -> str:
    """Write the parameter file as text: only the fitted values, and in comments where they come from."""
    files = ", ".join(path.name for path in options.params) or "the defaults"
    others = "".join(f", {name} {value}" for name, value in options.values.items())
    rms = [f"{name} {value:.4g} {UNITS[name]}" for name, value in calibration.rms.items()]
    comments = [
        f"Written by knee-contact calibrate {__version__}, loss {calibration.loss}; all other parameters: "
        f"{files}{others}.",
        f"Data: {options.data.name}, sha256 {calibration.measured.digest}.",
        f"RMS of what is left: {', '.join(rms)}.",
        *(f"{remark[0].upper()}{remark[1:]}." for remark in calibration.remarks),
        *(f"{name}: {interval_text(calibration, name)}." for name in calibration.intervals),
        *(f"Warning: {warning}." for warning in calibration.warnings),
    ]
    lines = [f"# {' '.join(comment.split())}" for comment in comments]
    lines += [f"/**/{_reading(options).node}:", "  ros__parameters:", *_entries(calibration.also, "    ")]
    for section, values in nested(calibration.values).items():
        lines += [f"    {section}:", *_entries(values, "      ")]
    return "\n".join(lines) + "\n"


def _entries(values: Mapping[str, Any], indent: str) -> list[str]:
    return [f"{indent}{name}: {'true' if value is True else f'{value:.9e}'}" for name, value in values.items()]


def interval_text(calibration: Calibration, name: str) -> str:
    """Write the interval of a parameter as text."""
    low, high, low_open, high_open = calibration.intervals[name]
    below = "not bounded below" if low_open else f"{low:.6g}"
    above = "not bounded above" if high_open else f"{high:.6g}"
    between = f"{below} to {above}" if not (low_open or high_open) else f"{below}, {above}"
    return f"{100.0 * calibration.level:g} % interval {between}"


def _sigma(texts: Sequence[str]) -> dict[str, float]:
    """Read standard deviations, by column."""
    deviations = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            deviations[name] = float(number)
        except ValueError:
            deviations[name] = math.nan
        if not 0.0 < deviations[name] < math.inf:
            raise UsageError(f"--sigma {text}: it must be COLUMN=NUMBER, the number > 0, as penetration_depth=1e-6")
    return deviations
