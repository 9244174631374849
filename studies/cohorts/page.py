"""The page: what was timed, the search that chose it, and how the tools were used."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from benchmarks.report import Section, machine
from studies.cohorts.measure import CORES, Timed
from studies.cohorts.method import STEPS
from studies.cohorts.ours import PROMISED
from studies.cohorts.ours import TOOL as OUR_TOOL
from studies.cohorts.peers import OURS, PEERS
from studies.cohorts.problem import SPREAD, Floats
from studies.cohorts.search import LIMIT, Setting

TARGET = 20.0
"""Times quicker than the quickest peer (issue 22)"""
TITLE = "Cohorts: many knees in one run"
TEXT = f"""
Knees like the healthy one, a circle on a plane with Kelvin and Voigt's law, whose stiffness, damping and mass are drawn
evenly within {SPREAD:.0%}, under the recorded gait of the right leg (387 ticks at 200 Hz, the load linear between them,
so that every tick begins with a kink). Every tool solves the same equation from the same start and hands back the depth
at every tick; the largest error is that of all ticks of all knees that it ran, against the independent reference in C
(`studies/reference`), which is sure of its depths to 1e-12 m.

Every method has the loosest setting with which that error is at most {LIMIT:.0e} m: a relative tolerance in quarters of
a decade (the absolute ones are 1e-3 m and 0.1 m/s times it), or a number of equal steps per tick without error control.
To find it takes the reference, which a user has not: for us too, but for the row "as promised", whose tolerance is
{PROMISED:.0e} m. The last table has the whole search.

Times are medians of {{rounds}} rounds, in each of which every row runs once on one core and once on two, in turns. Two
cores are two threads of the compiled loop for CyRK and numbalsoda, and two processes with half of the knees each for
the others; the clock runs from the first process's begin to the last one's end, and nothing is sent between them
meanwhile. Set-up, imports and compilation are not in it. Times are in µs. On one core the processor time is what
counts: other work on this machine disturbs it least. On two cores there is the clock alone. The ratio is the median
of the rounds' ratios to the quickest row of ours that meets the limit. SciPy's loop runs {{few}} of the knees, each of
which takes as long as any other.
"""
HEADER = (
    "tool", "method", "setting", "largest error [m]", "processor, per knee", "per knee and tick", "over ours",
    "1 core, per knee", "2 cores, per knee", "2 cores, per knee and tick", "2 cores, over ours",
)  # fmt: skip


def measured_on() -> str:
    """Machine, versions of the tools, and what else the machine did."""
    names = ("numpy", "scipy", "numba", "CyRK", "numbalsoda", "diffrax", "jax")
    return machine(*names)


def sections(
    measured: Sequence[Sequence[Timed]], settings: Sequence[Setting], ticks: int, rounds: int
) -> list[Section]:
    """All sections of the page."""
    few = min(one.cases for one in measured[-1])
    tables = [_table(each, ticks) for each in measured]
    first = []
    for tool in dict.fromkeys(one.finalist.method.tool for one in measured[-1]):
        set_up = max(one.set_up for one in measured[-1] if one.finalist.method.tool == tool)
        compiling = max(one.first for one in settings if one.key.startswith(f"{tool}: "))
        first.append((tool, f"{set_up:.2f}", f"{compiling:.2f}"))
    return [
        Section("", TEXT.strip().format(rounds=rounds, few=few), (), ()),
        *tables,
        Section(
            "How the tools are used",
            "All right-hand sides clamp the force at 0. Compiled ones compute d^1.5 as d sqrt(d) and find the load of "
            "an instant by its index, without a search; those that begin anew in every tick are given the load's ramp.",
            ("tool", "version", "how"),
            [(peer.name, peer.version, peer.how) for peer in (OURS, *PEERS)],
        ),
        Section(
            "Before the first run",
            "The longest of a tool's methods [s]: set-up for the largest cohort (for us the building of the models), "
            "and processor time of the very first run with a few knees, in which Numba and XLA compile (ours is loaded "
            "from what this machine has compiled before).",
            ("tool", "set-up", "first run"),
            first,
        ),
        Section(
            "The search",
            "Every method on one core with fewer knees, one after the other: the least processor time of two runs, by "
            "which the finalists were picked, the two quickest of a tool with error control and the two without it.",
            ("method", "setting", "largest error [m]", "processor, per knee and tick"),
            [
                (one.key, _setting(one.value), f"{one.error:.1e}",
                 "given up" if math.isnan(one.per_tick) else f"{one.per_tick * 1e6:.3g}")
                for one in settings
            ],
        ),
    ]  # fmt: skip


def _setting(value: float) -> str:
    if math.isnan(value):
        return "none found"
    return f"{value:.0f} per tick" if value >= 1.0 else f"{value:.1e}"


def _table(measured: Sequence[Timed], ticks: int) -> Section:
    """The table of one size of the cohort, under its verdict."""
    ours = _quickest([one for one in measured if one.finalist.method.tool == OUR_TOOL])
    peers = [one for one in measured if one.finalist.peer != OURS and one.error <= LIMIT]
    rows = []
    for one in measured:
        processor, *clock = (float(np.median(times)) * 1e6 for times in (one.processor, *one.times.values()))
        rows.append((
            one.finalist.method.tool, one.finalist.method.name, _setting(one.value), f"{one.error:.1e}",
            f"{processor:.3g}", f"{processor / ticks:.3g}", f"{_ratio(_times(one, 1), _times(ours, 1)):.2g}x",
            *(f"{each:.3g}" for each in clock), f"{clock[1] / ticks:.3g}",
            f"{_ratio(_times(one, 2), _times(ours, 2)):.2g}x",
        ))  # fmt: skip
    rows += [(peer.name, "not installed", *[""] * 9) for peer in PEERS if not peer.installed]
    words = [_verdict(cores, peers, ours) for cores in CORES] if peers else ["No peer was measured."]
    return Section(f"{max(one.cases for one in measured)} knees", " ".join(words), HEADER, rows)


def _times(one: Timed, cores: int) -> Floats:
    """Times [s] that count: the processor's on one core, the clock's on several."""
    return one.processor if cores == 1 else one.times[cores]


def _quickest(measured: Sequence[Timed], cores: int = 1) -> Timed:
    return min(measured, key=lambda one: float(np.median(_times(one, cores))))


def _ratio(times: Floats, ours: Floats) -> float:
    return float(np.median(times / ours))


def _verdict(cores: int, peers: Sequence[Timed], ours: Timed) -> str:
    """How far the target is, against the quickest peer and against the quickest with error control."""
    best = _quickest(peers, cores)
    ratio = _ratio(_times(best, cores), _times(ours, cores))
    met = "met" if ratio >= TARGET else "not met"
    where = f"On {cores} core{'s' if cores > 1 else ''}"
    sentence = (
        f"{where} the quickest peer ({best.finalist.method.key}) takes {ratio:.2g}x our time: {TARGET:.0f}x is {met}."
    )
    controlled = [one for one in peers if one.finalist.method.control != STEPS]
    if not controlled:
        return sentence
    best = _quickest(controlled, cores)
    ratio = _ratio(_times(best, cores), _times(ours, cores))
    return f"{sentence} The quickest with error control ({best.finalist.method.key}): {ratio:.2g}x."
