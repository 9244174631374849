"""Figures of the knee at the peaks of stance: femur on tibia, and below it the contact of each run, magnified."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.tools.report.figures import Figure, differences_in, draw, plain, with_comparisons
from knee_contact_ros.tools.report.gather import Moment
from knee_contact_ros.tools.report.peaks import FIRST, SECOND, stance_peaks
from knee_contact_ros.tools.report.runs import Run
from knee_contact_ros.view import picture
from knee_contact_ros.view.anatomy import cartilage_of

WIDTH, KNEE, CONTACT = 5.2, 3.1, 1.45
"""Width of the figure, height of a knee and height of a magnified contact [in]"""
CAPTION = (
    "Side view; the arrow is the contact force on the femur. Below, the contact with its heights "
    "magnified: dark is where the surfaces would overlap if neither gave way; the number is the depth. The surfaces "
    "that touch are the model's; the shafts are drawn around them"
)
ASSUMED = ", and so is cartilage whose thickness the contact law does not know"


class Peak(NamedTuple):
    """Peak of stance, or another moment, at which the knee is drawn."""

    title: str
    moment: Moment


def knees(runs: Sequence[Run]) -> list[Figure]:
    """Draw a figure for every run and its comparisons, as far as their surfaces are known."""
    figures = []
    drawn = {run.label: [shown(run, run.model, peak) for peak in drawn_peaks(run)] for run in runs if run.model}
    window = picture.Window.around([each for moments in drawn.values() for each in moments]) if drawn else None
    for number, group in enumerate(with_comparisons(runs), start=1):
        if window is None or any(run.label not in drawn for run in group):
            continue
        columns = list(zip(*(drawn[run.label] for run in group), strict=True))
        titles = [peak.title for peak in drawn_peaks(group[0])]
        labels = [run.label for run in group]
        size = (WIDTH, KNEE + CONTACT * len(group))
        png = draw(size, partial(paint, labels=labels, titles=titles, columns=columns, window=window))
        assumed = any(cartilage_of(run.model)[1] for run in group if run.model)
        caption = f"{CAPTION}{ASSUMED if assumed else ''}. {differences_in(group)}"
        figures.append(Figure(f"knee_{number}", f"The knee at the peaks: {group[0].name}", caption, png))
    return figures


def drawn_peaks(run: Run) -> list[Peak]:
    """Largest first and largest second peak of stance of a run; without any, its largest load or contact force."""
    peaks, drawn = stance_peaks(run.gathered), list[Peak]()
    for which in (FIRST, SECOND):
        if same := [peak for peak in peaks if peak.which == which]:
            largest = max(same, key=lambda peak: peak.moment.load)
            drawn.append(Peak(f"{which} peak, {largest.percent:.0f} % of the cycle", largest.moment))
    if not drawn and (moment := run.gathered.largest):
        drawn.append(Peak(f"{moment.event.kind}, {moment.elapsed:.2f} s", moment))
    return drawn


def paint(
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
                axis.set_title(plain(label), fontsize=8.5, loc="left", pad=3)


def shown(run: Run, model: KneeModel, peak: Peak) -> picture.Moment:
    """State of a run's knee at a peak, for the picture."""
    moment, weight = peak.moment, run.parameters.body_weight
    return picture.Moment(model, moment.flexion_angle, moment.femoral_height, moment.contact_force, weight)
