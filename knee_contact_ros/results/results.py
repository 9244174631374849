"""The record array of answers that `run` and `solve` return."""

from __future__ import annotations

from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.readouts import Readings
from knee_contact_ros.model.types import ROW
from knee_contact_ros.results import figure, table
from knee_contact_ros.results.columns import TIME, columns, time_of, unit_of
from knee_contact_ros.results.extra import library
from knee_contact_ros.system.errors import UsageError

PARQUET = ".parquet"


class Results(np.recarray[Any, Any]):
    """The answers of a run: a record array of shape (n,) whose records have the fields of `Contact`.

    Fields are attributes, arrays of shape (n,) with the names of the message's fields: `results.contact_force` [N]. A
    slice, a mask, some of the fields (`results[["stamp", "load"]]`) and what NumPy joins (`np.concatenate`) are
    `Results` again. The methods `to_...` and `plot` need the extra `notebook`, and raise `UsageError` without it.
    """

    model: KneeModel | None = None
    """The model that computed the answers; parts of the answers keep it, joined or stored answers do not"""
    lateral: Results | None = None
    """Answers of the lateral compartment, from `solve` where both are modelled; a slice does not keep them"""

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of the answers [s], shape (n,); `stamp` has it in integer nanoseconds."""
        return time_of(self)

    @property
    def readouts(self) -> Readings:
        """Patch, pressure, strain and loading rate of the answers, shape (n,), see `KneeModel.readouts`.

        Raises:
            UsageError: the model is not known, or has no patch.
        """
        if self.model is None:
            raise UsageError("readouts: what computed these answers is not known; see the method of the model")
        try:
            return self.model.readouts(self)
        except ValueError as error:
            raise UsageError(str(error)) from None

    def to_pandas(self) -> Any:
        """Give a `pandas.DataFrame` in SI units with a column for every number, indexed by time [s].

        Vectors are columns of their components: `contact_point_x`. All methods `to_...` use the same names.
        """
        pandas, numbers = library("pandas"), columns(self)
        return pandas.DataFrame(numbers, index=pandas.Index(numbers.pop(TIME), name=TIME))

    def to_polars(self) -> Any:
        """Give a `polars.DataFrame` in SI units with a column for every number; the first one is the time [s]."""
        return library("polars").DataFrame(columns(self))

    def to_xarray(self) -> Any:
        """Give an `xarray.Dataset` along `time` [s], with the SI unit of every variable in `attrs["units"]`."""
        numbers = columns(self)
        variables = {name: (TIME, values, _attributes(name)) for name, values in numbers.items()}
        return library("xarray").Dataset(variables, coords={TIME: variables.pop(TIME)})

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Write the columns of `to_polars` to a Parquet file; a file of the same name is replaced.

        Raises:
            UsageError: the name of `path` does not end in .parquet.
        """
        if not fspath(path).endswith(PARQUET):
            raise UsageError(f"{fspath(path)}: to_parquet writes Parquet files, whose names end in {PARQUET}")
        self.to_polars().write_parquet(path)

    def plot(self) -> Any:
        """Draw flexion, load and contact force, depth, and the contact point over time.

        Returns the `matplotlib.figure.Figure`: a notebook shows it, `savefig` writes it.
        """
        return figure.figure_of(self)

    def __array_finalize__(self, whole: Any) -> None:
        """Keep the model of the array that this one is a part of."""
        super().__array_finalize__(whole)
        self.model = getattr(whole, "model", None)

    def __getitem__(self, index: Any) -> Any:
        return self.time if isinstance(index, str) and index == TIME else super().__getitem__(index)

    def __array_function__(self, function: Any, kinds: Any, arguments: Any, options: Any) -> Any:
        """Make results with the same fields `Results` again: NumPy drops the class of arrays that it joins."""
        result = super().__array_function__(function, kinds, arguments, options)
        whole = type(result) is np.ndarray and result.dtype.names == ROW.names
        return result.astype(self.dtype, copy=False).view(type(self)) if whole else result

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(self.dtype.names or ())})

    def __repr__(self) -> str:
        return f"<Results: {table.in_a_line(self)}>" if self._is_whole else super().__repr__()

    def __str__(self) -> str:
        return table.as_text(self) if self._is_whole else super().__str__()

    def _repr_html_(self) -> str | None:
        return table.as_html(self) if self._is_whole else None

    @property
    def _is_whole(self) -> bool:
        """Whether all fields are there; NumPy also gives some fields, or one with parts, as arrays of this class."""
        return self.dtype.names == ROW.names and self.ndim == 1


def _attributes(name: str) -> dict[str, str]:
    unit = unit_of(name)
    return {"units": unit} if unit else {}
