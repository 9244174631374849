"""What accuracy costs: a recorded gait at every level and tolerance, compared with the tightest tolerance.

The reference is the same model at `dynamic` and `REFERENCE_TOLERANCE`, so the errors are those of level and tolerance
alone. They do not show what the model leaves out; docs/explanation/accuracy.md compares it with other codes.
"""

import io
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..model.ticks import LEVELS
from ..model.types import Rows, Status
from ..results import Results
from ..system.errors import UsageError
from ..system.output_files import write_complete
from ..system.progress import OnProgress, no_progress
from ..system.terminal import as_json, print_json, say, show_table

TOLERANCES = tuple(float(f"1e-{exponent}") for exponent in range(3, 10))
"""Values of `fidelity.tolerance` [m] that are measured"""
MEASURED_LEVELS = ("quasi_static", "dynamic")
"""Values of `fidelity.level` that are measured"""
REFERENCE_TOLERANCE = 1e-12
"""Tolerance [m] of the reference"""
SECOND_TOLERANCE = 1e-11
"""Tolerance [m] of a second run: its difference shows how certain the reference is"""
LOAD_ERROR = 0.01
"""Relative error of a good measurement of the load"""
MAX_FLAGGED = 0.01
"""Largest fraction of ticks that a recommended setting may flag"""
REPEATS = 3
"""How often a run is timed; the fastest counts"""


class Setting(NamedTuple):
    """A level and a tolerance, with their errors and cost."""

    level: str
    tolerance: float
    """[m]"""
    depth: float
    """Largest error of the signed depth (penetration, or gap) at any tick [m]"""
    force: float
    """Largest error of the contact force [N]"""
    point: float
    """Largest distance of the contact point from the reference's while in contact [m]"""
    flagged: float
    """Fraction of ticks that are flagged `NOT_CONVERGED`"""
    evaluations: float
    """Contact law evaluations per tick"""
    microseconds: float
    """Processor time per tick [µs] of the compiled model, without messages"""


class Trade(NamedTuple):
    """All settings for a recording."""

    settings: list[Setting]
    ticks: int
    """Ticks of all compartments"""
    worth: float
    """Accuracy of the measured data [m]: smaller differences of the depth mean nothing"""
    reference_error: float
    """Largest difference of the depth [m] between the reference and the second run"""


def measure(
    results: Results,
    worth: float | None = None,
    advance: OnProgress = no_progress,
) -> Trade:
    """Compute the samples of `results` (of `solve`) again at every setting.

    `worth` [m] is the accuracy of the measured data; None: the change of depth that `LOAD_ERROR` of the load causes.

    Raises:
        UsageError: it is not known which model computed the results.
    """
    compartments = [results] if results.lateral is None else [results, results.lateral]
    total = len(MEASURED_LEVELS) * len(TOLERANCES) + 3
    done = 0

    def compute(level: str, tolerance: float, load: float = 1.0) -> tuple[Rows, float]:
        nonlocal done
        found = [compute_again(each, level, tolerance, load) for each in compartments]
        done += 1
        advance(done, total)
        return np.concatenate([rows for rows, _ in found]), sum(seconds for _, seconds in found)

    exact, _ = compute("dynamic", REFERENCE_TOLERANCE)

    def depth_error(rows: Rows) -> float:
        """Largest error of the depth, or of minus the gap."""
        errors = (rows[name] - exact[name] for name in ("penetration_depth", "gap"))
        return float(np.abs(np.subtract(*errors)).max())

    second, _ = compute("dynamic", SECOND_TOLERANCE)
    loaded, _ = compute("dynamic", REFERENCE_TOLERANCE, 1.0 + LOAD_ERROR)
    touching = exact["penetration_depth"] > 0.0
    settings = []
    for level, tolerance in product(MEASURED_LEVELS, TOLERANCES):
        rows, seconds = compute(level, tolerance)
        apart = [rows["contact_point"][axis] - exact["contact_point"][axis] for axis in ("x", "y")]
        settings.append(
            Setting(
                level,
                tolerance,
                depth_error(rows),
                float(np.abs(rows["contact_force"] - exact["contact_force"]).max()),
                float(np.hypot(*apart)[touching].max(initial=0.0)),
                float(np.mean((rows["status"] & Status.NOT_CONVERGED) != 0)),
                float(np.mean(rows["evaluations"])),
                1e6 * seconds / len(rows),
            )
        )
    worth = depth_error(loaded) if worth is None else worth
    return Trade(settings, len(exact), worth, depth_error(second))


def compute_again(
    samples: Results, level: str, tolerance: float, load: float
) -> tuple[Rows, float]:
    """Compute samples again with their load times `load`; return the answers and the processor time [s] of the run.

    Raises:
        UsageError: it is not known which model computed the samples.
    """
    if samples.model is None:
        raise UsageError("parameters changed during this recording; give --params FILE")
    fidelity: Any = {"level": LEVELS[level], "tolerance": tolerance, "force_tolerance": 0.0}
    model = replace(samples.model, compiled=True, **fidelity)
    starts = np.flatnonzero(samples["status"] & Status.TIME_RESET)
    parts = [part for part in np.split(np.asarray(samples), starts) if len(part)]
    seconds = []
    for _ in range(REPEATS + 1):  # the first run warms up
        begin = time.process_time()
        rows = [
            model.stream().advance_all(
                part["stamp"],
                part["flexion_angle"],
                load * part["load"],
                part["femoral_height"] if model.height_prescribed else None,
            )
            for part in parts
        ]
        seconds.append(time.process_time() - begin)
    return np.concatenate(rows), min(seconds[1:])


def advice(trade: Trade) -> str:
    """Recommend the good enough setting with the fewest evaluations; among equal ones the largest tolerance.

    The errors are those of the table; live, a tick is flagged where its estimated error exceeds the tolerance.
    """
    if not any(each.depth or each.force for each in trade.settings):
        return "Every setting gives the same depth and force, as with prescribed femoral heights: use any."
    worth = f"{1e6 * trade.worth:.2g} µm"
    good = [
        each
        for each in trade.settings
        if each.depth <= trade.worth and each.flagged <= MAX_FLAGGED
    ]
    if not good:
        return f"No setting flags at most 1 % of the ticks and has errors below those of your data ({worth})."
    best = min(good, key=lambda each: (each.evaluations, -each.tolerance))
    return (
        f"Take fidelity.level {best.level} with fidelity.tolerance {best.tolerance:g}: the cheapest setting whose "
        f"errors of the depth ({1e6 * best.depth:.2g} µm at most) are below those of your data ({worth}). Live, a tick "
        f"takes {best.microseconds:.2g} us of a processor like this one, and is flagged NOT_CONVERGED where its "
        f"estimated error exceeds {1e6 * best.tolerance:.2g} µm."
    )


def show_trade(trade: Trade, picture: Path) -> None:
    """Print a table with a row per setting, what its errors refer to, the advice, and where the picture is."""
    if as_json():
        print_json(**trade._asdict(), advice=advice(trade), files={"Picture": picture})
        return
    words = "level, tolerance, depth [m], force [N], point [m], flagged, calls, time [us]"
    headings = words.split(", ")
    rows = [
        (
            each.level,
            f"{each.tolerance:.0e}",
            f"{each.depth:.1e}",
            f"{each.force:.1e}",
            f"{each.point:.1e}",
            f"{1e2 * each.flagged:.1f} %",
            f"{each.evaluations:.1f}",
            f"{each.microseconds:.2f}",
        )
        for each in trade.settings
    ]
    say("Largest errors at any tick; calls of the contact law and processor time per tick")
    show_table(headings, rows, right=headings[1:], padding=0)
    say(
        f"{trade.ticks} ticks. The reference is the same model at a tolerance of {REFERENCE_TOLERANCE:g} m; a run at"
    )
    say(f"{SECOND_TOLERANCE:g} m differs from it by {trade.reference_error:.1e} m at most.")
    say(advice(trade), hang=0)
    say(f"Picture: {picture}")


def draw_trade(trade: Trade, path: Path) -> None:
    """Draw errors and cost over the tolerance, a line per level, and write the picture as PNG.

    Raises:
        UsageError: it cannot be written; an earlier picture is kept then.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    panels = (
        ("depth", "largest error of the depth [m]"),
        ("force", "largest error of the contact force [N]"),
        ("point", "largest error of the contact point [m]"),
        ("microseconds", "processor time per tick [µs]"),
    )
    for axis, (name, title) in zip(
        figure.subplots(2, 2, sharex=True).ravel(), panels, strict=True
    ):
        for level, colour in zip(MEASURED_LEVELS, ("#e69f00", "#0072b2"), strict=True):
            own = [each for each in trade.settings if each.level == level]
            values = np.array([getattr(each, name) for each in own])
            axis.plot(TOLERANCES, values, "o-", color=colour, linewidth=1.8, label=level)
            hollow = [each.flagged > MAX_FLAGGED for each in own]
            axis.plot(
                np.array(TOLERANCES)[hollow],
                values[hollow],
                "o",
                color=colour,
                markerfacecolor="white",
            )
        axis.set(xscale="log", title=title, xlim=(2.0 * TOLERANCES[0], 0.5 * TOLERANCES[-1]))
        if name == "depth":
            axis.plot(
                TOLERANCES,
                TOLERANCES,
                color="0.6",
                linestyle=":",
                label="as large as the tolerance",
            )
            axis.axhline(
                trade.worth, color="#009e73", linestyle="--", label="what the data are worth"
            )
        if name == "microseconds":
            axis.set_ylim(bottom=0.0)
        elif any(getattr(each, name) > 0.0 for each in trade.settings):
            axis.set_yscale("log")
        else:
            axis.text(0.5, 0.6, "0 at every setting", transform=axis.transAxes, ha="center")
        axis.legend(
            fontsize=9, frameon=False, loc="upper left" if name == "microseconds" else "lower left"
        )
        axis.grid(visible=True, color="0.92")
    figure.supxlabel("fidelity.tolerance [m]; hollow: more than 1 % of the ticks are flagged")
    file = io.BytesIO()
    figure.savefig(file, dpi=120, format="png")
    write_complete({path: file.getvalue()})
