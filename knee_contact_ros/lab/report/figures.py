"""Figures of a report: over the gait cycle with published ranges, over time, the knee at the peaks, uncertainty.

Every published range was read in the source that the page names with it (`report.html.jinja`).
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab.report.runs import CURVES, FIRST, PERCENT, SECOND, Quantity, Run
from knee_contact_ros.lab.uncertainty import LEVEL
from knee_contact_ros.model.readouts import OWN_PRESSURE
from knee_contact_ros.model.types import MM, Floats
from knee_contact_ros.parameters.schema import Parameters, has_two_compartments
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF
from knee_contact_ros.streams.topics import NANOSECONDS, is_lateral
from knee_contact_ros.view import picture

MICRO = 1e6
HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7B3294", "#66C2A5")
"""Colours of runs and of uncertain inputs, by Okabe and Ito: colour-blind readers can distinguish them"""
DPI = 200
LINE, LETTERS = 0.19, 50
"""Height of a legend line [in], and its number of letters"""
WIDTH, CYCLE, TIME, UNCERTAIN = 4.4, 2.9, 5.2, 6.0
"""Width of a figure, and heights of figures over a cycle (without legend), over time and of uncertainty [in]: small, so
that text stays readable on a phone"""
KNEE = 3.0
"""Height of a knee [in]"""
LEAST_WAY = 0.01
"""Smallest motion of the contact point [mm] for which it is drawn"""
FEW, FEW_EVENTS, FEW_POINTS = 12, 60, 20
"""Largest numbers of single cycles drawn and of gait events marked, as more cannot be distinguished; and the number of
points below which each one is marked, as a line alone may be invisible"""
MARKS = {
    HEEL_STRIKE: {"color": "0.25", "linestyle": "-"},
    TOE_OFF: {"color": "0.25", "linestyle": ":"},
}
BONE: Any = {"color": "0.35", "linestyle": ":", "linewidth": 1.2}
"""Line of the depth where bone begins"""
AROUND, LEAST = 1.0, 1e-3
"""Time [s] that a figure of uncertainty shows on either side of the largest load or contact force, and the smallest
deviation of the depth in it [µm]"""
ALL_OF_THEM, NUMERICAL = "all of them together", "numerical error (bound)"
CARTILAGE_THICKNESS = 3.0
"""Thickness of resting cartilage [mm] that the range of depths assumes, as the model's paper does"""


class Range(NamedTuple):
    """Published range of the peak of a force or depth."""

    what: str
    """What was measured or computed, and in which people"""
    lowest: float
    """Lower end [BW] for a force, [mm] for a depth; equal to `highest` where the source has a single number"""
    highest: float
    window: tuple[float, float]
    """Part of the gait cycle [%] over which the range is drawn; the sources give no times"""
    sources: tuple[int, ...]
    """Numbers of the sources on the page"""

    @property
    def text(self) -> str:
        """Text for a legend of the report."""
        return f"{self.what} [{', '.join(map(str, self.sources))}]"


FIRST_PEAK, SECOND_PEAK, STANCE = (8.0, 24.0), (38.0, 54.0), (8.0, 54.0)
"""Percent of the gait cycle in which the peaks of stance are expected"""
TOTAL = (
    Range("total, in vivo, knee implants: 2.5–2.8 BW", 2.5, 2.8, STANCE, (2,)),
    Range("total, in vivo, knee implants: mean 2.61 BW", 2.61, 2.61, STANCE, (1,)),
)
COMPUTED = (
    Range("computed, healthy people: 1.8–2, 2–2.3 BW", 1.8, 2.0, FIRST_PEAK, (4,)),
    Range("computed, healthy people: 1.8–2, 2–2.3 BW", 2.0, 2.3, SECOND_PEAK, (4,)),
)
"""Computed ranges of the first and the second peak, with which the model's paper compares its own results"""
MEDIAL = (
    Range(
        "60–80 % of the total in vivo (knee implants: 2.5–2.8 BW)",
        0.6 * 2.5,
        0.8 * 2.8,
        STANCE,
        (2, 3),
    ),
    *COMPUTED,
)
DEPTH = Range(
    f"in vivo, MRI and fluoroscopy: 7–23 % of {CARTILAGE_THICKNESS:g} mm",
    0.07 * CARTILAGE_THICKNESS,
    0.23 * CARTILAGE_THICKNESS,
    (0.0, 100.0),
    (5,),
)


class Figure(NamedTuple):
    """Picture of the report with its title and caption."""

    name: str
    """Name of the picture's file, without the suffix"""
    title: str
    caption: str
    """One or two sentences below the picture"""
    png: bytes
    """The picture in PNG format"""


FLEXION, FORCE, DEPTHS, POINT, PRESSURE, PATCH = (
    CURVES[name]
    for name in (
        "flexion_angle_deg",
        "contact_force_BW",
        "penetration_depth_mm",
        "contact_point_x_mm",
        "peak_pressure_MPa",
        "patch_half_width_mm",
    )
)


def cycles_of(run: Run, what: Quantity) -> Floats:
    """Values of all cycles of a run, in the unit of the axis, shape (cycles, 101)."""
    return np.asarray(what.scaled(run.gathered.curves[what.field], run.weight))


@contextmanager
def drawn(into: list[Figure], name: str, title: str, caption: str, height: float) -> Iterator[Any]:
    """Yield a matplotlib figure of a height [in] to draw on, then add it to the other figures as PNG."""
    file = io.BytesIO()
    with picture.png_figure(
        file, (WIDTH, height), DPI, **picture.CURVES_STYLE | {"figure.dpi": DPI}
    ) as canvas:
        yield canvas
    into.append(Figure(name, title, caption, file.getvalue()))


def with_comparisons(runs: Sequence[Run]) -> list[list[Run]]:
    """Group runs: each run of its own, followed by its comparisons."""
    bases = [place for place, run in enumerate(runs) if run.beside is None]
    return [[runs[place], *(other for other in runs if other.beside == place)] for place in bases]


def is_total(parameters: Parameters) -> bool:
    """Whether the load is that of the whole joint, not of one compartment."""
    whole = parameters.load.rule == "fixed_share" and parameters.load.share == 1.0
    return whole or parameters.load.compartment == "total"


def which_load(parameters: Parameters) -> str:
    """Describe the load of a run by its parameters, for the page and its tables."""
    if is_total(parameters):
        return "total: the whole axial joint reaction"
    parts = {
        "moment_balance": "what balances the frontal moment of the joint reaction",
        "measured_share": f"the share of the axial joint reaction that {parameters.load.share_file} has",
        "fixed_share": f"{parameters.load.share:g} of the axial joint reaction",
    }
    lateral = "; lateral: the rest" if has_two_compartments(parameters) else ""
    return f"medial compartment: {parts[parameters.load.rule]}{lateral}"


def pressure_of(run: Run) -> str:
    """Describe how the pressure of a run follows from its contact law, for a caption or a table cell."""
    patch = run.model.patch if run.model else None
    if patch is None:
        return "not known"
    spread = f"{patch.spread.name}, R {MM * patch.radius:.1f} mm, cartilage {MM * patch.thickness:.2g} mm"
    own = run.parameters.contact.law in OWN_PRESSURE
    return spread if own else f"the law defines none; its force at rest is distributed as {spread}"


def moves(cyclic: Sequence[Run]) -> bool:
    """Whether the contact point moves along the plateau in any of the runs."""
    return any(float(np.ptp(cycles_of(run, POINT).mean(axis=0))) > LEAST_WAY for run in cyclic)


def over_cycle(runs: Sequence[Run], cyclic: Sequence[Run]) -> list[Figure]:
    """Draw all figures over percent of the gait cycle; `cyclic` are the `runs` with gait cycles."""
    laws = dict.fromkeys(f"{run.parameters.contact.law}: {pressure_of(run)}" for run in cyclic)
    ranges = "; ".join(dict.fromkeys(each.text for each in _ranges_of(cyclic)))
    captions = {
        FORCE: f"Grey, published{' of the medial compartment' * (_ranges_of(cyclic) == MEDIAL)}: {ranges}. They are "
        "peaks, drawn where peaks are expected; the sources give no curve."
        if ranges
        else "No published range is drawn: some of the runs are of the whole joint, and some of one compartment.",
        DEPTHS: f"Grey: peak deformations in vivo, {DEPTH.lowest:.2f} to {DEPTH.highest:.2f} mm if the cartilage is "
        f"{CARTILAGE_THICKNESS:g} mm thick. A depth here follows from the contact law and the force; it is not a "
        f"measured deformation.{' Dotted: where bone, the second layer, begins.' * any(r.has_bone for r in cyclic)}",
        FLEXION: "",
        PRESSURE: f"In the middle of the patch. {'; '.join(laws)}.",
        PATCH: "Of a round patch, from the depth and the radii of the law.",
        POINT: "Position along the tibial plateau, from the tibia frame's origin, anterior positive.",
    }
    several = any(len(run.gathered.spans) > 1 for run in cyclic)
    lines = (
        "Thick: mean over the cycles, with one standard deviation; thin: single ones. " * several
    )
    figures = list[Figure]()
    for what, caption in captions.items():
        known = [
            run for run in cyclic if what is not FLEXION or run.beside is None
        ]  # comparisons: the same inputs
        known = [
            run for run in known if np.isfinite(cycles_of(run, what)).any()
        ]  # earlier recordings lack some fields
        if known and (what is not POINT or moves(known)):
            with drawn(
                figures, what.figure, f"{what.title} over the gait cycle", lines + caption, CYCLE
            ) as canvas:
                _panel(canvas, runs, known, what)
    return figures


def over_time(runs: Sequence[Run]) -> list[Figure]:
    """Draw flexion, contact force and depth over time, in a figure for every run and its comparisons."""
    figures = list[Figure]()
    for number, group in enumerate(with_comparisons(runs), start=1):
        events = group[0].gathered.events
        marks = events[events["event"].isin(list(MARKS))]
        marks = marks if len(marks) <= FEW_EVENTS else marks[:0]
        caption = "Vertical lines: heel strikes (full) and toe-offs (dotted), as found." * bool(
            len(marks)
        )
        with drawn(
            figures, f"over_time_{number}", f"{group[0].name} over time", caption, TIME
        ) as canvas:
            axes = canvas.subplots(3, 1, sharex=True)
            for axis, what in zip(axes, (FLEXION, FORCE, DEPTHS), strict=True):
                for run in group[:1] if what is FLEXION else group:  # flexion: the same inputs
                    time, look = run.gathered.elapsed / NANOSECONDS, _look(runs, run)
                    look |= {
                        "linewidth": 0.7 * look["linewidth"],
                        "marker": "." if len(time) < FEW_POINTS else None,
                    }
                    axis.plot(
                        time,
                        what.scaled(run.gathered.columns[what.field], run.weight),
                        **look,
                        label=_plain(run.label),
                    )
                    if what is DEPTHS and run.has_bone:
                        axis.axhline(MM * run.parameters.contact.layer_depth, **BONE)
                for begin, kind in zip(marks["time_s"], marks["event"], strict=True):
                    axis.axvline(begin, linewidth=0.9, zorder=1.5, **MARKS[kind])
                axis.set_ylabel(f"{what.title.lower()} [{what.unit}]".removeprefix("penetration "))
            axes[-1].set_xlabel("time since the first tick [s]")
            if len(group) > 1:
                canvas.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center")
    return figures


def knees(runs: Sequence[Run]) -> list[Figure]:
    """Draw the knee at its peaks, for every run and comparison with known surfaces."""
    figures = list[Figure]()
    caption = (
        "Side view; the arrow is the contact force on the femur. Dark is where the surfaces would overlap if "
        f"neither gave way, its depth drawn × {picture.MAGNIFICATION:g}. The surfaces that touch are the model's; "
        "the shafts are drawn around them, and so is cartilage whose thickness the contact law does not know."
    )
    for number, group in enumerate(with_comparisons(runs), start=1):
        if not all(run.model for run in group):
            continue
        titles = [title for title, _ in _drawn_peaks(group[0])]
        name, height = f"The knee at the peaks: {group[0].name}", KNEE * len(group)
        with drawn(figures, f"knee_{number}", name, caption, height) as canvas:
            for row, run in zip(
                canvas.subplots(len(group), len(titles), squeeze=False), group, strict=True
            ):
                for axis, title, (_, tick) in zip(row, titles, _drawn_peaks(run), strict=True):
                    fields = ("flexion_angle", "femoral_height", "contact_force")
                    angle, place, force = (
                        float(run.gathered.columns[name][tick]) for name in fields
                    )
                    if run.model:  # as all have
                        picture.draw_knee(axis, run.model, angle, place, force, run.weight)
                    label = f"{_plain(run.label)}\n" if len(group) > 1 else ""
                    axis.set_title(
                        f"{label}{title}\n{math.degrees(angle):.0f}° of flexion", fontsize=9.5
                    )
    return figures


def _drawn_peaks(run: Run) -> list[tuple[str, int]]:
    """Titles and ticks of the largest first and second peak of stance; without peaks, of the largest load or force."""
    peaks, of = [], run.gathered
    for which in (FIRST, SECOND):
        same = of.peaks[of.peaks["peak"] == which]
        if len(same):
            largest = same.loc[same["load_N"].idxmax()]
            peaks.append(
                (
                    f"{which} peak, {largest['gait_cycle_percent']:.0f} % of the cycle",
                    int(largest["tick"]),
                )
            )
    what, time = of.driving.replace("_", " "), of.elapsed[of.largest] / NANOSECONDS
    return peaks or [(f"largest {what}, {time:.2f} s", of.largest)]


def uncertainty(runs: Sequence[Run]) -> list[Figure]:
    """Draw depth, force and the effects of uncertain inputs around the largest load or force, for every run."""
    figures = list[Figure]()
    caption = (
        f"Depth and contact force with their {100.0 * LEVEL:.0f} % intervals. Below: what one standard "
        "deviation of each input does to the depth alone, all together, and the bound of the numerical error."
    )
    for number, (run, of) in enumerate(
        ((run, run.uncertain) for run in runs if run.uncertain), start=1
    ):
        since = (of.rows["stamp"] - of.rows["stamp"][0]) / NANOSECONDS
        shown = np.abs(since - since[int(of.rows[run.gathered.driving].argmax())]) <= AROUND
        name = f"uncertainty_{number}"
        with drawn(figures, name, f"Uncertainty: {run.label}", caption, UNCERTAIN) as canvas:
            time, (above, middle, below) = since[shown], canvas.subplots(3, 1, sharex=True)
            bands = (
                (above, of.depth_interval(), of.rows["penetration_depth"], MM, "depth [mm]"),
                (middle, of.force_interval(), of.rows["contact_force"], 1.0, "contact force [N]"),
            )
            for axis, edges, values, unit, text in bands:
                low, high = (unit * edge[shown] for edge in edges)
                axis.fill_between(time, low, high, color=HUES[0], alpha=0.25, linewidth=0)
                axis.plot(time, unit * values[shown], color=HUES[0], linewidth=1.8)
                axis.set(ylabel=text, ylim=(min(0.0, float(low.min())), None))
            effects: list[tuple[Any, str, Any]] = [
                (
                    part,
                    f"{each.name}, {each.text}",
                    {"color": HUES[place % len(HUES)], "linewidth": 1.4},
                )
                for place, (each, (part, _)) in enumerate(of.parts.items())
                if MICRO * np.abs(part[shown]).max() > LEAST
            ]
            effects += [  # all of them under the others
                (of.depth, ALL_OF_THEM, {"color": "black", "linewidth": 3.0, "zorder": 1.5}),
                (
                    of.rows["error_estimate"],
                    NUMERICAL,
                    {"color": "0.35", "linewidth": 1.6, "linestyle": ":"},
                ),
            ]
            for effect, label, look in effects:
                below.plot(
                    time, np.maximum(MICRO * np.abs(effect[shown]), LEAST), label=label, **look
                )
            below.set(
                yscale="log",
                ylabel="effect on the depth [µm]",
                xlabel="time since the first tick [s]",
            )
            _legend(canvas, below)
    return figures


def _ranges_of(cyclic: Sequence[Run]) -> tuple[Range, ...]:
    """Published ranges to show behind contact forces; none if whole joints and single compartments are mixed."""
    kinds = {is_total(run.parameters) for run in cyclic if not is_lateral(run.topic)}
    return () if len(kinds) != 1 else TOTAL if kinds.pop() else MEDIAL


def _look(runs: Sequence[Run], run: Run) -> dict[str, Any]:
    """Colour, style and width of a run's line; later lines are thinner, so that earlier ones stay visible."""
    place = runs.index(run)
    style = ("-", max(3.4 - 0.6 * place, 1.2)) if run.beside is None else ("--", 1.4)
    return {"color": HUES[place % len(HUES)], "linestyle": style[0], "linewidth": style[1]}


def _legend(canvas: Any, axis: Any) -> None:
    """Add a legend below the axes, each text once, and make the figure taller by the legend's height."""
    handles, labels = axis.get_legend_handles_labels()
    once = {
        textwrap.fill(label, LETTERS): handle
        for label, handle in zip(labels, handles, strict=True)
    }
    columns = 2 if len(once) > 3 and max(map(len, once)) <= LETTERS // 2 else 1
    canvas.legend(once.values(), once.keys(), loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    lines = -(-sum(1 + label.count("\n") for label in once) // columns)
    canvas.set_size_inches(width, height + LINE * lines)


def _plain(label: str) -> str:
    """Escape a label for matplotlib, where a dollar begins a formula and a leading underscore hides the entry."""
    escaped = label.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def _panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run], what: Quantity) -> None:
    """Draw a quantity of the runs `cyclic` over the gait cycle; `runs` are all runs, which set the colours."""
    axis = canvas.subplots()
    for each in _ranges_of(cyclic) if what is FORCE else (DEPTH,) if what is DEPTHS else ():
        edge: Any = (
            {"edgecolor": "0.5", "linewidth": 3.0}
            if each.lowest == each.highest
            else {"edgecolor": "none"}
        )
        shade: Any = {"facecolor": "0.85", "zorder": 0, "alpha": 0.6} | edge
        axis.fill_between(each.window, each.lowest, each.highest, label=each.text, **shade)
    for layer in sorted(
        {run.parameters.contact.layer_depth for run in cyclic if what is DEPTHS and run.has_bone}
    ):
        axis.axhline(MM * layer, **BONE)
        axis.annotate(
            f"bone from {MM * layer:g} mm",
            (99.0, MM * layer),
            ha="right",
            va="bottom",
            fontsize=8.5,
        )
    for run in cyclic:
        values, look = cycles_of(run, what), _look(runs, run)
        mean = values.mean(axis=0)
        if len(values) > 1:
            spread = values.std(axis=0, ddof=1)
            axis.fill_between(
                PERCENT, mean - spread, mean + spread, color=look["color"], alpha=0.15, linewidth=0
            )
            axis.plot(PERCENT, values[:FEW].T, **look | {"linewidth": 0.5, "alpha": 0.5})
        axis.plot(PERCENT, mean, **look, label=_plain(run.label))
    stances = list(
        {run.gathered.strides["stance_percent"].mean() for run in cyclic}
    )  # a comparison's is the same
    for stance in stances:
        axis.axvline(stance, color="0.45", linewidth=1.0, linestyle=(0, (1, 2)), zorder=0.5)
    axis.annotate(
        "toe-off",
        (float(np.mean(stances)), 1.0),
        (0, 2),
        ha="center",
        va="bottom",
        fontsize=8,
        color="0.35",
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
    )
    axis.set(
        xlabel="gait cycle [%]", ylabel=f"{what.title.lower()} [{what.unit}]", xlim=(0.0, 100.0)
    )
    if what in {FORCE, DEPTHS, PRESSURE, PATCH}:
        pulls = (
            min(float(cycles_of(run, what).min()) for run in cyclic) < 0.0
        )  # as a contact law with tension does
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]) if pulls else 0.0)
    _legend(canvas, axis)
