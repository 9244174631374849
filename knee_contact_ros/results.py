"""Answers of a run for notebooks: a record array that converts to tables, figures and data of other libraries."""

from __future__ import annotations

import csv
import difflib
import json
from collections.abc import Collection, Mapping
from html import escape
from importlib import import_module
from io import BytesIO, StringIO
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from .model.knee import KneeModel
from .model.readouts import Readings
from .model.types import (
    FIELDS,
    FIRST_DATE,
    FLAT,
    MESSAGE_FIELDS,
    MM,
    NANOSECOND,
    ROW,
    Floats,
    Integers,
    Rows,
    Status,
)
from .system.arguments import checked
from .system.errors import UsageError
from .system.files import not_installed

TIME = "time"
"""Name of the column with the time"""
RUN = "run"
"""Name of the column with the number of the run"""
_PARQUET = ".parquet"
_SHOWN_ROWS = 4
"""Number of rows that the table shows of the beginning, and of the end"""
_TABLE_WIDTH = 78
"""Width of the table in a terminal [characters]"""
_HEADINGS = (
    "time [s]",
    "flexion [°]",
    "load [N]",
    "contact force [N]",
    "depth [mm]",
    "point x [mm]",
    "status",
)
"""Headings of the table's columns"""
_FIGURE_SIZE = (8.0, 8.0)
"""Width and height of the figure [inch]"""
_MIN_POINT_RANGE = 1.0
"""Smallest half range [mm] of the axis of the contact point, which may hardly move"""
_DRAWN = ("stamp", "flexion_angle", "load", "contact_force", "penetration_depth", "contact_point")
"""Fields that the figure shows"""
_LOAD_COLOUR = "#b8bec6"
_FORCE_COLOUR = "#c1272d"
_DEPTH_COLOUR = "#1b5e9e"
_POINT_COLOUR = "#4b7f52"


def missing_attribute(thing: object, name: str) -> AttributeError:
    """Return the error of an attribute that a result does not have; it suggests the one with the most similar name."""
    # Libraries ask for names with underscores, and expect a short answer.
    near = difflib.get_close_matches(name, dir(thing), n=1) if not name.startswith("_") else []
    hint = f"; did you mean {near[0]}?" if near else ""
    return AttributeError(f"{type(thing).__name__} has no {name}{hint}")


class Records(np.recarray[Any, Any]):
    """Record array with a short text, which suggests the right name for a wrong field."""

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *(self.dtype.names or ())})

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(self, name)

    def __repr__(self) -> str:
        with np.printoptions(threshold=8, edgeitems=3):
            return super().__repr__()


class Results(Records):
    """The answers of a run: a record array of shape (n,) whose records have the fields of `Contact`.

    Fields are attributes, arrays of shape (n,) with the names of the message's fields: `results.contact_force` [N]. A
    slice, a mask, some of the fields (`results[["stamp", "load"]]`) and arrays joined by `np.concatenate` are also
    `Results`. The methods `to_...` and `plot` need the extra `notebook`, and raise `UsageError` without it.

    Example:
        >>> from knee_contact_ros import load_model
        >>> knee = load_model()
        >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
        >>> answers[answers.load > 750.0].contact_force.round(1)
        array([801.7, 900.1])
    """

    model: KneeModel | None = None
    """The model that computed the answers; parts of the answers keep it, but joined or stored answers do not"""
    parameters: Mapping[str, Any] | None = None
    """The parameters of the answers by dotted name, if they are known: those of `solve`"""
    lateral: Results | None = None
    """Answers of the lateral compartment, from `solve` if both are modelled; a slice does not keep them"""

    @property
    def time(self) -> Floats:
        """Time of the answers [s], shape (n,); `stamp` has it in integer nanoseconds."""
        return _time_of(self)

    @property
    def run(self) -> Integers:
        """Number of the run of each answer, shape (n,), from 0. A new run begins at rest, as after stamps went back.

        Times of several runs may be the same.
        """
        return _run_of(self)

    @property
    def readouts(self) -> Readings:
        """Patch, pressure, strain and loading rate of the answers, shape (n,), see `KneeModel.readouts`.

        Raises:
            UsageError: the model is not known, or has no patch.
        """
        if self.model is None:
            reason = "the model of these answers is not known; see the method of the model"
            raise UsageError(f"readouts: {reason}")
        try:
            return self.model.readouts(self).view(Records)
        except ValueError as error:
            raise UsageError(str(error)) from None

    @property
    def ringing(self) -> Floats:
        """How far each contact force rings [N], shape (n,), see `KneeModel.ringing`.

        Raises:
            UsageError: the model is not known.
        """
        if self.model is None:
            raise UsageError(
                "ringing: the model of these answers is not known; see the method of the model"
            )
        return self.model.ringing(self)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame` in SI units with a column for every number, indexed by time [s].

        Vectors are columns of their components: `contact_point_x`. All methods `to_...` use the same names.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> answers.to_pandas()[["load", "contact_force"]].round(1).iloc[-1].to_dict()
            {'load': 900.0, 'contact_force': 900.1}
        """
        pandas = _library("pandas")
        numbers = columns(self)
        return pandas.DataFrame(numbers, index=pandas.Index(numbers.pop(TIME), name=TIME))

    def to_polars(self) -> Any:
        """Return a `polars.DataFrame` in SI units with a column for every number; the first one is the time [s].

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> answers.to_polars().select("time", "load").rows()
            [(0.0, 700.0), (0.01, 800.0), (0.02, 900.0)]
        """
        return _library("polars").DataFrame(columns(self))

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` along `time` [s], with the SI unit of every variable in `attrs["units"]`.

        Its own `attrs` have version and parameters, see `attributes`.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> answers.to_xarray().contact_force.attrs["units"]
            'N'
        """
        variables = {}
        for name, values in columns(self).items():
            unit = unit_of(name)
            variables[name] = (TIME, values, {"units": unit} if unit else {})
        return _library("xarray").Dataset(
            variables, coords={TIME: variables.pop(TIME)}, attrs=attributes(self.parameters)
        )

    @checked
    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Write the columns of `to_polars` to a Parquet file; a file of the same name is replaced.

        The file's metadata have units, version and parameters, see `attributes`.

        Raises:
            UsageError: the name of `path` does not end in .parquet.
            OSError: the file cannot be written.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> import tempfile
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     answers.to_parquet(f"{folder}/answers.parquet")
        """
        if not fspath(path).endswith(_PARQUET):
            reason = f"to_parquet writes Parquet files, whose names end in {_PARQUET}"
            raise UsageError(f"{fspath(path)}: {reason}")
        table = self.to_polars()
        table.write_parquet(path, metadata=attributes(self.parameters, table.columns))

    def plot(self) -> Any:
        """Draw flexion, load and contact force, depth, and the contact point over time.

        Returns the `matplotlib.figure.Figure`: a notebook shows it, `savefig` writes it.

        Raises:
            UsageError: a field that it shows is not among those of these answers.

        Example:
            >>> from knee_contact_ros import load_model
            >>> knee = load_model()
            >>> answers = knee.run([0.0, 0.01, 0.02], [0.30, 0.32, 0.34], [700.0, 800.0, 900.0])
            >>> figure = answers.plot()
            >>> len(figure.axes)
            4
        """
        return _figure_of(self)

    def __array_finalize__(self, whole: Any) -> None:
        """Keep model and parameters of the array that this one is part of."""
        super().__array_finalize__(whole)
        self.model = getattr(whole, "model", None)
        self.parameters = getattr(whole, "parameters", None)

    def __getitem__(self, index: Any) -> Any:
        is_time = isinstance(index, str) and index == TIME
        return self.time if is_time else super().__getitem__(index)

    def __array_function__(self, function: Any, kinds: Any, arguments: Any, options: Any) -> Any:
        """Make joined results with the same fields `Results` again; NumPy drops the class of arrays that it joins."""
        result = super().__array_function__(function, kinds, arguments, options)
        whole = type(result) is np.ndarray and result.dtype.names == ROW.names
        return result.astype(self.dtype, copy=False).view(type(self)) if whole else result

    def __repr__(self) -> str:
        return f"<Results: {_in_a_line(self)}>" if self._is_whole else super().__repr__()

    def __str__(self) -> str:
        return _as_text(self) if self._is_whole else super().__str__()

    def _repr_html_(self) -> str | None:
        return f"<pre>{escape(str(self))}</pre>" if self._is_whole else None

    @property
    def _is_whole(self) -> bool:
        """Whether all fields are there; NumPy also gives some fields, or one with parts, as arrays of this class."""
        return self.dtype.names == ROW.names and self.ndim == 1


def columns(rows: Rows) -> dict[str, NDArray[Any]]:
    """Return all numbers of answers as columns by name, shape (n,) each: time [s], run, then those of all fields.

    Vectors become columns of their components, like `contact_point_x`. Rows with only some of the fields give the
    columns of these.

    Raises:
        UsageError: the stamp is not among the fields.
    """
    names = rows.dtype.names or ()
    if "stamp" not in names:
        reason = "stamp must be one of them, because it gives the time"
        raise UsageError(f"fields {', '.join(names)}: {reason}")
    found: dict[str, NDArray[Any]] = {TIME: _time_of(rows)}
    if "status" in names:
        found[RUN] = _run_of(rows)
    # A row with some fields keeps the places of all bytes.
    flat = np.asarray(rows).view(FLAT)
    places = [(at, at + kind.itemsize) for kind, at, *_ in (rows.dtype.fields or {}).values()]
    for name, (_, at, *_) in (FLAT.fields or {}).items():
        if any(begin <= at < end for begin, end in places):
            found[name] = np.ascontiguousarray(flat[name])
    return found


def attributes(
    parameters: Mapping[str, Any] | None, names: Collection[str] = (), package: str = ""
) -> dict[str, str]:
    """Return what a file of answers tells of itself: `package` with its version, and as JSON `parameters` and `units`.

    Parameters that are not known are left out; `units` are those of columns.
    """
    about = {"package": package or f"knee_contact_ros {__version__}"}
    if parameters is not None:
        about["parameters"] = json.dumps(dict(parameters))
    if names:
        about["units"] = json.dumps({name: unit_of(name) for name in names if unit_of(name)})
    return about


def answer_table(
    answers: Mapping[str, Rows],
    suffix: str,
    parameters: Mapping[str, Any] | None = None,
    package: str = "",
    with_units: bool = False,
) -> bytes:
    """Return answers by topic as the bytes of a .csv or .parquet file: the `columns` that the message has.

    Several topics follow each other; the first column then has their names. A Parquet file has the `attributes` of
    parameters and package; names in the header of a CSV file end `with_units`, as `load [N]`.
    """
    parts = [columns(rows) for rows in answers.values()]
    names = [name for name in parts[0] if name in (TIME, RUN, "stamp", *MESSAGE_FIELDS)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in names}
    if len(answers) > 1:
        topics = np.repeat(list(answers), [len(rows) for rows in answers.values()])
        whole = {"topic": topics, **whole}
    if suffix == _PARQUET:
        import pyarrow.parquet

        file = BytesIO()
        table = pyarrow.table(whole, metadata=attributes(parameters, [*whole], package))
        pyarrow.parquet.write_table(table, file)
        return file.getvalue()
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        f"{name} [{unit_of(name)}]" if with_units and unit_of(name) else name for name in whole
    )
    writer.writerows(zip(*(column.tolist() for column in whole.values()), strict=True))
    return text.getvalue().encode()


def unit_of(name: str) -> str:
    """Return the SI unit of a column; empty if it has none."""
    return "s" if name == TIME else FIELDS[name].unit if name in FIELDS else ""


def begin_of(first: int) -> int:
    """Return the stamp [ns] from which times are shown to people: the first stamp if it is a date, else 0."""
    return first if first >= FIRST_DATE else 0


def stamp_text(stamp: int, begin: int) -> str:
    """Write a stamp [ns] in seconds from a stamp `begin`, which is that of `begin_of`."""
    time = NANOSECOND * (stamp - begin)
    return f"{time:+.3f}" if begin else f"{time:.3f}"


def _time_of(rows: Rows) -> Floats:
    """Return the stamps in seconds, shape (n,)."""
    return np.asarray(np.asarray(rows["stamp"]) * NANOSECOND)


def _run_of(rows: Rows) -> Integers:
    """Return the number of the run of each answer, shape (n,); see `Results.run`."""
    resets = (np.asarray(rows["status"]) & Status.TIME_RESET) != 0
    resets[:1] = False
    return np.cumsum(resets)


def _begin_in(rows: Rows) -> int:
    """Return the stamp [ns] from which times of answers are shown to people, see `begin_of`; 0 without answers."""
    return begin_of(int(rows["stamp"][0])) if len(rows) else 0


def _library(name: str) -> Any:
    """Import a library of the extra `notebook`.

    Raises:
        UsageError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError:
        raise UsageError(not_installed(name.partition(".")[0], "notebook")) from None


def _in_a_line(rows: Rows) -> str:
    """Summarise answers in a line: number, duration and peaks."""
    if not len(rows):
        return "no ticks"
    ticks = "1 tick" if len(rows) == 1 else f"{len(rows)} ticks"
    time = _time_of(rows)
    duration = time[-1] - time[0]
    runs = _run_of(rows)
    of_runs = ""
    if runs[-1]:
        duration = np.diff(time)[np.diff(runs) == 0].sum()
        of_runs = f" in {runs[-1] + 1} runs"
    force = np.max(rows["contact_force"])
    depth = MM * np.max(rows["penetration_depth"])
    return f"{ticks} over {duration:.3f} s{of_runs}, at most {force:.1f} N and {depth:.3f} mm"


def _as_text(rows: Rows) -> str:
    """Write the table as text for a terminal."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in _HEADINGS:
        table.add_column(heading.replace("[", r"\["), justify="right")
    for cells in _cells(rows):
        table.add_row(*cells)
    text = StringIO()
    Console(file=text, width=_TABLE_WIDTH).print(table)
    lines = [_in_a_line(rows)]
    begin = _begin_in(rows)
    if begin:
        lines.append(f"time from {NANOSECOND * begin:.3f} s on")
    lines += [line.rstrip() for line in text.getvalue().splitlines()]
    return "\n".join(filter(None, lines))


def _cells(rows: Rows) -> list[tuple[str, ...]]:
    """Return the cells of the table: of all rows, or of those at both ends."""
    begin = _begin_in(rows)
    whole = np.asarray(rows)
    is_long = len(whole) > 2 * _SHOWN_ROWS + 1
    shown = [*whole[:_SHOWN_ROWS], *whole[-_SHOWN_ROWS:]] if is_long else whole
    cells: list[tuple[str, ...]] = [
        (
            stamp_text(int(row["stamp"]), begin),
            f"{np.degrees(row['flexion_angle']):.1f}",
            f"{row['load']:.1f}",
            f"{row['contact_force']:.1f}",
            f"{MM * row['penetration_depth']:.3f}",
            f"{MM * row['contact_point']['x']:.2f}",
            Status(int(row["status"])).name or str(row["status"]),
        )
        for row in shown
    ]
    if is_long:
        cells.insert(_SHOWN_ROWS, ("…",) * len(_HEADINGS))
    return cells


def _figure_of(rows: Rows) -> Any:
    """Draw flexion, load and contact force, depth, and the contact point on the plateau, as a matplotlib `Figure`.

    Raises:
        UsageError: a field in `_DRAWN` is not there.
    """
    names = rows.dtype.names or ()
    if lacking := [name for name in _DRAWN if name not in names]:
        raise UsageError(f"fields {', '.join(names)}: plot also needs {', '.join(lacking)}")
    matplotlib = _library("matplotlib")
    pyplot = _library("matplotlib.pyplot")
    begin = _begin_in(rows)
    time = NANOSECOND * (np.asarray(rows["stamp"]) - begin)
    along = MM * np.asarray(rows["contact_point"]["x"])
    marker = "o" if len(time) == 1 else None  # a single point makes no line
    figure, axes = pyplot.subplots(4, 1, sharex=True, figsize=_FIGURE_SIZE, layout="constrained")
    flexion, force, depth, point = axes
    flexion.plot(time, np.degrees(rows["flexion_angle"]), color="black", marker=marker)
    force.plot(time, rows["load"], color=_LOAD_COLOUR, linewidth=5.0, label="load", marker=marker)
    force.plot(
        time, rows["contact_force"], color=_FORCE_COLOUR, label="contact force", marker=marker
    )
    depth.plot(
        time, MM * np.asarray(rows["penetration_depth"]), color=_DEPTH_COLOUR, marker=marker
    )
    point.plot(time, along, color=_POINT_COLOUR, marker=marker)
    labels = "flexion [°]", "force [N]", "depth [mm]", "contact point,\nanterior [mm]"
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        axis.grid(visible=True, alpha=0.3)
        axis.margins(x=0.0)
    force.set_ylim(bottom=min(0.0, force.get_ylim()[0]))
    force.legend(loc="best", frameon=False)
    depth.set_ylim(bottom=0.0)
    if len(along) and np.ptp(along) < _MIN_POINT_RANGE:
        middle = along.mean()
        point.set_ylim(middle - _MIN_POINT_RANGE, middle + _MIN_POINT_RANGE)
    point.set_xlabel(f"time [s] from {NANOSECOND * begin:.3f} s on" if begin else "time [s]")
    figure.align_ylabels(axes)
    if "inline" in matplotlib.get_backend():
        # A notebook shows the result of a cell anyway, and would show the figure twice.
        pyplot.close(figure)
    return figure
