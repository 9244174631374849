"""The study file of a sensitivity analysis: that of a sweep, with `sensitivity` in the place of `sample`.

    bags:        [walking.mcap]
    params:      [healthy, osteoarthritis]
    grid:        {load.share: [0.5, 1.0]}
    sensitivity: {method: sobol, n: 256, seed: 1, second_order: false, confidence: 0.95,
                  ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3, to: 1.0e4, scale: log}}}
    outcomes:    [peak_depth, peak_pressure, bone_time]

The indices are of every combination of bag, knee and grid value.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from knee_contact_ros.cohort.outcomes import OUTCOMES
from knee_contact_ros.cohort.study import Study
from knee_contact_ros.cohort.table import LATERAL
from knee_contact_ros.parameters.reading import first_error
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.yaml_file import read_mapping
from knee_contact_ros.tools.sensitivity.design import SalibDesign

USUAL = ("peak_depth", "peak_pressure", "bone_time", "peak_force")
"""Outcomes that are analysed unless others are named"""
OWN = ("sensitivity", "outcomes")
"""Names in the file that the study file of a sweep does not have"""


class SensitivityStudy(NamedTuple):
    """A sensitivity analysis: cases at the points of a design, and the outcomes to be analysed."""

    cases: Study
    """The study whose cases are the points"""
    design: SalibDesign
    """The design of the points"""
    outcomes: tuple[str, ...]
    """Names of columns of the study's table"""


def read_sensitivity_study(path: Path) -> SensitivityStudy:
    """Read a study file.

    Raises:
        UsageError: the file cannot be read, a name is unknown, a value is not allowed, or ranges are missing.
    """
    content = read_mapping(path, "study", "bags, params, grid, sensitivity or outcomes")
    if "sample" in content:
        raise UsageError(f"{path}: sample is not allowed; the method under sensitivity draws its own")
    given = content.get("sensitivity")
    if not isinstance(given, Mapping):
        raise UsageError(f"{path}: sensitivity: {given!r} is not allowed; method, n and ranges")
    try:
        design = SalibDesign.model_validate(dict(given))
        outcomes = checked_outcomes(content.get("outcomes", USUAL))
    except ValidationError as error:
        raise UsageError(f"{path}: sensitivity.{first_fault(error)}") from None
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    study = Study({name: value for name, value in content.items() if name not in OWN}, str(path), design)
    study.content |= {name: content[name] for name in OWN if name in content}
    return SensitivityStudy(study, design, outcomes)


def first_fault(error: ValidationError) -> str:
    """Describe the first fault; a message about several fields together names them itself."""
    first = error.errors()[0]
    return first["msg"].removeprefix("Value error, ") if not first["loc"] else first_error(error)


def checked_outcomes(names: Any) -> tuple[str, ...]:
    """Check the names of the outcomes to be analysed.

    Raises:
        UsageError: it is no list of names, or a name is unknown or given twice.
    """
    known = [prefix + outcome.name for prefix in ("", LATERAL) for outcome in OUTCOMES]
    if not isinstance(names, list | tuple) or not names:
        raise UsageError(f"outcomes: {names!r} is not allowed; a list of some of {', '.join(known)}")
    for name in names:
        if name not in known or names.count(name) > 1:
            fault = "is given twice" if name in known else f"is not allowed; one of {', '.join(known)}"
            raise UsageError(f"outcomes: {name} {fault}")
    return tuple(names)
