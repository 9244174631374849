"""Figures of a report: over the gait cycle with published ranges, over time, the knee at the peaks, uncertainty.

Every published range was read in the source that the page names with it (`report.html.jinja`).
"""

import io
import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from ...model.readouts import LAWS_WITH_PRESSURE
from ...model.types import MM, Floats
from ...parameters.schema import Parameters, has_two_compartments
from ...streams.gait_events import HEEL_STRIKE, TOE_OFF
from ...streams.topics import NANOSECONDS, is_lateral
from ...view import picture
from ...view.anatomy import MAGNIFICATION
from ..uncertainty import DEFAULT_LEVEL, Propagated
from .gathered import (
    CYCLE_CURVES,
    CYCLE_PERCENT,
    FIRST_PEAK,
    SECOND_PEAK,
    Quantity,
)
from .runs import ReportRun

MICRO = 1e6
NOT_COMPARABLE = "The contact laws differ, so these depths are not comparable."
_HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7B3294", "#66C2A5")
"""Colours of runs and of uncertain inputs, by Okabe and Ito: colour-blind readers can distinguish them"""
_DOTS_PER_INCH = 200
_LEGEND_LETTERS = 50
"""Number of letters of a legend line"""
_TITLE_LETTERS = 32
"""Number of letters of a line above a knee"""
_WIDTH = 4.4
"""Width of a figure [in]: small, so that text stays readable on a phone"""
_EVENT_LINES = {
    HEEL_STRIKE: {"color": "0.25", "linestyle": "-"},
    TOE_OFF: {"color": "0.25", "linestyle": ":"},
}
_BONE_LINE: Any = {"color": "0.35", "linestyle": ":", "linewidth": 1.2}
"""Line of the depth where bone begins"""
_LEAST_EFFECT = 1e-3
"""Smallest deviation of the depth in it [µm]"""
ALL_INPUTS = "all of them together"
NUMERICAL_ERROR = "numerical error (bound)"


class PublishedRange(NamedTuple):
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
        return f"{self.what} {self.cited}"

    @property
    def cited(self) -> str:
        """Numbers of the sources in brackets."""
        return f"[{', '.join(map(str, self.sources))}]"


_FIRST_PEAK_WINDOW = (8.0, 24.0)
"""Percent of the gait cycle in which the first peak of stance is expected"""
_SECOND_PEAK_WINDOW = (38.0, 54.0)
"""Percent of the gait cycle in which the second peak is expected"""
_STANCE_WINDOW = (8.0, 54.0)
"""Both, and what is between"""
_OF_HEALTHY = "computed, healthy people: 1.8–2, 2–2.3 BW"
_IN_VIVO = "total, in vivo, knee implants"
TOTAL = (
    PublishedRange(f"{_IN_VIVO}: 2.5–2.8 BW", 2.5, 2.8, _STANCE_WINDOW, (1,)),
    PublishedRange(f"{_IN_VIVO}: mean 2.61 BW", 2.61, 2.61, _STANCE_WINDOW, (5,)),
)
"""Ranges of the force of the whole joint"""
COMPUTED = (
    PublishedRange(_OF_HEALTHY, 1.8, 2.0, _FIRST_PEAK_WINDOW, (3,)),
    PublishedRange(_OF_HEALTHY, 2.0, 2.3, _SECOND_PEAK_WINDOW, (3,)),
)
"""Computed ranges of the first and the second peak, with which the model's paper compares its own results"""
OF_MEDIAL = (
    PublishedRange(
        "60–80 % of the total in vivo (knee implants: 2.5–2.8 BW)",
        0.6 * 2.5,
        0.8 * 2.8,
        _STANCE_WINDOW,
        (1, 2),
    ),
    *COMPUTED,
)
"""Ranges of the force of the medial compartment"""


class Figure(NamedTuple):
    """Picture of the report with its title and caption."""

    name: str
    """Name of the picture's file, without the suffix"""
    title: str
    caption: str
    """One or two sentences below the picture"""
    files: dict[str, bytes]
    """The picture by format: PNG for the page, and the format of the file beside it"""


_FLEXION = CYCLE_CURVES["flexion_angle_deg"]
_FORCE = CYCLE_CURVES["contact_force_BW"]
_DEPTH = CYCLE_CURVES["penetration_depth_mm"]
_POINT = CYCLE_CURVES["contact_point_x_mm"]
_PRESSURE = CYCLE_CURVES["peak_pressure_MPa"]
_PATCH = CYCLE_CURVES["patch_half_width_mm"]


def measured_depths(runs: Sequence[ReportRun]) -> PublishedRange | None:
    """Range of measured deformations; None if it does not fit all laws: one layer, and cartilage of one thickness."""
    found = {
        0.0 if run.has_bone or not (run.model and run.model.patch) else run.model.patch.thickness
        for run in runs
    }
    thickness = MM * found.pop() if len(found) == 1 else 0.0
    if not thickness:
        return None
    text = f"in vivo, MRI and fluoroscopy: 7–23 % of {thickness:g} mm"
    return PublishedRange(text, 0.07 * thickness, 0.23 * thickness, (0.0, 100.0), (4,))


def cycles_of(run: ReportRun, what: Quantity) -> Floats:
    """Values of all cycles of a run, in the unit of the axis, shape (cycles, 101)."""
    return np.asarray(what.scaled(run.gathered.curves[what.field], run.weight))


@contextmanager
def drawn(
    into: list[Figure], kind: str, name: str, title: str, caption: str, height: float
) -> Iterator[Any]:
    """Yield a matplotlib figure of a height [in] to draw on, then add it to the others as PNG and in the format."""
    files = {"png": io.BytesIO(), kind: io.BytesIO()}
    with picture.saved_figure(
        files,
        (_WIDTH, height),
        _DOTS_PER_INCH,
        **picture.CURVES_STYLE | {"figure.dpi": _DOTS_PER_INCH},
    ) as canvas:
        yield canvas
    contents = {kind: file.getvalue() for kind, file in files.items()}
    into.append(Figure(name, title, caption, contents))


def with_comparisons(runs: Sequence[ReportRun]) -> list[list[ReportRun]]:
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


def pressure_of(run: ReportRun) -> str:
    """Describe how the pressure of a run follows from its contact law, for a caption or a table cell."""
    patch = run.model.patch if run.model else None
    if patch is None:
        return "not known"
    contact = run.parameters.contact
    radii = f"{MM * contact.femoral_radius:.3g} and {MM * contact.tibial_radius:.3g} mm"
    spread = (
        f"{patch.spread.name}, R {MM * patch.radius:.1f} mm of contact.femoral_radius and contact.tibial_radius "
        f"({radii}), not of the surfaces"
    )
    own = run.parameters.contact.law in LAWS_WITH_PRESSURE
    return spread if own else f"the law defines none; its force at rest is distributed as {spread}"


def has_several_laws(runs: Sequence[ReportRun]) -> bool:
    """Whether the runs have different contact laws, so that their depths are not comparable."""
    return len({run.parameters.contact.law for run in runs}) > 1


def moves(cyclic: Sequence[ReportRun]) -> bool:
    """Whether the contact point moves along the plateau in any of the runs."""
    # A smaller motion, in mm, is not drawn.
    return any(float(np.ptp(cycles_of(run, _POINT).mean(axis=0))) > 0.01 for run in cyclic)


def cycle_figures(
    runs: Sequence[ReportRun], cyclic: Sequence[ReportRun], kind: str
) -> list[Figure]:
    """Draw all figures over percent of the gait cycle; `cyclic` are the `runs` with gait cycles."""
    several = any(len(run.gathered.spans) > 1 for run in cyclic)
    lines = ""
    if several:
        lines = "Thick: mean over the cycles, with one standard deviation; thin: single ones. "
    figures: list[Figure] = []
    for what, caption in _captions(cyclic).items():
        # A comparison has the same flexion.
        known = [run for run in cyclic if what is not _FLEXION or run.beside is None]
        # Earlier recordings lack some fields.
        known = [run for run in known if np.isfinite(cycles_of(run, what)).any()]
        if known and (what is not _POINT or moves(known)):
            title = f"{what.title} over the gait cycle"
            with drawn(figures, kind, what.figure, title, lines + caption, 2.9) as canvas:
                _draw_cycles(canvas, runs, known, what)
    return figures


def _captions(cyclic: Sequence[ReportRun]) -> dict[Quantity, str]:
    """Return the captions of figures over the gait cycle, in the order of the figures."""
    ranges = _ranges_of(cyclic)
    if ranges:
        whose = " of the medial compartment" if ranges == OF_MEDIAL else ""
        texts = "; ".join(dict.fromkeys(each.text for each in ranges))
        of_force = (
            f"Grey, published{whose}: {texts}. They are peaks, drawn where peaks are expected; the sources give no "
            "curve."
        )
    else:
        of_force = "No published range is drawn: some of the runs are of the whole joint, and some of one compartment."
    measured = measured_depths(cyclic)
    of_depth = "No measured range is drawn: it holds for one layer of one thickness. "
    if measured:
        of_depth = f"Grey: peak deformations {measured.cited}, {measured.lowest:.2f} to {measured.highest:.2f} mm. "
    of_depth += "A depth here follows from the contact law and the force."
    several = has_several_laws(cyclic)
    of_depth += f" {NOT_COMPARABLE}" if several else ""
    across = " Not comparable between laws." if several else ""
    if any(run.has_bone for run in cyclic):
        of_depth += " Dotted: where bone, the second layer, begins."
    laws = dict.fromkeys(f"{run.parameters.contact.law}: {pressure_of(run)}" for run in cyclic)
    return {
        _FORCE: of_force,
        _DEPTH: of_depth,
        _FLEXION: "",
        _PRESSURE: f"In the middle of the patch. {'; '.join(laws)}.{across}",
        _PATCH: "Of a round patch, from the depth and the radii of the law, not of the surfaces."
        + across,
        _POINT: "Position along the tibial plateau, from the tibia frame's origin, anterior positive.",
    }


def time_figures(runs: Sequence[ReportRun], kind: str) -> list[Figure]:
    """Draw flexion, contact force and depth over time, in a figure for every run and its comparisons."""
    figures: list[Figure] = []
    for number, group in enumerate(with_comparisons(runs), start=1):
        events = group[0].gathered.events
        marks = events[events["event"].isin(list(_EVENT_LINES))]
        caption = ""
        # More lines cannot be distinguished.
        if 0 < len(marks) <= 60:
            caption = "Vertical lines: heel strikes (full) and toe-offs (dotted)."
        title = f"{group[0].name} over time"
        with drawn(figures, kind, f"over_time_{number}", title, caption, 5.2) as canvas:
            axes = canvas.subplots(3, 1, sharex=True)
            for axis, what in zip(axes, (_FLEXION, _FORCE, _DEPTH), strict=True):
                # A comparison has the same flexion.
                for run in group[:1] if what is _FLEXION else group:
                    _draw_course(axis, runs, run, what)
                if caption:
                    for begin, event in zip(marks["time_s"], marks["event"], strict=True):
                        axis.axvline(begin, linewidth=0.9, zorder=1.5, **_EVENT_LINES[event])
                axis.set_ylabel(f"{what.title.lower()} [{what.unit}]".removeprefix("penetration "))
            axes[-1].set_xlabel("time since the first tick [s]")
            if len(group) > 1:
                canvas.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center")
    return figures


def _draw_course(axis: Any, runs: Sequence[ReportRun], run: ReportRun, what: Quantity) -> None:
    """Draw a quantity of a run over time; `runs` are all runs, which set the colours."""
    time = run.gathered.elapsed / NANOSECONDS
    values = what.scaled(run.gathered.columns[what.field], run.weight)
    look = _look(runs, run)
    look["linewidth"] *= 0.7
    # A line of few points alone may be invisible.
    look["marker"] = "." if len(time) < 20 else None
    axis.plot(time, values, **look, label=_plain(run.label))
    if what is _DEPTH and run.has_bone:
        axis.axhline(MM * run.parameters.contact.layer_depth, **_BONE_LINE)


def knee_figures(runs: Sequence[ReportRun], kind: str) -> list[Figure]:
    """Draw the knee at its peaks, for every run and comparison with known surfaces."""
    figures: list[Figure] = []
    caption = (
        "Side view; the arrow is the contact force on the femur. Dark is where the surfaces would overlap if "
        f"neither gave way, its depth drawn × {MAGNIFICATION:g}. The surfaces that touch are the model's; "
        "the shafts are drawn around them, and so is cartilage whose thickness the contact law does not know."
    )
    for number, group in enumerate(with_comparisons(runs), start=1):
        models = [run.model for run in group if run.model]
        if len(models) < len(group):
            continue
        titles = [title for title, _ in _drawn_peaks(group[0])]
        name = f"The knee at the peaks: {group[0].name}"
        height = 3.0 * len(group)
        with drawn(figures, kind, f"knee_{number}", name, caption, height) as canvas:
            caption = "As above."
            rows = canvas.subplots(len(group), len(titles), squeeze=False)
            for row, run, model in zip(rows, group, models, strict=True):
                label = ""
                if len(group) > 1:
                    label = f"{textwrap.fill(_plain(run.label), _TITLE_LETTERS)}\n"
                for axis, title, (_, tick) in zip(row, titles, _drawn_peaks(run), strict=True):
                    angle, place, force = (
                        float(run.gathered.columns[name][tick])
                        for name in ("flexion_angle", "femoral_height", "contact_force")
                    )
                    picture.draw_knee(axis, model, angle, place, force, run.weight)
                    text = f"{label}{title}\n{math.degrees(angle):.0f}° of flexion"
                    axis.set_title(text, fontsize=9.5)
    return figures


def _drawn_peaks(run: ReportRun) -> list[tuple[str, int]]:
    """Titles and ticks of the largest first and second peak of stance; without peaks, of the largest load or force."""
    gathered = run.gathered
    peaks = []
    for which in (FIRST_PEAK, SECOND_PEAK):
        same = gathered.peaks[gathered.peaks["peak"] == which]
        if len(same):
            largest = same.loc[same["load_N"].idxmax()]
            title = f"{which} peak, {largest['gait_cycle_percent']:.0f} % of the cycle"
            peaks.append((title, int(largest["tick"])))
    time = gathered.elapsed[gathered.largest] / NANOSECONDS
    what = gathered.driving.replace("_", " ")
    return peaks or [(f"largest {what}, {time:.2f} s", gathered.largest)]


def uncertainty_figures(runs: Sequence[ReportRun], kind: str) -> list[Figure]:
    """Draw depth, force and the effects of uncertain inputs around the largest load or force, for every run."""
    figures: list[Figure] = []
    caption = (
        f"Depth and contact force with their {100.0 * DEFAULT_LEVEL:.0f} % intervals. Below: what one standard "
        "deviation of each input does to the depth alone, all together, and the bound of the numerical error."
    )
    known = [(run, run.uncertain) for run in runs if run.uncertain]
    for number, (run, of) in enumerate(known, start=1):
        name = f"uncertainty_{number}"
        title = f"Uncertainty: {run.label}"
        with drawn(figures, kind, name, title, caption, 6.0) as canvas:
            _draw_uncertainty(canvas, run, of)
    return figures


def _draw_uncertainty(canvas: Any, run: ReportRun, of: Propagated) -> None:
    """Draw depth and force with their intervals, and below them the effects of the inputs on the depth."""
    since = (of.rows["stamp"] - of.rows["stamp"][0]) / NANOSECONDS
    largest = since[int(of.rows[run.gathered.driving].argmax())]
    # A second on either side.
    shown = np.abs(since - largest) <= 1.0
    time = since[shown]
    above, middle, below = canvas.subplots(3, 1, sharex=True)
    for axis, edges, values, unit, text in (
        (above, of.depth_interval(), of.rows["penetration_depth"], MM, "depth [mm]"),
        (middle, of.force_interval(), of.rows["contact_force"], 1.0, "contact force [N]"),
    ):
        low, high = (unit * edge[shown] for edge in edges)
        axis.fill_between(time, low, high, color=_HUES[0], alpha=0.25, linewidth=0)
        axis.plot(time, unit * values[shown], color=_HUES[0], linewidth=1.8)
        axis.set(ylabel=text, ylim=(min(0.0, float(low.min())), None))

    def draw_effect(effect: Floats, label: str, **look: Any) -> None:
        values = np.maximum(MICRO * np.abs(effect[shown]), _LEAST_EFFECT)
        below.plot(time, values, label=label, **look)

    for place, (each, (effect, _)) in enumerate(of.parts.items()):
        if each not in of.without_effect:
            colour = _HUES[place % len(_HUES)]
            draw_effect(effect, f"{each.name}, {each.text}", color=colour, linewidth=1.4)
    draw_effect(of.depth, ALL_INPUTS, color="black", linewidth=3.0, zorder=1.5)
    error = of.rows["error_estimate"]
    draw_effect(error, NUMERICAL_ERROR, color="0.35", linewidth=1.6, linestyle=":")
    below.set(
        yscale="log", ylabel="effect on the depth [µm]", xlabel="time since the first tick [s]"
    )
    _legend(canvas, below)


def _ranges_of(cyclic: Sequence[ReportRun]) -> tuple[PublishedRange, ...]:
    """Published ranges to show behind contact forces; none if whole joints and single compartments are mixed."""
    kinds = {is_total(run.parameters) for run in cyclic if not is_lateral(run.topic)}
    if len(kinds) != 1:
        return ()
    return TOTAL if kinds.pop() else OF_MEDIAL


def sources_of(cyclic: Sequence[ReportRun]) -> set[int]:
    """Return the numbers of the sources whose ranges are drawn."""
    measured = measured_depths(cyclic) if cyclic else None
    drawn = (*_ranges_of(cyclic), *((measured,) if measured else ()))
    return {number for each in drawn for number in each.sources}


def _look(runs: Sequence[ReportRun], run: ReportRun) -> dict[str, Any]:
    """Colour, style and width of a run's line; later ones are thinner, dashed ones on top, so that all are visible."""
    place = runs.index(run)
    look = {"color": _HUES[place % len(_HUES)], "linestyle": "-"}
    if run.beside is not None:
        return look | {"linestyle": "--", "linewidth": 1.4, "zorder": 2.5}
    return look | {"linewidth": max(3.4 - 0.6 * place, 1.2)}


def _legend(canvas: Any, axis: Any) -> None:
    """Add a legend below the axes, each text once, and make the figure taller by the legend's height."""
    handles, labels = axis.get_legend_handles_labels()
    once = {
        textwrap.fill(label, _LEGEND_LETTERS): handle
        for label, handle in zip(labels, handles, strict=True)
    }
    columns = 2 if len(once) > 3 and max(map(len, once)) <= _LEGEND_LETTERS // 2 else 1
    canvas.legend(once.values(), once.keys(), loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    lines = -(-sum(1 + label.count("\n") for label in once) // columns)
    # A line of the legend is 0.19 in high.
    canvas.set_size_inches(width, height + 0.19 * lines)


def _plain(label: str) -> str:
    """Escape a label for matplotlib, where a dollar begins a formula and a leading underscore hides the entry."""
    escaped = label.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def _draw_cycles(
    canvas: Any, runs: Sequence[ReportRun], cyclic: Sequence[ReportRun], what: Quantity
) -> None:
    """Draw a quantity of the runs `cyclic` over the gait cycle; `runs` are all runs, which set the colours."""
    axis = canvas.subplots()
    _draw_published(axis, cyclic, what)
    for run in cyclic:
        values = cycles_of(run, what)
        look = _look(runs, run)
        mean = values.mean(axis=0)
        if len(values) > 1:
            spread = values.std(axis=0, ddof=1)
            shade: Any = {"color": look["color"], "alpha": 0.15, "linewidth": 0}
            axis.fill_between(CYCLE_PERCENT, mean - spread, mean + spread, **shade)
            thin = look | {"linewidth": 0.5, "alpha": 0.5}
            # More than 12 single cycles cannot be distinguished.
            axis.plot(CYCLE_PERCENT, values[:12].T, **thin)
        axis.plot(CYCLE_PERCENT, mean, **look, label=_plain(run.label))
    # A comparison has the same stance.
    stances = list({run.gathered.strides["stance_percent"].mean() for run in cyclic})
    for stance in stances:
        axis.axvline(stance, color="0.45", linewidth=1.0, linestyle=(0, (1, 2)), zorder=0.5)
    place = (float(np.mean(stances)), 1.0)
    above: Any = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    centred: Any = {"ha": "center", "va": "bottom", "fontsize": 8, "color": "0.35"}
    axis.annotate("toe-off", place, (0, 2), **above, **centred)
    label = f"{what.title.lower()} [{what.unit}]"
    axis.set(xlabel="gait cycle [%]", ylabel=label, xlim=(0.0, 100.0))
    if what in {_FORCE, _DEPTH, _PRESSURE, _PATCH}:
        # A contact law with tension has forces below 0.
        pulls = min(float(cycles_of(run, what).min()) for run in cyclic) < 0.0
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]) if pulls else 0.0)
    _legend(canvas, axis)


def _draw_published(axis: Any, cyclic: Sequence[ReportRun], what: Quantity) -> None:
    """Draw the published ranges of a force or depth, and the depths where bone begins."""
    ranges = _ranges_of(cyclic) if what is _FORCE else ()
    depths = set()
    if what is _DEPTH:
        measured = measured_depths(cyclic)
        ranges = (measured,) if measured else ()
        depths = {run.parameters.contact.layer_depth for run in cyclic if run.has_bone}
    for number, each in enumerate(ranges):
        shade: Any = {"facecolor": "0.85", "zorder": 0, "alpha": 0.6, "edgecolor": "none"}
        if number and each.text != ranges[0].text:
            shade |= {"facecolor": "none", "hatch": "////", "edgecolor": "0.7"}
        if each.lowest == each.highest:
            shade |= {"edgecolor": "0.5", "linewidth": 3.0}
        axis.fill_between(each.window, each.lowest, each.highest, label=each.text, **shade)
    for depth in sorted(depths):
        axis.axhline(MM * depth, **_BONE_LINE)
        place = (99.0, MM * depth)
        text = f"bone from {MM * depth:g} mm"
        axis.annotate(text, place, ha="right", va="bottom", fontsize=8.5)
