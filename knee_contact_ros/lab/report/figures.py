"""Figures of a report: over the gait cycle beside published ranges, over time, the knee at the peaks, uncertainty.

Every number of a published range was read in the source that the page names with it (`report.html.jinja`).
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.lab.report.runs import CURVES, FIRST, MEGA, MM, PERCENT, SECOND, Floats, Moment, Run
from knee_contact_ros.lab.uncertainty import LEVEL, Propagated
from knee_contact_ros.model.readouts import OWN_PRESSURE
from knee_contact_ros.parameters.schema import Parameters, has_both
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF
from knee_contact_ros.streams.topics import NANOSECONDS, is_lateral
from knee_contact_ros.view import picture
from knee_contact_ros.view.anatomy import cartilage_of

MICRO = 1e6
HUES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7B3294", "#66C2A5")
"""Colours of runs and of uncertain inputs; after Okabe and Ito: colour-blind readers can tell them apart"""
DPI = 200
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": DPI}  # fmt: skip
LINE, LETTERS = 0.19, 50
"""Height of a line of the legend [in], and number of its letters"""
WIDTH, CYCLE, TIME, UNCERTAIN = 4.4, 2.9, 5.2, 6.0
"""Width of a figure, and heights of those over a cycle (without its legend), over time and of uncertainty [in]: small,
so that their letters can be read on a telephone"""
KNEE, CONTACT = 3.1, 1.45
"""Height of a knee and of a magnified contact [in]"""
TOGETHER = 1.5
"""Percent of the cycle within which toe-offs of several runs are marked once"""
LEAST_WAY = 0.01
"""Smallest motion of the contact point [mm] for which it is drawn"""
FEW = 12
"""Largest number of single cycles that are drawn"""
FEW_EVENTS = 60
"""Largest number of heel strikes and toe-offs that are marked: more cannot be distinguished in a picture"""
FINE = 20_000_000
"""Largest width of a bucket [ns] that is drawn as a point of a line, and not as a range"""
FEW_POINTS = 20
"""Number of points below which each is marked: a line alone may not be seen"""
MARKS = {HEEL_STRIKE: {"color": "0.25", "linestyle": "-"}, TOE_OFF: {"color": "0.25", "linestyle": ":"}}
AROUND, LEAST = 1.0, 1e-3
"""Time [s] that a figure of uncertainty shows on either side of the largest load or contact force, and the smallest
deviation of the depth in it [µm]"""
ALL_OF_THEM, NUMERICAL = "all of them together", "numerical error (bound)"
CARTILAGE_THICKNESS = 3.0
"""Thickness of resting cartilage [mm] that the range of depths assumes, as the model's paper does"""


class Range(NamedTuple):
    """Published range of the peak of a force or depth."""

    what: str
    """What was measured or computed, and in whom"""
    lowest: float
    """Lower end [BW] for a force, [mm] for a depth; equal to `highest` where the source has a single number"""
    highest: float
    window: tuple[float, float]
    """Percent of the gait cycle between which the range is drawn; the sources have no times"""
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
    Range("60–80 % of the total in vivo (knee implants: 2.5–2.8 BW)", 0.6 * 2.5, 0.8 * 2.8, STANCE, (2, 3)), *COMPUTED
)  # fmt: skip
DEPTH = Range(
    f"in vivo, MRI and fluoroscopy: 7–23 % of {CARTILAGE_THICKNESS:g} mm", 0.07 * CARTILAGE_THICKNESS,
    0.23 * CARTILAGE_THICKNESS, (0.0, 100.0), (5,),
)  # fmt: skip


class Figure(NamedTuple):
    """Picture of the report with its title and caption."""

    name: str
    """Name of the picture's file, without the suffix"""
    title: str
    caption: str
    """One or two sentences below the picture"""
    png: bytes
    """The picture in PNG format"""


class Quantity(NamedTuple):
    """Quantity that a figure over the gait cycle shows."""

    name: str
    title: str
    axis: str
    """Label of the vertical axis, with the unit in brackets"""
    field: str
    """Name of the field of the answers, one of `CURVES`"""
    factor: float | None
    """Factor from SI units to the unit of the axis; None: the quantity is a force in body weights"""

    def of(self, run: Run, curves: Floats | None = None) -> Floats:
        """Values in the unit of the axis, shape (101,), of a run's mean or other `curves`, shape (101, `CURVES`)."""
        values = (run.gathered.mean if curves is None else curves)[:, CURVES.index(self.field)]
        return values / run.parameters.body_weight if self.factor is None else self.factor * values


FLEXION = Quantity("flexion", "Flexion angle", "flexion angle [°]", "flexion_angle", math.degrees(1.0))
FORCE = Quantity("contact_force", "Contact force", "contact force [BW]", "contact_force", None)
DEPTHS = Quantity("depth", "Penetration depth", "penetration depth [mm]", "penetration_depth", MM)
POINT = Quantity(
    "contact_point", "Contact point along the plateau", "contact point, anterior [mm]", "contact_point_x", MM
)
PRESSURE = Quantity("peak_pressure", "Peak contact pressure", "peak pressure [MPa]", "peak_pressure", MEGA)
PATCH = Quantity("patch_half_width", "Half-width of the contact patch", "half-width [mm]", "half_width", MM)
ROWS = ((FLEXION, "flexion [°]"), (FORCE, "contact force [BW]"), (DEPTHS, "depth [mm]"))
"""Quantities over time, with the labels of their axes"""


def draw(size: tuple[float, float], paint: Callable[[Any], None]) -> bytes:
    """Draw a figure of a size [in] as PNG; `paint` draws onto matplotlib's figure."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Canvas

    with mpl.rc_context(STYLE):
        canvas = Canvas(figsize=size, layout="constrained")
        paint(canvas)
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def with_comparisons(runs: Sequence[Run]) -> list[list[Run]]:
    """Group runs: each run that is no comparison, followed by the comparisons with it."""
    return [
        [run, *(other for other in runs if other.beside == place)]
        for place, run in enumerate(runs)
        if run.beside is None
    ]


def has_bone(run: Run) -> bool:
    """Whether the contact law of a run has a second layer, the bone."""
    return run.parameters.contact.law.startswith("two_layer")


def is_total(parameters: Parameters) -> bool:
    """Whether the load is that of the whole joint, and not of a single compartment."""
    whole = parameters.load.rule == "fixed_share" and parameters.load.share == 1.0
    return whole or parameters.load.compartment == "total"


def which_load(parameters: Parameters) -> str:
    """Describe the load of a run by its parameters, for the page and its tables."""
    if is_total(parameters):
        return "total: the whole axial joint reaction"
    rest = "; lateral: the rest" if has_both(parameters) else ""
    if parameters.load.rule == "moment_balance":
        return f"medial compartment: what balances the frontal moment of the joint reaction{rest}"
    if parameters.load.rule == "measured_share":
        return f"medial compartment: the share of the axial joint reaction that {parameters.load.share_file} has{rest}"
    return f"medial compartment: {parameters.load.share:g} of the axial joint reaction{rest}"


def pressure_of(run: Run) -> str:
    """Say how the pressure of a run follows from its contact law, for a caption or a cell of a table."""
    patch = run.model.patch if run.model else None
    if patch is None:
        return "not known"
    spread = f"{patch.spread.name}, R {MM * patch.radius:.1f} mm, cartilage {MM * patch.thickness:.2g} mm"
    own = run.parameters.contact.law in OWN_PRESSURE
    return spread if own else f"none of the law's own; its force at rest is spread as {spread}"


def over_cycle(runs: Sequence[Run], cyclic: Sequence[Run]) -> list[Figure]:
    """Draw all figures over percent of the gait cycle; `cyclic` are those of `runs` that have gait cycles."""
    several = any(len(run.gathered.cycles) > 1 for run in cyclic)
    lines = "Thick: mean over the cycles, with one standard deviation; thin: single ones." if several else ""
    depth = (
        f"Grey: peak deformations in vivo, {DEPTH.lowest:.2f} to {DEPTH.highest:.2f} mm if the cartilage is "
        f"{CARTILAGE_THICKNESS:g} mm thick. A depth here is what the contact law makes of the force, "
        "no measured deformation."
    )
    bone = " Dotted: where the second layer, bone, begins." if any(map(has_bone, cyclic)) else ""
    captions = {FORCE: _force_caption(cyclic), DEPTHS: depth + bone, FLEXION: ""}
    if all(run.gathered.reads_off for run in cyclic):
        laws = dict.fromkeys(f"{run.parameters.contact.law}: {pressure_of(run)}" for run in cyclic)
        captions[PRESSURE] = f"In the middle of the patch. {'; '.join(laws)}."
        captions[PATCH] = "Of a round patch, from the depth and the radii of the law."
    if moves(cyclic):
        captions[POINT] = "Position on the tibial plateau, from the tibia frame's origin, anterior positive."
    figures = []
    for quantity, caption in captions.items():
        drawn = [run for run in cyclic if run.beside is None] if quantity is FLEXION else cyclic  # the same inputs
        drawn = [run for run in drawn if np.isfinite(quantity.of(run)).any()]  # earlier recordings lack some fields
        if not drawn:
            continue
        text = _sentences(lines, caption)
        png = draw((WIDTH, CYCLE), partial(_panel, runs=runs, cyclic=drawn, what=quantity))
        figures.append(Figure(quantity.name, f"{quantity.title} over the gait cycle", text, png))
    if moves(cyclic):
        png = draw((WIDTH, CYCLE), partial(_path_panel, runs=runs, cyclic=cyclic))
        way = "Its way over the gait cycle: dot at heel strike, triangle at toe-off."
        figures.append(Figure("contact_point_flexion", "Contact point over flexion", way, png))
    return figures


def moves(cyclic: Sequence[Run]) -> bool:
    """Whether the contact point moves along the plateau in any of the runs."""
    return any(float(np.ptp(POINT.of(run))) > LEAST_WAY for run in cyclic)


def over_time(runs: Sequence[Run]) -> list[Figure]:
    """Draw flexion, contact force and depth over time, in a figure for every run and its comparisons."""
    figures = []
    for number, group in enumerate(with_comparisons(runs), start=1):
        run, looks = group[0], [_look(runs, each) for each in group]
        marks = [moment for moment in run.gathered.moments if moment.event.kind in MARKS]
        marks = marks if len(marks) <= FEW_EVENTS else []
        png = draw((WIDTH, TIME), partial(_rows, runs=group, looks=looks, marks=marks))
        lines = "Vertical lines: heel strikes (full) and toe-offs (dotted), as found." if marks else ""
        width = run.gathered.course()[0]
        course = f"From the smallest to the largest value in each {width / 1e9:g} s." if width > FINE else ""
        caption = _sentences(lines, course)
        figures.append(Figure(f"over_time_{number}", f"{run.name} over time", caption, png))
    return figures


def knees(runs: Sequence[Run]) -> list[Figure]:
    """Draw the knee at its peaks, for every run and its comparisons as far as their surfaces are known."""
    figures, drawn = [], {}
    for run in runs:
        if model := run.model:
            weight = run.parameters.body_weight
            drawn[run.label] = [
                picture.Moment(model, each.flexion_angle, each.femoral_height, each.contact_force, weight)
                for _, each in _drawn_peaks(run)
            ]
    window = picture.Window.around([each for moments in drawn.values() for each in moments]) if drawn else None
    for number, group in enumerate(with_comparisons(runs), start=1):
        if window is None or any(run.label not in drawn for run in group):
            continue
        columns = list(zip(*(drawn[run.label] for run in group), strict=True))
        titles, labels = [title for title, _ in _drawn_peaks(group[0])], [run.label for run in group]
        size = (WIDTH, KNEE + CONTACT * len(group))
        png = draw(size, partial(_knees, labels=labels, titles=titles, columns=columns, window=window))
        assumed = any(cartilage_of(run.model)[1] for run in group if run.model)
        caption = (
            "Side view; the arrow is the contact force on the femur. Below, the contact with its heights "
            "magnified: dark is where the surfaces would overlap if neither gave way; the number is the depth. The "
            "surfaces that touch are the model's; the shafts are drawn around them"
            f"{', and so is cartilage whose thickness the contact law does not know' if assumed else ''}."
        )
        title = f"The knee at the peaks: {group[0].name}"
        figures.append(Figure(f"knee_{number}", title, caption, png))
    return figures


def uncertainty_figures(runs: Sequence[Run]) -> list[Figure]:
    """Draw a figure for every run that has its uncertainty."""
    caption = (
        f"Depth and contact force with their {100.0 * LEVEL:.0f} % intervals. Below: what one standard "
        "deviation of each input does to the depth alone, all together, and the bound of the numerical error."
    )
    figures = []
    for number, (run, of) in enumerate(((run, run.uncertain) for run in runs if run.uncertain), start=1):
        png = draw((WIDTH, UNCERTAIN), partial(_uncertainty, of=of, of_largest=run.gathered.of_largest))
        figures.append(Figure(f"uncertainty_{number}", f"Uncertainty: {run.label}", caption, png))
    return figures


def _sentences(*parts: str) -> str:
    """Join the parts of a caption that are not empty."""
    return " ".join(filter(None, parts))


def _force_caption(cyclic: Sequence[Run]) -> str:
    """Caption of the contact force: what the published ranges behind the curves are."""
    ranges = _ranges_of(cyclic)
    if not ranges:
        return "No published range is drawn: some of the runs are of the whole joint, and some of one compartment."
    about = "total" if ranges == TOTAL else "medial"
    lateral = any(is_lateral(run.topic) for run in cyclic)
    return (
        f"The load of these runs is the {about} one{', in the lateral compartment the rest' if lateral else ''}. Grey, "
        f"published{f' of the {about} one' if lateral else ''}: "
        f"{'; '.join(dict.fromkeys(each.text for each in ranges))}. They are peaks, drawn where peaks are expected; "
        "the sources give no curve."
    )


def _ranges_of(cyclic: Sequence[Run]) -> tuple[Range, ...]:
    """Published ranges to show behind contact forces; none where runs of the whole joint and of a compartment mix."""
    kinds = {is_total(run.parameters) for run in cyclic if not is_lateral(run.topic)}
    if len(kinds) != 1:
        return ()
    return TOTAL if kinds.pop() else MEDIAL


def _look(runs: Sequence[Run], run: Run) -> dict[str, Any]:
    """Colour, style and width of a run's line; later ones are thinner, so that those below can be seen."""
    place = runs.index(run)
    style = ("-", max(3.4 - 0.6 * place, 1.2)) if run.beside is None else ("--", 1.4)
    return {"color": HUES[place % len(HUES)], "linestyle": style[0], "linewidth": style[1]}


def _legend(canvas: Any, axis: Any) -> None:
    """Add a legend below the axes, with each text once, and make the figure higher by the legend's height."""
    handles, labels = axis.get_legend_handles_labels()
    once = {textwrap.fill(label, LETTERS): handle for label, handle in zip(labels, handles, strict=True)}
    columns = 2 if len(once) > 3 and max(map(len, once)) <= LETTERS // 2 else 1
    canvas.legend(once.values(), once.keys(), loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    lines = -(-sum(1 + label.count("\n") for label in once) // columns)
    canvas.set_size_inches(width, height + LINE * lines)


def _plain(label: str) -> str:
    """Escape a label for matplotlib, where dollars begin formulas and a leading underscore hides the entry."""
    escaped = label.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def _panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run], what: Quantity) -> None:
    """Draw a quantity of the runs `cyclic` over the gait cycle; `runs` are all of the report, for the colours."""
    axis = canvas.subplots()
    if what is FORCE:
        for each, shade in zip(_ranges_of(cyclic), ("0.88", "0.76", "0.76"), strict=False):
            if each.lowest == each.highest:
                axis.plot(each.window, (each.lowest,) * 2, color="0.5", linewidth=3.0, zorder=0, label=each.text)
            else:
                box = {"facecolor": shade, "edgecolor": "none", "zorder": 0, "alpha": 0.7}
                axis.fill_between(each.window, each.lowest, each.highest, label=each.text, **box)
    if what is DEPTHS:
        axis.axhspan(DEPTH.lowest, DEPTH.highest, color="0.93", zorder=0, label=DEPTH.text)
        for layer in sorted({run.parameters.contact.layer_depth for run in cyclic if has_bone(run)}):
            axis.axhline(MM * layer, color="0.35", linestyle=":", linewidth=1.2)
            axis.annotate(f"bone from {MM * layer:g} mm", (99.0, MM * layer), ha="right", va="bottom", fontsize=8.5)
    for run in cyclic:
        _curve(axis, run, _look(runs, run), what)
    _toe_offs(axis, runs, [run for run in cyclic if run.beside is None])
    axis.set(xlabel="gait cycle [%]", ylabel=what.axis, xlim=(0.0, 100.0))
    if what in {FORCE, DEPTHS, PRESSURE, PATCH}:
        pulls = min(float(what.of(run).min()) for run in cyclic) < 0.0  # as a contact law with tension does
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]) if pulls else 0.0)
    _legend(canvas, axis)


def _curve(axis: Any, run: Run, look: dict[str, Any], what: Quantity) -> None:
    """Draw mean, standard deviation and single cycles of a run."""
    values, deviation, cycles = what.of(run), run.gathered.deviation, run.gathered.cycles
    if deviation is not None:
        spread = what.of(run, deviation)
        axis.fill_between(PERCENT, values - spread, values + spread, color=look["color"], alpha=0.15, linewidth=0)
        for cycle in cycles if len(cycles) <= FEW else ():
            axis.plot(PERCENT, what.of(run, cycle.curves), **look | {"linewidth": 0.5, "alpha": 0.5})
    axis.plot(PERCENT, values, **look, label=_plain(run.label))


def _stance(run: Run) -> float:
    """Mean percent of a run's cycles at which the toe goes off."""
    return float(np.mean([cycle.span.stance for cycle in run.gathered.cycles]))


def _toe_offs(axis: Any, runs: Sequence[Run], bases: Sequence[Run]) -> None:
    """Mark the mean end of stance of each run, or once if all are close together."""
    stances = [_stance(run) for run in bases]
    middle = float(np.mean(stances))
    if max(stances) - min(stances) <= TOGETHER:
        marks = [(middle, "0.45")]
    else:
        marks = [(stance, _look(runs, run)["color"]) for stance, run in zip(stances, bases, strict=True)]
    for place, hue in marks:
        axis.axvline(place, color=hue, linewidth=1.0, linestyle=(0, (1, 2)), zorder=0.5)
    axis.annotate("toe-off", (middle, 1.0), (0, 2), ha="center", va="bottom", xycoords=("data", "axes fraction"),
                  textcoords="offset points", fontsize=8, color="0.35")  # fmt: skip


def _path_panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run]) -> None:
    """Draw the contact point over the flexion angle."""
    axis = canvas.subplots()
    for run in cyclic:
        angle, point, toe_off, look = FLEXION.of(run), POINT.of(run), round(_stance(run)), _look(runs, run)
        axis.plot(angle, point, **look, label=_plain(run.label))
        for at, marker, size in ((0, "o", 6), (toe_off, "^", 7)):
            axis.plot(angle[at], point[at], marker, color=look["color"], ms=size, markeredgecolor="black", zorder=3)
    axis.set(xlabel=FLEXION.axis, ylabel=POINT.axis)
    _legend(canvas, axis)


def _rows(canvas: Any, runs: Sequence[Run], looks: Sequence[dict[str, Any]], marks: Sequence[Moment]) -> None:
    """Draw flexion, contact force and depth over time, one above the other, for a run and its comparisons."""
    axes = canvas.subplots(len(ROWS), 1, sharex=True)
    for axis, (what, text) in zip(axes, ROWS, strict=True):
        for run, look in zip(runs[:1] if what is FLEXION else runs, looks, strict=False):  # flexion: the same inputs
            factor = what.factor or 1.0 / run.parameters.body_weight
            course_width, time, ranges = run.gathered.course()
            low, high = (factor * values for values in ranges[what.field])
            label = _plain(run.label) if what is FORCE else None
            if course_width <= FINE:
                marker = "." if len(time) < FEW_POINTS else None
                axis.plot(time, high, **look | {"linewidth": 0.7 * look["linewidth"]}, marker=marker, label=label)
            else:
                axis.fill_between(time, low, high, color=look["color"], alpha=0.5, linewidth=0.3, label=label)
            if what is DEPTHS and has_bone(run):
                axis.axhline(MM * run.parameters.contact.layer_depth, color="0.35", linestyle=":", linewidth=1.2)
        for moment in marks:
            axis.axvline(moment.elapsed, linewidth=0.9, zorder=1.5, **MARKS[moment.event.kind])
        axis.set_ylabel(text)
    axes[-1].set_xlabel("time since the first tick [s]")
    if len(runs) > 1:
        canvas.legend(*axes[1].get_legend_handles_labels(), loc="outside lower center")


def _drawn_peaks(run: Run) -> list[tuple[str, Moment]]:
    """Largest first and largest second peak of stance of a run; without any, its largest load or contact force."""
    drawn = []
    for which in (FIRST, SECOND):
        if same := [peak for peak in run.gathered.peaks if peak.which == which]:
            largest = max(same, key=lambda peak: peak.load)
            drawn.append((f"{which} peak, {largest.percent:.0f} % of the cycle", largest))
    moment = run.gathered.largest
    return drawn or [(f"{moment.event.kind}, {moment.elapsed:.2f} s", moment)]


def _knees(
    canvas: Any, labels: Sequence[str], titles: Sequence[str], columns: Sequence[Sequence[picture.Moment]],
    window: picture.Window,
) -> None:  # fmt: skip
    """Draw a column for every peak: the knee of the first run, and below it the contact of every run."""
    axes = canvas.subplots(1 + len(labels), len(columns), squeeze=False, height_ratios=(KNEE, *[CONTACT] * len(labels)))
    for column, (title, moments) in enumerate(zip(titles, columns, strict=True)):
        picture.draw_knee(axes[0, column], moments[0])
        bent = f"{math.degrees(moments[0].flexion_angle):.0f}° of flexion"
        axes[0, column].set_title(f"{title}\n{bent}", fontsize=9.5)
        for axis, label, moment in zip(axes[1:, column], labels, moments, strict=True):
            picture.draw_contact(axis, moment, window)
            if len(labels) > 1:
                axis.set_title(_plain(label), fontsize=8.5, loc="left", pad=3)


def _uncertainty(canvas: Any, of: Propagated, of_largest: str) -> None:
    """Draw depth, force and the effects of the inputs around the tick where the field `of_largest` is largest."""
    stamps = of.rows["stamp"]
    since = (stamps - stamps[0]) / NANOSECONDS
    shown = np.abs(since - since[int(of.rows[of_largest].argmax())]) <= AROUND
    time = since[shown]
    above, middle, below = canvas.subplots(3, 1, sharex=True)
    bands = ((above, of.depth_interval(), of.rows["penetration_depth"], MM, "depth [mm]"),
             (middle, of.force_interval(), of.rows["contact_force"], 1.0, "contact force [N]"))  # fmt: skip
    for axis, edges, values, unit, text in bands:
        low, high = (unit * edge[shown] for edge in edges)
        axis.fill_between(time, low, high, color=HUES[0], alpha=0.25, linewidth=0)
        axis.plot(time, unit * values[shown], color=HUES[0], linewidth=1.8)
        axis.set_ylabel(text)
        axis.set_ylim(bottom=min(0.0, float(low.min())))

    def effect(depth: Floats, style: str, **look: Any) -> None:  # on the depth, in µm
        below.plot(time, np.maximum(MICRO * np.abs(depth[shown]), LEAST), style, **look)

    for number, (deviation, (part, _)) in enumerate(of.parts.items()):
        if MICRO * np.abs(part[shown]).max() > LEAST:
            style, label = "-" if number < len(HUES) else "--", f"{deviation.name}, {deviation.text}"
            effect(part, style, color=HUES[number % len(HUES)], linewidth=1.4, label=label)
    effect(of.depth, "-", color="black", linewidth=3.0, zorder=1.5, label=ALL_OF_THEM)  # under what makes most of it
    effect(of.rows["error_estimate"], ":", color="0.35", linewidth=1.6, label=NUMERICAL)
    below.set(yscale="log", ylabel="effect on the depth [µm]", xlabel="time since the first tick [s]")
    _legend(canvas, below)
