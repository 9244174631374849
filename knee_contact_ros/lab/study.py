"""A study: bags, parameter files and varied values, all combined into numbered cases.

A study file (YAML) has

    bags:   [walking.mcap, "s3://gait/running.mcap"]       # files, folders, or what fsspec opens
    params: [healthy, [osteoarthritis, mri_femur.yaml]]    # each a knee: a file, or several of which the later one wins
    values: {fidelity.tolerance: 1.0e-8}                   # of all knees
    grid:   {contact.layer_depth: [0.25e-3, 0.5e-3], load.share: {from: 0.5, to: 0.8, number: 7}}
    sample: {method: sobol, n: 1024, seed: 1, ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3,
             to: 1.0e4, scale: log}}}
    series: true                                           # keep all answers of every case, too

Only `bags` is required.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from knee_contact_ros.lab.sweep import checked_names
from knee_contact_ros.parameters.files import check_value, dotted, first_error, known_parameters, load_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_mapping

LARGEST = 10_000_000
"""The largest number of cases that a study may have"""
Floats = NDArray[np.float64]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Spaced(_Part):
    """Evenly spaced values between two ends, or values whose logarithms are evenly spaced."""

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

    def at(self, fractions: Floats) -> Floats:
        """Give the values at fractions of the range, 0 at its beginning and 1 at its end."""
        if self.scale == "linear":
            values = self.start + (self.stop - self.start) * fractions
        else:
            values = np.exp(math.log(self.start) + math.log(self.stop / self.start) * fractions)
        return np.asarray(np.clip(values, self.start, self.stop))  # rounding must not leave what is allowed

    @property
    def values(self) -> list[float]:
        """All values, both ends included."""
        values: list[float] = self.at(np.linspace(0.0, 1.0, self.number)).tolist()
        return [self.start, *values[1:-1], self.stop]


class Design(_Part):
    """Points at which several parameters are varied together; a heir draws them in the unit cube."""

    method: str
    """How the points are drawn; checked first, so that a wrong one is what is told"""
    n: int = Field(ge=1, le=LARGEST)
    """Number of groups of points"""
    seed: int = Field(0, ge=0)
    ranges: Annotated[dict[str, Any], Field(min_length=1)]
    """Range of each parameter by name: two numbers, or a mapping with `from` and `to`"""

    @property
    def axes(self) -> dict[str, Spaced]:
        """Ranges of the parameters by name, in the order of the columns of `points`.

        Raises:
            UsageError: one is no range.
        """
        return {name: _range(name, given) for name, given in self.ranges.items()}

    @property
    def group(self) -> int:
        """Number of points in a group."""
        return 1

    @property
    def number(self) -> int:
        """Number of points."""
        return self.n * self.group

    def unit(self) -> Floats:
        """Draw points in the unit cube, shape (number, parameters); the same ones at every call."""
        raise NotImplementedError

    def points(self) -> Floats:
        """Give the parameters' values at the points, shape (number, parameters)."""
        columns = zip(self.axes.values(), self.unit().T, strict=True)
        return np.column_stack([axis.at(fractions) for axis, fractions in columns])


class Sample(Design):
    """Points drawn in ranges; a larger `sobol` or `random` sample begins with the points of a smaller one."""

    method: Literal["latin_hypercube", "sobol", "random"] = "latin_hypercube"

    def unit(self) -> Floats:
        """See `Design.unit`."""
        size = len(self.ranges)
        if self.method == "random":
            return np.random.default_rng(self.seed).random((self.n, size))
        from scipy.stats import qmc  # takes half a second to import

        if self.method == "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(size, seed=self.seed).random(self.n))
        power = math.ceil(math.log2(self.n))
        return np.asarray(qmc.Sobol(size, seed=self.seed).random_base2(power)[: self.n])


def _range(name: str, given: Any) -> Spaced:
    is_pair = isinstance(given, list | tuple) and len(given) == 2
    return _spaced(name, {"from": given[0], "to": given[1]} if is_pair else given)


def _spaced(name: str, given: Any) -> Spaced:
    if not isinstance(given, Mapping):
        raise UsageError(f"{name}: {given!r} is not allowed; a list of two numbers, or from, to and scale")
    try:
        return Spaced.model_validate(given)
    except ValidationError as error:
        raise UsageError(f"{name}: {first_error(error)}".replace(": :", ":")) from None


def _listed(name: str, given: Any) -> list[Any]:
    """Read the values of a parameter in a grid."""
    if isinstance(given, Mapping):
        return _spaced(name, given).values
    if not isinstance(given, list | tuple) or not given:
        raise UsageError(f"{name}: {given!r} is not allowed; a list of values, or from, to and number")
    return list(given)


class _File(_Part):
    bags: Annotated[list[str], Field(min_length=1)]
    params: Annotated[list[str | list[str]], Field(min_length=1)] = ["healthy"]
    values: dict[str, Any] = {}
    grid: dict[str, Any] = {}
    sample: Sample | None = None
    series: bool = False


class Case(NamedTuple):
    """A case of a study."""

    bag: str
    """The recording, as the study names it"""
    params: tuple[str, ...]
    """Names of the parameter files; a later one wins"""
    values: Mapping[str, Any]
    """Values of the varied parameters, by name"""


class Study:
    """A study's cases, numbered by bag, then parameter files, then values, of which the last name changes fastest."""

    def __init__(self, content: Mapping[str, Any], where: str = "study", design: Design | None = None) -> None:
        """Check the content of a study file.

        Args:
            content: The file's content.
            where: Name of the file, for error messages.
            design: Points to use instead of the file's `sample`.

        Raises:
            UsageError: an unknown name, an empty grid, or a value that its parameter may not have.
        """
        try:
            file = _File.model_validate(dict(content))
            self.content = dict(content)
            self.bags, self.series = tuple(file.bags), file.series
            self.design = design or file.sample
            self._axes = self.design.axes if self.design else {}
            self.params = tuple((one,) if isinstance(one, str) else tuple(one) for one in file.params)
            self.values = dotted(file.values)
            self.grid = {name: _listed(name, own) for name, own in file.grid.items()}
            self.names = [*self.grid, *self._axes]
            self._check()
        except ValidationError as error:
            raise UsageError(f"{where}: {first_error(error)}") from None
        except UsageError as error:
            raise UsageError(f"{where}: {error}") from None

    def _check(self) -> None:
        again = [name for name, own in self.grid.items() if len(set(map(repr, own))) < len(own)]
        if again:
            raise UsageError(f"{again[0]}: {self.grid[again[0]]!r} is not allowed; a value stands there twice")
        if self.number > LARGEST:
            raise UsageError(f"{self.number} cases are not allowed; {LARGEST} at most")
        files = [*(f"bags: {bag}" for bag in self.bags), *(f"params: {list(params)}" for params in self.params)]
        given = [*self.names, *self.values, *files]
        twice = [one for one in given if given.count(one) > 1]
        if twice:
            raise UsageError(f"{twice[0]} is given twice")
        checked_names(self.names)
        known = known_parameters()
        whole = [name for name in self._axes if name in known and not isinstance(known[name].default, float)]
        if whole:
            raise UsageError(f"{whole[0]}: a range is not allowed; it is no real number")
        ends = {name: [axis.start, axis.stop] for name, axis in self._axes.items()}
        single = {name: [value] for name, value in self.values.items()}
        for name, allowed in (self.grid | ends | single).items():
            for value in allowed:
                check_value(name, value)
        for params in self.params:
            load_parameters([*params, self.values])

    @property
    def number(self) -> int:
        """Number of cases."""
        return len(self.bags) * len(self.params) * self.variants

    @cached_property
    def variants(self) -> int:
        """Number of cases of one bag and one set of parameter files; their numbers are consecutive."""
        return math.prod(map(len, self.grid.values())) * (self.design.number if self.design else 1)

    @cached_property
    def _points(self) -> Floats:
        return self.design.points() if self.design else np.zeros((1, 0))

    def case(self, number: int) -> Case:
        """Give the case of a number."""
        bag, params = divmod(number // self.variants, len(self.params))
        combination, point = divmod(number % self.variants, len(self._points))
        places = np.unravel_index(combination, [len(allowed) for allowed in self.grid.values()])
        values = [allowed[place] for allowed, place in zip(self.grid.values(), places, strict=True)]
        named = zip(self.names, [*values, *self._points[point].tolist()], strict=True)
        return Case(self.bags[bag], self.params[params], dict(named))


def read_study(path: Path) -> Study:
    """Read a study file.

    Raises:
        UsageError: the file cannot be read, or see `Study`.
    """
    return Study(read_mapping(path, "study", "bags, params, grid or sample"), str(path))
