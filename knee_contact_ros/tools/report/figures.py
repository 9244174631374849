"""The figures over the gait cycle, as PNG."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.tools.report.cycles import CURVES, PERCENT, Floats
from knee_contact_ros.tools.report.in_vivo import CARTILAGE_THICKNESS, DEPTH, MEDIAL, TOTAL, Range, cited, is_total
from knee_contact_ros.tools.report.runs import Run

COLOURS = (("#0072B2", "#56B4E9"), ("#D55E00", "#E69F00"), ("#009E73", "#66C2A5"), ("#7B3294", "#CC79A7"))
"""Of a run and of its comparison; from Okabe and Ito's, which colour-blind readers can tell apart"""
SIZE = (5.2, 3.1)
"""[in], without the legend: small, so that its letters can be read on a telephone"""
LINE, WIDE = 0.19, 34
"""Height [in] of a legend's line; letters in it that two columns have room for"""
DPI = 200
MM = 1e3
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": DPI}  # fmt: skip
TWO_LAYERS = "two_layer"
LEAST_WAY = 0.01
"""[mm] that a contact point moves at least, for its way to be drawn"""


class Figure(NamedTuple):
    """A picture with what belongs to it."""

    name: str
    """Of its file, without the suffix"""
    title: str
    caption: str
    """One or two sentences"""
    png: bytes


class Quantity(NamedTuple):
    """What a figure over the cycle shows."""

    name: str
    title: str
    axis: str
    of: Callable[[Floats, Run], Floats]
    """From mean curves, shape (101, `CURVES`), in SI to what is drawn; likewise from deviations"""


def column(name: str, factor: float) -> Callable[[Floats, Run], Floats]:
    """A column of the curves in another unit."""
    return lambda curves, _run: factor * curves[:, CURVES.index(name)]


def in_weights(name: str) -> Callable[[Floats, Run], Floats]:
    """A column of forces in body weights."""
    return lambda curves, run: curves[:, CURVES.index(name)] / run.parameters.body_weight


FLEXION = Quantity("flexion", "Flexion angle", "flexion angle [°]", column("flexion_angle", float(np.degrees(1.0))))
FORCE = Quantity("contact_force", "Contact force", "contact force [BW]", in_weights("contact_force"))
DEPTHS = Quantity("depth", "Penetration depth", "penetration depth [mm]", column("penetration_depth", MM))
POINT = Quantity("contact_point", "Contact point along the plateau", "contact point, anterior [mm]",
                 column("contact_point_x", MM))  # fmt: skip


def draw(size: tuple[float, float], paint: Callable[[Any], None]) -> bytes:
    """A figure as PNG; `paint` gets matplotlib's figure."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    with mpl.rc_context(STYLE):
        canvas = Canvas(figsize=size, layout="constrained")
        FigureCanvasAgg(canvas)
        paint(canvas)
        file = io.BytesIO()
        canvas.savefig(file, format="png", dpi=DPI, metadata={"Software": None})
    return file.getvalue()


def colour(runs: Sequence[Run], run: Run) -> str:
    """Each run's own; a comparison has a lighter one than the run it is beside."""
    place = runs.index(run) if run.beside is None else run.beside
    bases = [index for index, each in enumerate(runs) if each.beside is None]
    return COLOURS[bases.index(place) % len(COLOURS)][run.beside is not None]


def over_cycle(runs: Sequence[Run], cyclic: Sequence[Run]) -> list[Figure]:
    """All figures over percent of the gait cycle, of the runs that have cycles."""
    several = any(run.gathered.mean.count > 1 for run in cyclic)
    lines = "Thick: mean over the cycles, with one standard deviation; thin: single ones. " if several else ""
    depth = (
        f"Grey: peak deformations in vivo, {DEPTH.lowest:.2f} to {DEPTH.highest:.2f} mm if the cartilage is "
        f"{CARTILAGE_THICKNESS:g} mm thick. {cited([DEPTH])}. A depth here is what the contact law makes of the force, "
        "no measured deformation. "
    )
    bone = "Dotted: where the second layer, bone, begins." if any(map(has_bone, cyclic)) else ""
    captions = {FLEXION: "The short line at the bottom is toe-off.", FORCE: force_caption(cyclic), DEPTHS: depth + bone}
    if moves(cyclic):
        captions[POINT] = "Position on the tibial plateau, from the tibia frame's origin, anterior positive."
    found = [
        Figure(each.name, f"{each.title} over the gait cycle", lines + caption,
               draw(SIZE, partial(panel, runs=runs, cyclic=cyclic, what=each)))
        for each, caption in captions.items()
    ]  # fmt: skip
    if moves(cyclic):
        path = draw(SIZE, partial(path_panel, runs=runs, cyclic=cyclic))
        caption = "Its way over the gait cycle: dot at heel strike, triangle at toe-off."
        found.append(Figure("contact_point_flexion", "Contact point over flexion", caption, path))
    return found


def moves(cyclic: Sequence[Run]) -> bool:
    """Whether the contact point moves in any of the runs."""
    points = [POINT.of(run.gathered.mean.mean, run) for run in cyclic]
    return any(float(np.ptp(each)) > LEAST_WAY for each in points)


def force_caption(cyclic: Sequence[Run]) -> str:
    """What the ranges behind the forces are."""
    ranges = ranges_of(cyclic)
    if not ranges:
        return "No published range is drawn: some of the runs are of the whole joint, and some of one compartment."
    about = "total" if ranges == TOTAL else "medial"
    return (
        f"The load of these runs is the {about} one. Behind the curves, published {about} forces in BW: "
        f"{'; '.join(dict.fromkeys(each.text for each in ranges))}. They are peaks, drawn where peaks are expected; "
        f"the sources give no curve. {cited(ranges)}."
    )


def ranges_of(cyclic: Sequence[Run]) -> tuple[Range, ...]:
    """Published forces to compare with; none where total and compartment forces are mixed."""
    kinds = {is_total(run.parameters) for run in cyclic}
    if len(kinds) != 1:
        return ()
    return TOTAL if kinds.pop() else MEDIAL


def panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run], what: Quantity) -> None:
    """One quantity of all runs."""
    axis = canvas.subplots()
    if what is FORCE:
        draw_ranges(axis, ranges_of(cyclic))
    if what is DEPTHS:
        axis.axhspan(DEPTH.lowest, DEPTH.highest, color="0.93", zorder=0, label=DEPTH.text)
        for layer in sorted({run.parameters.contact.layer_depth for run in cyclic if has_bone(run)}):
            axis.axhline(MM * layer, color="0.35", linestyle=":", linewidth=1.2)
            axis.annotate(f"bone from {MM * layer:g} mm", (99.0, MM * layer), ha="right", va="bottom", fontsize=8.5)
    for run in cyclic:
        if what is not FLEXION or run.beside is None:  # a comparison has the same
            line(axis, run, colour(runs, run), what)
    axis.set(xlabel="gait cycle [%]", ylabel=what.axis, xlim=(0.0, 100.0))
    if what in {FORCE, DEPTHS}:
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]) if lowest(cyclic, what) < 0.0 else 0.0)
    legend(canvas, axis)


def line(axis: Any, run: Run, hue: str, what: Quantity) -> None:
    """Mean, spread, single cycles and toe-off of a run."""
    mean = run.gathered.mean
    values = what.of(mean.mean, run)
    style = "-" if run.beside is None else "--"
    deviation = mean.deviation
    if deviation is not None:
        spread = what.of(deviation, run)
        axis.fill_between(PERCENT, values - spread, values + spread, color=hue, alpha=0.15, linewidth=0)
        for single in mean.first if mean.count <= len(mean.first) else ():
            axis.plot(PERCENT, what.of(single, run), style, color=hue, linewidth=0.5, alpha=0.5)
    width = 1.8 if run.beside is None else 1.3
    axis.plot(
        PERCENT, values, style, color=hue, linewidth=width, label=plain(run.name if what is FLEXION else run.label)
    )
    stance = np.mean([cycle.span.stance for cycle in run.gathered.cycles])
    axis.axvline(stance, ymax=0.05, color=hue, linewidth=1.2, linestyle=style)


def lowest(cyclic: Sequence[Run], what: Quantity) -> float:
    """The lowest value of all mean curves, below 0 where a law with tension pulls."""
    return min(float(what.of(run.gathered.mean.mean, run).min()) for run in cyclic)


def path_panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run]) -> None:
    """Contact point over flexion angle."""
    axis = canvas.subplots()
    for run in cyclic:
        mean, hue = run.gathered.mean.mean, colour(runs, run)
        angle, point = FLEXION.of(mean, run), POINT.of(mean, run)
        toe_off = round(float(np.mean([cycle.span.stance for cycle in run.gathered.cycles])))
        axis.plot(angle, point, "-" if run.beside is None else "--", color=hue, linewidth=1.6, label=plain(run.label))
        axis.plot(angle[0], point[0], "o", color=hue, markersize=5)
        axis.plot(angle[toe_off], point[toe_off], "^", color=hue, markersize=6)
    axis.set(xlabel=FLEXION.axis, ylabel=POINT.axis)
    legend(canvas, axis)


def draw_ranges(axis: Any, ranges: Sequence[Range]) -> None:
    """Published peaks behind the curves."""
    for each, shade in zip(ranges, ("0.88", "0.76", "0.76"), strict=False):
        begin, end = each.window
        if each.lowest == each.highest:
            axis.plot((begin, end), (each.lowest,) * 2, color="0.5", linewidth=3.0, zorder=0, label=each.text)
        else:
            box = {"facecolor": shade, "edgecolor": "none", "zorder": 0, "alpha": 0.7}
            axis.fill_between((begin, end), each.lowest, each.highest, label=each.text, **box)


def legend(canvas: Any, axis: Any) -> None:
    """Below the axes, each text once."""
    handles, labels = axis.get_legend_handles_labels()
    once = dict(zip(reversed(labels), reversed(handles), strict=True))
    order = list(dict.fromkeys(labels))
    columns = 2 if len(order) > 3 and max(map(len, order)) <= WIDE else 1
    canvas.legend([once[label] for label in order], order, loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    canvas.set_size_inches(width, height + LINE * -(-len(order) // columns))


def plain(label: str) -> str:
    """A label as matplotlib shows it: dollars are formulas to it, and a leading underscore hides."""
    shown = label.replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def has_bone(run: Run) -> bool:
    """Whether its contact law has a second layer."""
    return run.parameters.contact.law.startswith(TWO_LAYERS)
