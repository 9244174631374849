"""What the figures of the report share: size, colours, captions and legends; pictures are in PNG format."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from knee_contact_ros.tools.report.comparison import between
from knee_contact_ros.tools.report.runs import Run

COLOURS = (("#0072B2", "#56B4E9"), ("#D55E00", "#E69F00"), ("#009E73", "#66C2A5"), ("#7B3294", "#CC79A7"))
"""Pairs of line colours: the dark one for a run, or for a comparison; the light one for a run over which a comparison
is drawn. After Okabe and Ito, whose colours colour-blind readers can tell apart"""
LINE, WIDE = 0.19, 34
"""Height of a line of the legend [in]; largest number of letters of an entry where the legend has two columns"""
DPI = 200
MM = 1e3
STYLE: Any = {"font.size": 10, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False,
         "axes.grid": True, "grid.color": "0.92", "axes.axisbelow": True, "legend.frameon": False,
         "legend.fontsize": 8.5, "figure.dpi": DPI}  # fmt: skip
TWO_LAYERS = "two_layer"


class Figure(NamedTuple):
    """Picture of the report with its title and caption."""

    name: str
    """Name of the picture's file, without the suffix"""
    title: str
    caption: str
    """One or two sentences below the picture"""
    png: bytes
    """The picture in PNG format"""


def with_comparisons(runs: Sequence[Run]) -> list[list[Run]]:
    """Group runs: each run that is no comparison, followed by the comparisons with it."""
    return [
        [run, *(other for other in runs if other.beside == place)]
        for place, run in enumerate(runs)
        if run.beside is None
    ]


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


def colour(runs: Sequence[Run], run: Run) -> str:
    """Line colour of a run; lighter for a run with a comparison, which is drawn over it."""
    place = runs.index(run) if run.beside is None else run.beside
    bases = [index for index, each in enumerate(runs) if each.beside is None]
    compared = any(each.beside == place for each in runs)
    return COLOURS[bases.index(place) % len(COLOURS)][compared and run.beside is None]


def differences_in(runs: Sequence[Run]) -> str:
    """Say in which parameters the runs of a figure differ: comparisons from their runs, and recordings among them."""
    texts = {run.name: "; ".join(map(str, run.differences)) for run in runs if run.beside is not None}
    if len(set(texts.values())) == 1:
        texts = {"What differs": next(iter(texts.values()))}
    lines = [f"{name}: {text or 'nothing differs'}." for name, text in texts.items()]
    differ = between([run.parameters for run in runs if run.beside is None and run.known])
    if differ:
        lines.append(f"The recordings' own parameters differ: {'; '.join(differ)}.")
    return " ".join(lines)


def sentences(*parts: str) -> str:
    """Join the parts of a caption that are not empty."""
    return " ".join(part.strip() for part in parts if part.strip())


def looks(run: Run, hue: str) -> tuple[str, float]:
    """Style and width of a run's line; lines drawn later are thinner, so that those below can be seen."""
    if run.beside is not None:
        return "--", 1.3
    number = next((place for place, (dark, _) in enumerate(COLOURS) if hue == dark), None)
    return "-", 3.2 if number is None else max(3.2 - 0.8 * number, 1.2)


def legend(canvas: Any, axis: Any) -> None:
    """Add a legend below the axes, with each text once, and make the figure higher by the legend's height."""
    handles, labels = axis.get_legend_handles_labels()
    once = dict(zip(reversed(labels), reversed(handles), strict=True))
    order = list(dict.fromkeys(labels))
    columns = 2 if len(order) > 3 and max(map(len, order)) <= WIDE else 1
    canvas.legend([once[label] for label in order], order, loc="outside lower center", ncols=columns)
    width, height = canvas.get_size_inches()
    canvas.set_size_inches(width, height + LINE * -(-len(order) // columns))


def plain(label: str) -> str:
    """Escape a label for matplotlib, where dollars begin formulas and a leading underscore hides the entry."""
    escaped = label.replace("$", r"\$")
    return f" {escaped}" if escaped.startswith("_") else escaped


def has_bone(run: Run) -> bool:
    """Whether the contact law of a run has a second layer, the bone."""
    return run.parameters.contact.law.startswith(TWO_LAYERS)
