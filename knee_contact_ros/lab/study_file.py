"""Study files: which bags, which knees, and which parameters vary.

A study file (YAML) has

    bags:   [walking.mcap, "s3://gait/running.mcap"]       # files, folders, or what fsspec opens
    params: [healthy, [osteoarthritis, mri_femur.yaml]]    # each a knee: a file, or several; later ones override
    values: {fidelity.tolerance: 1.0e-8}                   # of all knees
    grid:   {contact.layer_depth: [0.25e-3, 0.5e-3], load.share: {from: 0.5, to: 0.8, number: 7}}
    sample: {method: sobol, n: 1024, seed: 1, ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3,
             to: 1.0e4, scale: log}}}
    series: true                                           # also keep all answers of every case

    subjects: [s01.yaml, s02.yaml]                         # subject files, each with the bag that it names

`bags` or `subjects` are required. Cases are all combinations of bags, parameter files and varied values.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from ..model.types import Floats
from ..parameters.files import (
    check_value,
    dotted,
    known_parameters,
)
from ..parameters.sections import first_error
from ..parameters.subjects import Subject
from ..system.errors import UsageError
from ..system.files import read_mapping
from .knees import check_may_vary

StudyKind = TypeVar("StudyKind", bound="Study")
MAX_CASES = 10_000_000
"""Largest number of cases of a study; a larger number is a slip in the file"""


class StudySection(BaseModel):
    """Section of a study file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SpacedValues(StudySection):
    """Evenly spaced values between two ends, or values whose logarithms are evenly spaced."""

    start: float = Field(alias="from")
    stop: float = Field(alias="to")
    number: int = Field(2, ge=2, le=MAX_CASES)
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="before")
    @classmethod
    def _read_pair(cls, given: Any) -> Any:
        if isinstance(given, list | tuple) and len(given) == 2:
            return {"from": given[0], "to": given[1]}
        if not isinstance(given, Mapping):
            raise ValueError("a list of two numbers, or from, to and scale")  # noqa: TRY004  (as pydantic asks)
        return given

    @model_validator(mode="after")
    def _check_order(self) -> SpacedValues:
        if not self.start < self.stop or (self.scale == "log" and self.start <= 0.0):
            order = "0 < from < to" if self.scale == "log" else "from < to"
            raise ValueError(f"{order} is required")
        return self

    def at(self, fractions: Floats) -> Floats:
        """Return the values at fractions of the range, 0 at its beginning and 1 at its end."""
        if self.scale == "linear":
            values = self.start + (self.stop - self.start) * fractions
        else:
            values = np.exp(math.log(self.start) + math.log(self.stop / self.start) * fractions)
        # Rounding must not leave the range, whose ends may be those of the parameter's own.
        return np.asarray(np.clip(values, self.start, self.stop))


def _list_values(given: Any) -> Any:
    """Return the values of a range in a grid, both ends included; a list stays as it is."""
    if not isinstance(given, Mapping):
        return given
    try:
        axis = SpacedValues.model_validate(given)
    except ValidationError as error:
        raise ValueError(error.errors()[0]["msg"].removeprefix("Value error, ")) from None
    return [axis.start, *axis.at(np.linspace(0.0, 1.0, axis.number))[1:-1].tolist(), axis.stop]


class Design(StudySection):
    """Points at which several parameters vary together; a subclass draws them in the unit cube."""

    method: str
    """How the points are drawn; checked first, so that a wrong method is reported first"""
    n: int = Field(ge=1, le=MAX_CASES)
    """Number of groups of points"""
    seed: int = Field(0, ge=0)
    ranges: Annotated[dict[str, SpacedValues], Field(min_length=1)]
    """Range of each parameter by name: two numbers, or a mapping with `from` and `to`"""

    @property
    def number(self) -> int:
        """Number of points."""
        return self.n

    def unit_points(self) -> Floats:
        """Draw points in the unit cube, shape (number, parameters); every call gives the same points."""
        raise NotImplementedError

    def points(self) -> Floats:
        """Return the parameters' values at the points, shape (number, parameters)."""
        columns = zip(self.ranges.values(), self.unit_points().T, strict=True)
        return np.column_stack([axis.at(fractions) for axis, fractions in columns])


class Sample(Design):
    """Points drawn in ranges; a larger `sobol` or `random` sample begins with the points of a smaller one."""

    method: Literal["latin_hypercube", "sobol", "random"] = "latin_hypercube"

    def unit_points(self) -> Floats:
        """See `Design.unit_points`."""
        size = len(self.ranges)
        if self.method == "random":
            return np.random.default_rng(self.seed).random((self.n, size))
        from scipy.stats import qmc  # takes half a second to import

        if self.method == "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(size, seed=self.seed).random(self.n))
        power = math.ceil(math.log2(self.n))
        return np.asarray(qmc.Sobol(size, seed=self.seed).random_base2(power)[: self.n])


class Study(StudySection):
    """Content of a study file. Cases are in the order of bag, parameter files, then values: the last changes fastest.

    Raises:
        UsageError: something is given twice, a parameter is unknown, or a value is not allowed.
    """

    bags: list[str] = []
    subjects: list[str] = []
    """Subject files: each is computed with its own bag, and with the knees of `params` below its own values"""
    params: Annotated[list[str | list[str]], Field(min_length=1)] = ["healthy"]
    values: Annotated[
        dict[str, Any],
        BeforeValidator(lambda given: dotted(given) if isinstance(given, Mapping) else given),
    ] = {}
    grid: dict[str, Annotated[list[Any], BeforeValidator(_list_values), Field(min_length=1)]] = {}
    sample: Sample | None = None
    series: bool = False

    @property
    def design(self) -> Design | None:
        """The points at which parameters vary together."""
        return self.sample

    @property
    def names(self) -> list[str]:
        """Names of the varied parameters."""
        return [*self.grid, *(self.design.ranges if self.design else ())]

    @property
    def knees(self) -> list[tuple[str, tuple[str, ...]]]:
        """Each bag with each set of parameter files."""
        sets = [(one,) if isinstance(one, str) else tuple(one) for one in self.params]
        people = [
            (str(Subject(Path(path)).bag), (*one, path))
            for path, one in itertools.product(self.subjects, sets)
        ]
        return [*itertools.product(self.bags, sets), *people]

    @property
    def number(self) -> int:
        """Number of cases."""
        points = self.design.number if self.design else 1
        return len(self.knees) * points * math.prod(map(len, self.grid.values()))

    def variants(self) -> Iterator[dict[str, Any]]:
        """Return the values of the varied parameters, the same for each of `knees`."""
        points = self.design.points().tolist() if self.design else [[]]
        for values, point in itertools.product(itertools.product(*self.grid.values()), points):
            yield dict(zip(self.names, (*values, *point), strict=True))

    def _check_subjects(self) -> None:
        """Check that there is a gait, that each subject names its own, and that its knee is not given twice.

        Raises:
            UsageError: something is missing, or given twice.
        """
        if not self.bags and not self.subjects:
            raise UsageError("bags: is missing; a study needs bags, or subjects that name theirs")
        for path in self.subjects:
            content = Subject(Path(path)).content
            if not content.bag:
                raise UsageError(f"subject file {path}: bag: is missing; a study needs its gait")
            if content.parameters and "params" in self.model_fields_set:
                raise UsageError(
                    f"subject file {path}: parameters: the study has params; name the knees in one of both"
                )

    @model_validator(mode="after")
    def _check(self) -> Study:
        self._check_subjects()
        if self.number > MAX_CASES:
            raise UsageError(f"{self.number} cases are not allowed; {MAX_CASES} at most")
        given = [*self.names, *self.values]
        given += [f"{bag} with {list(params)}" for bag, params in self.knees]
        given += [f"{name} {value!r}" for name, values in self.grid.items() for value in values]
        for one, count in Counter(given).items():
            if count > 1:
                raise UsageError(f"{one} is given twice")
        check_may_vary(self.names)
        ranges = self.design.ranges if self.design else {}
        known = known_parameters()
        for name in ranges:
            if name in known and not isinstance(known[name].default, float):
                fault = "a range is not allowed; only a real number can have one"
                raise UsageError(f"{name}: {fault}")
        ends = {name: [axis.start, axis.stop] for name, axis in ranges.items()}
        single = {name: [value] for name, value in self.values.items()}
        for name, values in (self.grid | ends | single).items():
            for value in values:
                check_value(name, value)
        return self


def read_study(path: Path, kind: type[StudyKind]) -> StudyKind:
    """Read a study file.

    Raises:
        UsageError: the file cannot be read, or see `Study`.
    """
    content = read_mapping(path, "study", "bags, params, grid or sample")
    try:
        return kind.model_validate(dict(content))
    except ValidationError as error:
        raise UsageError(f"{path}: {first_error(error)}") from None
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
