"""The figures of the knee at the peaks: femur on tibia, below the contact magnified, of a run and its comparison."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

from knee_contact_ros.tools.report.figures import Figure, draw, plain, told
from knee_contact_ros.tools.report.gather import Moment
from knee_contact_ros.tools.report.peaks import FIRST, SECOND, StancePeak, stance_peaks
from knee_contact_ros.tools.report.runs import Run
from knee_contact_ros.view import picture
from knee_contact_ros.view.anatomy import cartilage_of

WIDTH, KNEE, CONTACT = 5.2, 3.1, 1.45
"""[in] of the figure, and heights of a knee and of a magnified contact"""
CAPTION = (
    "Side view; the arrow is the contact force on the femur. Below, the contact with its heights "
    "magnified: dark is where the surfaces would overlap if neither gave way; the number is the depth. The surfaces "
    "that touch are the model's; the shafts are drawn around them"
)
ASSUMED = ", and so is cartilage whose thickness the contact law does not know"


class Peak(NamedTuple):
    """A peak that is drawn."""

    title: str
    moment: Moment


def knees(runs: Sequence[Run]) -> list[Figure]:
    """A figure for every run with its comparison, as far as its surfaces are known."""
    found = []
    drawn = {run.label: [shown(run, peak) for peak in drawn_peaks(run)] for run in runs if run.model}
    window = picture.Window.around([each for moments in drawn.values() for each in moments]) if drawn else None
    for number, run in enumerate(each for each in runs if each.beside is None):
        several = [run, *(each for each in runs if each.beside == runs.index(run))]
        if window is None or any(each.label not in drawn for each in several):
            continue
        columns = list(zip(*(drawn[each.label] for each in several), strict=True))
        titles = [peak.title for peak in drawn_peaks(run)]
        labels = [each.label for each in several]
        size = (WIDTH, KNEE + CONTACT * len(several))
        png = draw(size, partial(paint, labels=labels, titles=titles, columns=columns, window=window))
        assumed = any(cartilage_of(each.model)[1] for each in several if each.model)
        caption = f"{CAPTION}{ASSUMED if assumed else ''}. {told(several)}"
        found.append(Figure(f"knee_{number + 1}", f"The knee at the peaks: {run.name}", caption, png))
    return found


def drawn_peaks(run: Run) -> list[Peak]:
    """The largest first and second peak of stance; where there is none, the largest load or force."""
    peaks = stance_peaks(run.gathered)
    found = [
        Peak(titled(largest), largest.moment) for which in (FIRST, SECOND) if (largest := largest_of(peaks, which))
    ]
    if not found and run.gathered.largest:
        moment = run.gathered.largest
        found = [Peak(f"{moment.event.kind}, {moment.elapsed:.2f} s", moment)]
    return found


def largest_of(peaks: Sequence[StancePeak], which: str) -> StancePeak | None:
    """The largest of the first or of the second peaks."""
    same = [peak for peak in peaks if peak.which == which]
    return max(same, key=lambda peak: peak.moment.load) if same else None


def titled(peak: StancePeak) -> str:
    """A peak's name, when it was and how far the knee was bent."""
    return f"{peak.which} peak, {peak.percent:.0f} % of the cycle"


def paint(
    canvas: Any, labels: Sequence[str], titles: Sequence[str], columns: Sequence[Sequence[picture.Moment]],
    window: picture.Window,
) -> None:  # fmt: skip
    """A column for every peak: the knee, and below it the contact of every run."""
    axes = canvas.subplots(1 + len(labels), len(columns), squeeze=False, height_ratios=(KNEE, *[CONTACT] * len(labels)))
    for column, (title, moments) in enumerate(zip(titles, columns, strict=True)):
        picture.draw_knee(axes[0, column], moments[0])
        bent = f"{math.degrees(moments[0].flexion_angle):.0f}° of flexion"
        axes[0, column].set_title(f"{title}\n{bent}", fontsize=9.5)
        for axis, label, moment in zip(axes[1:, column], labels, moments, strict=True):
            picture.draw_contact(axis, moment, window)
            if len(labels) > 1:
                axis.set_title(plain(label), fontsize=8.5, loc="left", pad=3)


def shown(run: Run, peak: Peak) -> picture.Moment:
    """A peak as it is drawn."""
    if run.model is None:  # `knees` leaves it out
        raise ValueError(run.label)
    moment = peak.moment
    return picture.Moment(
        run.model, moment.flexion_angle, moment.femoral_height, moment.contact_force, run.parameters.body_weight
    )
