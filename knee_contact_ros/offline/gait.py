"""Strides and gait cycles of answers, as tables for notebooks: what `solve` and the models of `load_model` return."""

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from ..model.types import NANOSECOND
from ..results import Results, columns, unit_of
from ..streams.gait_events import GaitEvent
from ..streams.strides import Span, Stride, at_stamps, rows_of, strides_of
from ..system.arguments import checked
from ..system.errors import UsageError
from ..system.files import require

STRIDE_UNITS = {
    "heel_strike": "s",
    "toe_off": "s",
    "duration": "s",
    "stance": "%",
    "peak_force": "N",
    "peak_depth": "m",
    "impulse": "N s",
    "stance_impulse": "N s",
    "loading_rate": "N/s",
    "usable": "",
    "sliding_distance": "m",
    "ringing": "N",
}
"""Columns of the table of strides, with their units"""


class Gait(Results):
    """`Results` of a gait, with a table of its strides and curves over the gait cycle or over stance.

    Example:
        >>> from knee_contact_ros import solve
        >>> gait = solve("bags/gait2354_right")
        >>> gait.strides()[["duration", "peak_force"]].round(2).to_dict("records")
        [{'duration': 1.23, 'peak_force': 1557.13}]
    """

    gait_events: Sequence[GaitEvent] = ()
    """Heel strikes and toe-offs that an importer read; where there are none, they are found from angle and load"""

    def __array_finalize__(self, whole: Any) -> None:
        """Keep the events of the array that this one is part of."""
        super().__array_finalize__(whole)
        self.gait_events = getattr(whole, "gait_events", ())

    @checked
    def strides(self, body_weight: float | None = None) -> Any:  # type: ignore[override]
        """Return a `pandas.DataFrame` with a row for each whole stride; `attrs["units"]` has the units of its columns.

        The columns are heel strike, toe-off and duration [s], stance [%], and the numbers of `Stride`. Under a law that
        is hardly damped `peak_force` and `loading_rate` contain `ringing` [N]. Heel strikes and toe-offs that an
        importer read are in `gait_events`; others are found from angle and load. (NumPy's attribute of the name
        `strides`, of the memory, is that of `np.asarray(gait)`.)

        Args:
            body_weight: [N]; None: that of the parameters, which answers of `solve` know.

        Raises:
            UsageError: the body weight is not known, or pandas is not installed.

        Example:
            >>> from knee_contact_ros import solve
            >>> solve("bags/gait2354_right").strides()["duration"].round(2).tolist()
            [1.23]
        """
        pandas = _pandas()
        rows = [
            {
                "heel_strike": NANOSECOND * each.span.start,
                "toe_off": NANOSECOND * each.span.toe_off,
                "duration": each.span.duration,
                "stance": each.span.stance,
                **{name: value for name, value in each._asdict().items() if name != "span"},
            }
            for each in self._found(body_weight)
        ]
        table = pandas.DataFrame(rows, columns=[*STRIDE_UNITS])
        table.index.name = "stride"
        table.attrs["units"] = STRIDE_UNITS
        return table

    @checked
    def cycles(
        self, points: int = 101, *, of: str = "cycle", body_weight: float | None = None
    ) -> Any:
        """Return the curves of all strides at equal parts of the gait cycle, or of stance, as a `pandas.DataFrame`.

        Its index is (stride, percent), with `points` rows a stride from 0 to 100 %. Its columns are those of
        `to_pandas`, in SI units, interpolated between ticks; `attrs["units"]` has their units.
        `cycles().groupby("percent").mean()` is the mean curve.

        Args:
            points: Number of points, at least 2; 101 is one for each percent.
            of: `cycle`, from heel strike to the next one, or `stance`, from heel strike to toe-off.
            body_weight: As for `strides`.

        Raises:
            UsageError: as for `strides`; or an argument is not allowed.

        Example:
            >>> from knee_contact_ros import solve
            >>> len(solve("bags/gait2354_right").cycles(11, of="stance"))
            11
        """
        pandas = _pandas()
        if points < 2 or of not in ("cycle", "stance"):
            raise UsageError(
                f"cycles: points {points}, of {of!r} is not allowed; at least 2 points of cycle or stance"
            )
        percent = np.linspace(0.0, 100.0, points)
        numbers = columns(self)
        stamps = numbers.pop("stamp")
        values = np.column_stack([*numbers.values(), numbers["status"]]).astype(float)
        parts = []
        for number, stride in enumerate(self._found(body_weight)):
            at = _places(stride.span, of, percent)
            around = rows_of(stride.span, stamps)
            part = pandas.DataFrame(
                at_stamps(stamps[around], values[around], at)[:, :-1], columns=[*numbers]
            )
            index = [np.full(points, number), percent]
            parts.append(part.set_index(pandas.MultiIndex.from_arrays(index, names=_INDEX)))
        empty = pandas.DataFrame(
            columns=[*numbers], index=pandas.MultiIndex.from_arrays([[], []], names=_INDEX)
        )
        table = pandas.concat(parts) if parts else empty
        table = table.drop(columns=[name for name in _NO_CURVES if name in table])
        table.attrs["units"] = {name: unit_of(name) for name in table}
        return table

    def _found(self, body_weight: float | None) -> list[Stride]:
        """Find the strides.

        Raises:
            UsageError: the body weight is not known.
        """
        weight = body_weight or (self.parameters or {}).get("body_weight")
        if weight is None:
            raise UsageError(
                "body_weight [N] is needed: these answers do not know their parameters"
            )
        return strides_of(self, float(weight))


_INDEX: Sequence[str] = ("stride", "percent")
_NO_CURVES = ("run", "contact_state", "fidelity", "status", "evaluations", "latency")
"""Columns that cannot be interpolated"""


def _places(span: Span, of: str, percent: Any) -> Any:
    """Return stamps [ns] at parts [%] of a stride or of its stance."""
    end = span.end if of == "cycle" else span.toe_off
    return span.start + np.round((end - span.start) * percent / 100.0).astype(np.int64)


def _pandas() -> Any:
    require("notebook", "pandas")
    return import_module("pandas")
