"""Figures over percent of the gait cycle."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros.model.readouts import OWN_PRESSURE
from knee_contact_ros.streams.topics import is_lateral
from knee_contact_ros.tools.report.cycles import CURVES, PERCENT, Floats
from knee_contact_ros.tools.report.figures import (
    MM,
    Figure,
    colour,
    differences_in,
    draw,
    has_bone,
    legend,
    looks,
    plain,
    sentences,
)
from knee_contact_ros.tools.report.published import CARTILAGE_THICKNESS, DEPTH, MEDIAL, TOTAL, Range, is_total
from knee_contact_ros.tools.report.runs import Run

SIZE = (5.2, 3.1)
"""Width and height of a figure without its legend [in]: small, so that its letters can be read on a telephone"""
ALIKE = 0.005
"""Largest difference of curves that are drawn once, as a share of the range of all curves"""
THINNEST, STEP = 1.8, 1.6
"""Line widths of contact-point paths over flexion: paths of the same femur coincide, and each must be seen"""
TOGETHER = 1.5
"""Percent of the cycle within which toe-offs of several runs are marked once"""
LEAST_WAY = 0.01
"""Smallest motion of the contact point [mm] for which it is drawn"""


class Quantity(NamedTuple):
    """Quantity that a figure over the gait cycle shows."""

    name: str
    title: str
    axis: str
    """Label of the vertical axis, with the unit in brackets"""
    column: str
    """Name of the column of the curves"""
    factor: float | None
    """Factor from SI units to the unit of the axis; None: the quantity is a force in body weights"""

    def of(self, curves: Floats, run: Run) -> Floats:
        """Values in the unit of the axis, shape (101,), from curves of a run in SI units, shape (101, `CURVES`)."""
        values = curves[:, CURVES.index(self.column)]
        return values / run.parameters.body_weight if self.factor is None else self.factor * values


FLEXION = Quantity("flexion", "Flexion angle", "flexion angle [°]", "flexion_angle", float(np.degrees(1.0)))
FORCE = Quantity("contact_force", "Contact force", "contact force [BW]", "contact_force", None)
DEPTHS = Quantity("depth", "Penetration depth", "penetration depth [mm]", "penetration_depth", MM)
POINT = Quantity(
    "contact_point", "Contact point along the plateau", "contact point, anterior [mm]", "contact_point_x", MM
)
PRESSURE = Quantity("peak_pressure", "Peak contact pressure", "peak pressure [MPa]", "peak_pressure", 1e-6)
PATCH = Quantity("patch_half_width", "Half-width of the contact patch", "half-width [mm]", "half_width", MM)


def over_cycle(runs: Sequence[Run], cyclic: Sequence[Run]) -> list[Figure]:
    """Draw all figures over percent of the gait cycle; `cyclic` are those of `runs` that have gait cycles."""
    several = any(run.gathered.mean.count > 1 for run in cyclic)
    lines = "Thick: mean over the cycles, with one standard deviation; thin: single ones. " if several else ""
    depth = (
        f"Grey: peak deformations in vivo, {DEPTH.lowest:.2f} to {DEPTH.highest:.2f} mm if the cartilage is "
        f"{CARTILAGE_THICKNESS:g} mm thick. A depth here is what the contact law makes of the force, "
        "no measured deformation. "
    )
    bone = "Dotted: where the second layer, bone, begins." if any(map(has_bone, cyclic)) else ""
    captions = {FORCE: force_caption(cyclic), DEPTHS: depth + bone, FLEXION: ""}
    if all(run.gathered.reads_off for run in cyclic):
        captions[PRESSURE] = spread_caption(cyclic)
        captions[PATCH] = "Of a round patch, from the depth and the radii of the law. "
    if moves(cyclic):
        captions[POINT] = "Position on the tibial plateau, from the tibia frame's origin, anterior positive. "
    figures = []
    for quantity, caption in captions.items():
        drawn = cyclic
        if quantity is FLEXION:  # a comparison has the same
            drawn = [run for run in cyclic if run.beside is None]
        text = sentences(lines, caption, distances_of_curves(drawn, quantity), differences_in(cyclic))
        png = draw(SIZE, partial(panel, runs=runs, cyclic=drawn, what=quantity))
        figures.append(Figure(quantity.name, f"{quantity.title} over the gait cycle", text, png))
    if moves(cyclic):
        path = draw(SIZE, partial(path_panel, runs=runs, cyclic=cyclic))
        caption = sentences(
            "Its way over the gait cycle: dot at heel strike, triangle at toe-off.", differences_in(runs)
        )
        figures.append(Figure("contact_point_flexion", "Contact point over flexion", caption, path))
    return figures


def pressure_of(run: Run) -> str:
    """Say how the pressure of a run follows from its contact law, for a caption or a cell of a table."""
    patch = run.model.patch if run.model else None
    if patch is None:
        return "not known"
    spread = f"{patch.spread.name}, R {MM * patch.radius:.1f} mm, cartilage {MM * patch.thickness:.2g} mm"
    own = run.parameters.contact.law in OWN_PRESSURE
    return spread if own else f"none of the law's own; its force at rest is spread as {spread}"


def spread_caption(cyclic: Sequence[Run]) -> str:
    """Caption of the peak pressure: how it follows from each contact law."""
    laws = dict.fromkeys(f"{run.parameters.contact.law}: {pressure_of(run)}" for run in cyclic)
    return f"In the middle of the patch. {'; '.join(laws)}. "


def alike(cyclic: Sequence[Run], *quantities: Quantity) -> list[list[Run]]:
    """Group runs whose curves of all quantities are the same within `tolerance`; the first of each group is drawn."""
    most = [tolerance(cyclic, what) for what in quantities]
    groups: list[list[Run]] = []
    for run in cyclic:
        for group in groups:
            if all(difference(group[0], run, what)[0] <= limit for what, limit in zip(quantities, most, strict=True)):
                group.append(run)
                break
        else:
            groups.append([run])
    return groups


def tolerance(cyclic: Sequence[Run], what: Quantity) -> float:
    """Largest difference of curves that are drawn once, in the unit of the quantity's axis."""
    values = [what.of(run.gathered.mean.mean, run) for run in cyclic]
    return ALIKE * float(np.nanmax(values) - np.nanmin(values))


def difference(one: Run, other: Run, what: Quantity) -> tuple[float, int]:
    """Largest difference of two mean curves, in the unit of the quantity's axis, and the percent at which it is."""
    distances = np.abs(what.of(one.gathered.mean.mean, one) - what.of(other.gathered.mean.mean, other))
    return float(distances.max()), int(distances.argmax())


def distances_of_curves(cyclic: Sequence[Run], what: Quantity) -> str:
    """Say how far the curves of comparisons are from those of their runs, and which curves are drawn once."""
    unit = what.axis[what.axis.index("[") + 1 : what.axis.index("]")]
    same = [group for group in alike(cyclic, what) if len(group) > 1]
    drawn_once = (
        f"Curves with “=” are the same within {tolerance(cyclic, what):.2g} {unit}, and drawn once." if same else ""
    )
    other = [(run, next(each for each in cyclic if each.name == run.name and each.beside is None)) for run in cyclic
             if run.beside is not None and not any(run in group for group in same)]  # fmt: skip
    largest = ", ".join(
        f"{run.name} {size:.2g} {unit} (at {at} %)" for run, base in other for size, at in [difference(base, run, what)]
    )
    return sentences(drawn_once, f"Largest difference of dashed to full: {largest}." if largest else "")


def moves(cyclic: Sequence[Run]) -> bool:
    """Whether the contact point moves along the plateau in any of the runs."""
    points = [POINT.of(run.gathered.mean.mean, run) for run in cyclic]
    return any(float(np.ptp(each)) > LEAST_WAY for each in points)


def force_caption(cyclic: Sequence[Run]) -> str:
    """Caption of the contact force: what the published ranges behind the curves are."""
    ranges = ranges_of(cyclic)
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


def ranges_of(cyclic: Sequence[Run]) -> tuple[Range, ...]:
    """Published ranges to show behind contact forces; none where runs of the whole joint and of a compartment mix."""
    kinds = {is_total(run.parameters) for run in cyclic if not is_lateral(run.topic)}
    if len(kinds) != 1:
        return ()
    return TOTAL if kinds.pop() else MEDIAL


def panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run], what: Quantity) -> None:
    """Draw a quantity of the runs `cyclic` over the gait cycle; `runs` are all of the report, for the colours."""
    axis = canvas.subplots()
    if what is FORCE:
        draw_ranges(axis, ranges_of(cyclic))
    if what is DEPTHS:
        axis.axhspan(DEPTH.lowest, DEPTH.highest, color="0.93", zorder=0, label=DEPTH.text)
        for layer in sorted({run.parameters.contact.layer_depth for run in cyclic if has_bone(run)}):
            axis.axhline(MM * layer, color="0.35", linestyle=":", linewidth=1.2)
            axis.annotate(f"bone from {MM * layer:g} mm", (99.0, MM * layer), ha="right", va="bottom", fontsize=8.5)
    for group in alike(cyclic, what):
        name = " = ".join(run.name for run in group) if what is FLEXION else joined(group)
        line(axis, group[0], colour(runs, group[0]), what, name)
    toe_offs(axis, runs, cyclic)
    axis.set(xlabel="gait cycle [%]", ylabel=what.axis, xlim=(0.0, 100.0))
    if what in {FORCE, DEPTHS, PRESSURE, PATCH}:
        axis.set_ylim(bottom=min(0.0, axis.get_ylim()[0]) if lowest(cyclic, what) < 0.0 else 0.0)
    legend(canvas, axis)


def line(axis: Any, run: Run, hue: str, what: Quantity, name: str) -> None:
    """Draw mean, standard deviation and single cycles of a run, with a name for the legend."""
    mean = run.gathered.mean
    values = what.of(mean.mean, run)
    style, width = looks(run, hue)
    deviation = mean.deviation
    if deviation is not None:
        spread = what.of(deviation, run)
        axis.fill_between(PERCENT, values - spread, values + spread, color=hue, alpha=0.15, linewidth=0)
        for single in mean.first if mean.count <= len(mean.first) else ():
            axis.plot(PERCENT, what.of(single, run), style, color=hue, linewidth=0.5, alpha=0.5)
    axis.plot(PERCENT, values, style, color=hue, linewidth=width, label=plain(name))


def joined(group: Sequence[Run]) -> str:
    """Name in the legend for a group of runs whose curves are the same."""
    if len({run.name for run in group}) == 1 and len(group) > 1:  # what a comparison does not change
        tails = [run.label.removeprefix(run.name).lstrip(", ") for run in group]
        return ", ".join(filter(None, (group[0].name, " = ".join(filter(None, tails)))))
    return " = ".join(run.label for run in group)


def toe_offs(axis: Any, runs: Sequence[Run], cyclic: Sequence[Run]) -> None:
    """Mark the mean end of stance of each run, or once if all are close together."""
    bases = [run for run in cyclic if run.beside is None]
    stances = [float(np.mean([cycle.span.stance for cycle in run.gathered.cycles])) for run in bases]
    if max(stances) - min(stances) <= TOGETHER:
        marks = [(float(np.mean(stances)), "0.45")]
    else:
        marks = [(stance, colour(runs, run)) for stance, run in zip(stances, bases, strict=True)]
    for place, hue in marks:
        axis.axvline(place, color=hue, linewidth=1.0, linestyle=(0, (1, 2)), zorder=0.5)
    axis.annotate("toe-off", (float(np.mean([place for place, _ in marks])), 1.0), (0, 2), ha="center", va="bottom",
                  xycoords=("data", "axes fraction"), textcoords="offset points", fontsize=8, color="0.35")  # fmt: skip


def lowest(cyclic: Sequence[Run], what: Quantity) -> float:
    """Lowest value of all mean curves; it is below 0 where a contact law with tension pulls."""
    return min(float(what.of(run.gathered.mean.mean, run).min()) for run in cyclic)


def path_panel(canvas: Any, runs: Sequence[Run], cyclic: Sequence[Run]) -> None:
    """Draw the contact point over the flexion angle."""
    axis = canvas.subplots()
    groups = alike(cyclic, POINT, FLEXION)
    for number, group in enumerate(groups):
        run = group[0]
        mean, hue = run.gathered.mean.mean, colour(runs, run)
        angle, point = FLEXION.of(mean, run), POINT.of(mean, run)
        toe_off = round(float(np.mean([cycle.span.stance for cycle in run.gathered.cycles])))
        width = THINNEST + STEP * (len(groups) - 1 - number)
        axis.plot(angle, point, color=hue, linewidth=width, label=plain(joined(group)))
        axis.plot(angle[0], point[0], "o", color=hue, markersize=6, markeredgecolor="black", zorder=3)
        axis.plot(angle[toe_off], point[toe_off], "^", color=hue, markersize=7, markeredgecolor="black", zorder=3)
    axis.set(xlabel=FLEXION.axis, ylabel=POINT.axis)
    legend(canvas, axis)


def draw_ranges(axis: Any, ranges: Sequence[Range]) -> None:
    """Draw published ranges of peaks behind the curves."""
    for each, shade in zip(ranges, ("0.88", "0.76", "0.76"), strict=False):
        begin, end = each.window
        if each.lowest == each.highest:
            axis.plot((begin, end), (each.lowest,) * 2, color="0.5", linewidth=3.0, zorder=0, label=each.text)
        else:
            box = {"facecolor": shade, "edgecolor": "none", "zorder": 0, "alpha": 0.7}
            axis.fill_between((begin, end), each.lowest, each.highest, label=each.text, **box)
