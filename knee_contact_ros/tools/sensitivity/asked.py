"""What a study file asks of a sensitivity analysis: as of a sweep, with `sensitivity` in the place of `sample`.

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
OWN = ("sensitivity", "outcomes")


class Asked(NamedTuple):
    """A study, and what is to be said of it."""

    study: Study
    design: SalibDesign
    outcomes: tuple[str, ...]


def read_asked(path: Path) -> Asked:
    """A study file.

    Raises:
        UsageError: it cannot be read, or see `asked_of`.
    """
    return asked_of(read_mapping(path, "study", "bags, params, grid, sensitivity or outcomes"), str(path))


def asked_of(content: Mapping[str, Any], where: str = "study") -> Asked:
    """What a study file says.

    Raises:
        UsageError: an unknown name, a value that is not allowed, or no ranges.
    """
    if "sample" in content:
        raise UsageError(f"{where}: sample is not allowed; the method under sensitivity draws its own")
    told = content.get("sensitivity")
    if not isinstance(told, Mapping):
        raise UsageError(f"{where}: sensitivity: {told!r} is not allowed; method, n and ranges")
    try:
        design = SalibDesign.model_validate(dict(told))
        outcomes = checked_outcomes(content.get("outcomes", USUAL))
    except ValidationError as error:
        raise UsageError(f"{where}: sensitivity.{first_of(error)}") from None
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from None
    study = Study({name: value for name, value in content.items() if name not in OWN}, where, design)
    study.content |= {name: content[name] for name in OWN if name in content}
    return Asked(study, design, outcomes)


def first_of(error: ValidationError) -> str:
    """The first of what is wrong; what is wrong with several together names itself."""
    first = error.errors()[0]
    return first["msg"].removeprefix("Value error, ") if not first["loc"] else first_error(error)


def checked_outcomes(names: Any) -> tuple[str, ...]:
    """The columns of a table that indices are wanted of.

    Raises:
        UsageError: there is none, or one of them is none.
    """
    known = [side + one.name for side in ("", LATERAL) for one in OUTCOMES]
    if not isinstance(names, list | tuple) or not names:
        raise UsageError(f"outcomes: {names!r} is not allowed; a list of some of {', '.join(known)}")
    for name in names:
        if name not in known or names.count(name) > 1:
            told = "is given twice" if name in known else f"is not allowed; one of {', '.join(known)}"
            raise UsageError(f"outcomes: {name} {told}")
    return tuple(names)
