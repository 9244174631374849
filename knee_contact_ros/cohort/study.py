"""What a study asks: bags, parameter files, and the values that are varied, all combined; a case has a number.

A study file (YAML) has

    bags:   [walking.mcap, "s3://gait/running.mcap"]       # files, folders, or what fsspec opens
    params: [healthy, [osteoarthritis, mri_femur.yaml]]    # each a knee: a file, or several of which the later one wins
    values: {fidelity.tolerance: 1.0e-8}                   # of all knees
    grid:   {contact.layer_depth: [0.25e-3, 0.5e-3], load.share: {from: 0.5, to: 0.8, number: 7}}
    sample: {method: sobol, n: 1024, seed: 1, ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3,
             to: 1.0e4, scale: log}}}
    series: true                                           # keep all answers of every case, too

of which `bags`, and `grid` or `sample` or several knees, are needed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from knee_contact_ros.cohort.knees import checked_names
from knee_contact_ros.parameters.reading import check_value, dotted, first_error, known_parameters, load_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.yaml_file import read_mapping

LARGEST = 10_000_000
"""Cases of a study"""
ENDS = 2
METHODS = Literal["latin_hypercube", "sobol", "random"]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Spaced(_Part):
    """Values between two, evenly, or evenly in the logarithm."""

    start: float = Field(alias="from")
    stop: float = Field(alias="to")
    number: int = Field(2, ge=2, le=LARGEST)
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _in_order(self) -> Spaced:
        if not self.start < self.stop or (self.scale == "log" and self.start <= 0.0):
            least = "0 < from < to" if self.scale == "log" else "from < to"
            raise ValueError(f"from {self.start:g} to {self.stop:g}: {least} is asked")
        return self

    def at(self, part: NDArray[np.float64]) -> NDArray[np.float64]:
        """The values at parts of the way, 0 to 1."""
        if self.scale == "linear":
            found = self.start + (self.stop - self.start) * part
        else:
            found = np.exp(math.log(self.start) + math.log(self.stop / self.start) * part)
        return np.asarray(np.clip(found, self.start, self.stop))  # rounding must not leave what is allowed

    @property
    def values(self) -> list[float]:
        """All of them, both ends included."""
        found: list[float] = self.at(np.linspace(0.0, 1.0, self.number)).tolist()
        return [self.start, *found[1:-1], self.stop]


class Design(Protocol):
    """Values that are varied together: a file's `sample`, or points that somebody else has chosen."""

    @property
    def names(self) -> list[str]:
        """Of the parameters."""

    @property
    def ends(self) -> list[tuple[float, float]]:
        """The least and the largest value of each."""

    @property
    def number(self) -> int:
        """Of the points."""

    def points(self) -> NDArray[np.float64]:
        """Shape (number, names), the same whenever it is asked."""


class Sample(_Part):
    """Points of a box; more of a `sobol` or a `random` sample begin with the same ones."""

    method: METHODS = "latin_hypercube"
    n: int = Field(ge=1, le=LARGEST)
    seed: int = Field(0, ge=0)
    ranges: Annotated[dict[str, Any], Field(min_length=1)]

    def points(self) -> NDArray[np.float64]:
        """Shape (n, names)."""
        parts = self._parts()
        return np.column_stack([axis.at(parts[:, i]) for i, axis in enumerate(self.axes)])

    def _parts(self) -> NDArray[np.float64]:
        """The points of a box whose sides reach from 0 to 1."""
        size = len(self.ranges)
        if self.method == "random":
            return np.random.default_rng(self.seed).random((self.n, size))
        from scipy.stats import qmc  # a quarter of a second to import

        if self.method == "sobol":
            doubled = math.ceil(math.log2(self.n)) if self.n > 1 else 0
            found = qmc.Sobol(size, seed=self.seed).random_base2(doubled)[: self.n]
        else:
            found = qmc.LatinHypercube(size, seed=self.seed).random(self.n)
        return np.asarray(found)

    @property
    def axes(self) -> list[Spaced]:
        """The ranges, in their order."""
        return axes_of(self.ranges)

    @property
    def names(self) -> list[str]:
        """Of the parameters."""
        return list(self.ranges)

    @property
    def ends(self) -> list[tuple[float, float]]:
        """The least and the largest value of each."""
        return [(axis.start, axis.stop) for axis in self.axes]

    @property
    def number(self) -> int:
        """Of the points."""
        return self.n


def axes_of(ranges: Mapping[str, Any]) -> list[Spaced]:
    """What a study file says of ranges, by parameter.

    Raises:
        UsageError: one is none.
    """
    return [_spaced(name, _pair(each)) for name, each in ranges.items()]


def _pair(told: Any) -> Any:
    """A list of two numbers as the ends of a range."""
    return {"from": told[0], "to": told[1]} if isinstance(told, list | tuple) and len(told) == ENDS else told


def _spaced(name: str, told: Any) -> Spaced:
    """What a study file says of a range.

    Raises:
        UsageError: it is none.
    """
    if not isinstance(told, Mapping):
        raise UsageError(f"{name}: {told!r} is not allowed; a list of two numbers, or from, to and scale")
    try:
        return Spaced.model_validate(told)
    except ValidationError as error:
        raise UsageError(f"{name}: {first_error(error)}".replace(": :", ":")) from None


def _listed(name: str, told: Any) -> list[Any]:
    """The values that a grid has of a parameter.

    Raises:
        UsageError: there is none.
    """
    if isinstance(told, Mapping):
        return list(_spaced(name, told).values)
    if not isinstance(told, list | tuple) or not told:
        raise UsageError(f"{name}: {told!r} is not allowed; a list of values, or from, to and number")
    return list(told)


class _File(_Part):
    bags: Annotated[list[str], Field(min_length=1)]
    params: Annotated[list[str | list[str]], Field(min_length=1)] = ["healthy"]
    values: dict[str, Any] = {}
    grid: dict[str, Any] = {}
    sample: Sample | None = None
    series: bool = False


class Case(NamedTuple):
    """One run of a study."""

    bag: str
    params: tuple[str, ...]
    values: Mapping[str, Any]


class Group(NamedTuple):
    """Cases of one recording and one set of parameter files; their numbers follow each other."""

    bag: str
    params: tuple[str, ...]
    numbers: range


class Study:
    """Numbered cases: bags, then knees, then values, of which the last name changes soonest."""

    def __init__(self, content: Mapping[str, Any], where: str = "study", design: Design | None = None) -> None:
        """What a study file says, and the points of a `design` instead of its sample.

        Raises:
            UsageError: an unknown name, an empty grid, a value that its parameter may not have, or nothing to vary.
        """
        try:
            told = _File.model_validate(dict(content))
            self.content = dict(content)
            self.bags, self.series = tuple(told.bags), told.series
            self.design: Design | None = design or told.sample
            self.params = tuple((one,) if isinstance(one, str) else tuple(one) for one in told.params)
            self.values = dotted(told.values)
            self.grid = {name: _listed(name, own) for name, own in told.grid.items()}
            self.names = [*self.grid, *(self.design.names if self.design else ())]
            self._check()
        except ValidationError as error:
            raise UsageError(f"{where}: {first_error(error)}") from None
        except UsageError as error:
            raise UsageError(f"{where}: {error}") from None

    def _check(self) -> None:
        again = next((name for name, own in self.grid.items() if len(set(map(repr, own))) < len(own)), "")
        if again:
            raise UsageError(f"{again}: {self.grid[again]!r} is not allowed; a value stands there twice")
        if self.number > LARGEST:
            raise UsageError(f"{self.number} cases are not allowed; {LARGEST} at most")
        twice = [name for name in self.names if self.names.count(name) > 1 or name in self.values]
        if twice:
            raise UsageError(f"{twice[0]} is given twice")
        _refuse_again("bags", self.bags)
        _refuse_again("params", self.params)
        checked_names(self.names)
        known = known_parameters()
        for name in self.design.names if self.design else ():
            if name in known and not isinstance(known[name].default, float):
                raise UsageError(f"{name}: a range is not allowed; it is no real number")
        ends = dict(zip(self.design.names, map(list, self.design.ends), strict=True)) if self.design else {}
        for name, allowed in {**self.grid, **ends, **{name: [value] for name, value in self.values.items()}}.items():
            for value in allowed:
                check_value(name, value)
        for params in self.params:
            load_parameters([*params, self.values])

    @property
    def number(self) -> int:
        """Of the cases."""
        return len(self.bags) * len(self.params) * self.variants

    @cached_property
    def variants(self) -> int:
        """Cases of one bag and one knee; their numbers follow each other."""
        return math.prod(map(len, self.grid.values())) * (self.design.number if self.design else 1)

    def groups(self) -> list[Group]:
        """All cases, by recording and parameter files."""
        pairs = itertools.product(self.bags, self.params)
        size = self.variants
        return [Group(bag, params, range(i * size, (i + 1) * size)) for i, (bag, params) in enumerate(pairs)]

    @cached_property
    def _points(self) -> NDArray[np.float64]:
        return self.design.points() if self.design else np.zeros((1, 0))

    def case(self, number: int) -> Case:
        """A case by its number."""
        bag, params = divmod(number // self.variants, len(self.params))
        return Case(self.bags[bag], self.params[params], dict(zip(self.names, self.row(number), strict=True)))

    def row(self, number: int) -> tuple[Any, ...]:
        """The values of a case, in the order of the names."""
        combination, point = divmod(number % self.variants, len(self._points))
        values = []
        for allowed in reversed(self.grid.values()):
            combination, place = divmod(combination, len(allowed))
            values.append(allowed[place])
        return (*reversed(values), *self._points[point].tolist())


def _refuse_again(what: str, given: Sequence[Any]) -> None:
    again = next((one for number, one in enumerate(given) if one in given[:number]), None)
    if again is not None:
        raise UsageError(f"{what}: {again if isinstance(again, str) else list(again)} is given twice")


def read_study(path: Path) -> Study:
    """A study file.

    Raises:
        UsageError: it cannot be read, or see `Study`.
    """
    return Study(read_mapping(path, "study", "bags, params, grid or sample"), str(path))
