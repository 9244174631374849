"""The work of `knee-contact calibrate`: a table or a bag → a parameter file with what was fitted."""

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
from knee_contact_ros.tools.calibration.in_memory import Calibration, Fit, Topics, calibrated, is_bag
from knee_contact_ros.tools.calibration.measured import ANSWERS
from knee_contact_ros.tools.calibration.reference import AXIAL_FORCE

UNITS = ANSWERS | {AXIAL_FORCE: "N"}
"""Of what is measured"""


class CalibrateOptions(NamedTuple):
    """What the command line says."""

    data: Path
    params: Sequence[Path]
    """Empty: the healthy knee; of a bag the load node's defaults"""
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
    remaps: Sequence[str] = ()
    """Of a bag's topics, as joint_reaction_force:=/implant/force"""
    namespace: str = ""


def run_calibrate(asked: CalibrateOptions) -> Calibration:
    """Fit, and write the parameter file.

    Raises:
        UsageError: data, parameters, an option or the output cannot be used. Nothing is written then.
    """
    refuse_impossible(asked.output)
    if not asked.overwrite:
        refuse_existing(asked.output)
    fit = Fit(_sigma(asked.sigma), asked.loss, asked.level, asked.with_intervals, asked.starts)
    topics = Topics(tuple(asked.remaps), asked.namespace)
    found = calibrated(asked.data, list(asked.params), asked.free, asked.values, fit, topics)
    partial = partial_name(asked.output)
    try:
        write_new(partial, parameter_file(found, asked).encode())
        partial.replace(asked.output)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UsageError(f"cannot write {asked.output}: {error.strerror}") from None
    _reading(asked).set_in(asked.output)
    return found


def _reading(asked: CalibrateOptions) -> NodeReading[Any]:
    """Of the node that the file is for."""
    return LOAD_READING if is_bag(asked.data) else READING


def parameter_file(found: Calibration, asked: CalibrateOptions) -> str:
    """The file's text: the fitted values alone, and in comments how they were made."""
    files = ", ".join(path.name for path in asked.params) or "the defaults"
    others = "".join(f", {name} {value}" for name, value in asked.values.items())
    noise = [f"{name} {found.rms[name]:.4g} {UNITS[name]}" for name in found.rms]
    said = [
        f"Written by knee-contact calibrate {__version__}, loss {found.loss}; all other parameters: {files}{others}.",
        f"Data: {asked.data.name}, sha256 {found.measured.digest}.",
        f"RMS of what is left: {', '.join(noise)}.",
        *(f"{remark[0].upper()}{remark[1:]}." for remark in found.remarks),
        *(f"{name}: {interval_text(found, name)}." for name in found.intervals),
        *(f"Warning: {warning}." for warning in found.warnings),
    ]
    lines = [f"# {' '.join(line.split())}" for line in said]
    lines += [f"/**/{_reading(asked).node}:", "  ros__parameters:", *_entries(found.also, "    ")]
    sections: dict[str, dict[str, float]] = {}
    for name, value in found.values.items():
        section, inner = name.split(".")
        sections.setdefault(section, {})[inner] = value
    for section, values in sections.items():
        lines += [f"    {section}:", *_entries(values, "      ")]
    return "\n".join(lines) + "\n"


def _entries(values: Mapping[str, Any], indent: str) -> list[str]:
    """Lines of parameters."""
    return [f"{indent}{name}: {'true' if value is True else f'{value:.9e}'}" for name, value in values.items()]


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
