"""numbalsoda: LSODA in C++ and DOP853 in Fortran, inside a loop compiled by Numba."""

from __future__ import annotations

from benchmarks.peers.compiled import in_series, in_tick
from benchmarks.peers.numbalsoda import METHODS, advance, callback, equal_steps, series
from studies.cohorts.method import Method
from studies.cohorts.peers.compiled_loop import described, tick_by_tick, whole_series

TOOL = "numbalsoda"


def methods() -> list[Method]:
    """List both solvers, over the series and anew in every tick; DOP853 with equal steps too."""
    over_series, over_tick = callback(in_series).address, callback(in_tick).address
    loops = {"whole series": whole_series(series, over_series), "tick by tick": tick_by_tick(advance, over_tick)}
    found = [described(TOOL, f"{solver}, {how}", loop, number)
             for number, solver in enumerate(METHODS) for how, loop in loops.items()]  # fmt: skip
    return [*found, described(TOOL, "DOP853, equal steps", whole_series(equal_steps, over_series), 1)]
