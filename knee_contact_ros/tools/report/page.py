"""The report's page: a single HTML file that needs no other file."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

from knee_contact_ros import __version__
from knee_contact_ros.streams.topics import is_lateral
from knee_contact_ros.tools.report import words
from knee_contact_ros.tools.report.comparison import between
from knee_contact_ros.tools.report.figures import Figure
from knee_contact_ros.tools.report.over_cycle import moves
from knee_contact_ros.tools.report.published import SOURCES, which_load
from knee_contact_ros.tools.report.runs import Run, prescribed
from knee_contact_ros.tools.report.uncertain import contribution_table, interval_table

TEMPLATE = "report.html.jinja"


def page(
    runs: Sequence[Run],
    knee_figures: Sequence[Figure],
    cycle_figures: Sequence[Figure],
    time_figures: Sequence[Figure],
    uncertain_figures: Sequence[Figure],
) -> str:
    """Render the page as HTML text from the runs and their figures."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(__package__ or "", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    cyclic = [run for run in runs if run.gathered.cycles]
    bases = [run for run in runs if run.beside is None]
    return environment.get_template(TEMPLATE).render(
        title=f"Knee contact: {', '.join(run.name for run in bases)}",
        lead=lead(runs),
        loads="; ".join(dict.fromkeys(which_load(run.parameters) for run in runs if not prescribed(run.parameters))),
        prescribed=[run.label for run in runs if prescribed(run.parameters)],
        version=__version__,
        doubts=[(run.label, sentence) for run in runs for sentence in run.gathered.totals.doubts.sentences],
        first=words.first_table(runs),
        differences=what_differs(runs),
        kept=[f"{run.label} keeps of its own: {'; '.join(run.kept)}" for run in runs if run.kept],
        knee_figures=knee_figures,
        overview=words.run_table(runs),
        cycles=words.cycle_table(cyclic),
        cycle_figures=cycle_figures,
        still=bool(cyclic) and not moves(cyclic),
        time_figures=[
            {"figure": figure, "label": run.name, "events": words.event_table(run)}
            for figure, run in zip(time_figures, bases, strict=True)
        ],
        uncertain=[
            {
                "label": run.label,
                "figure": figure,
                "intervals": interval_table(run, run.uncertain),
                "contributions": contribution_table(run, run.uncertain),
            }
            for figure, run in zip(uncertain_figures, (run for run in runs if run.uncertain), strict=True)
            if run.uncertain
        ],
        without_cycles=[run.label for run in runs if not run.gathered.cycles],
        runs=[section(run) for run in runs],
        compared=any(run.beside is not None for run in runs),
        sources=SOURCES,
    )


def what_differs(runs: Sequence[Run]) -> list[str]:
    """List the parameters that differ, a line for each: of comparisons, and of the recordings among themselves."""
    changes = {run.name: [f"contact.{each}" for each in run.differences] for run in runs if run.beside is not None}
    if len(set(map(tuple, changes.values()))) == 1:
        lines = next(iter(changes.values()))
    else:
        lines = [f"{name}: {line}" for name, several in changes.items() for line in several]
    if changes and not lines:
        lines = ["the comparison changes nothing"]
    return lines + between([run.parameters for run in runs if run.beside is None and run.known])


def lead(runs: Sequence[Run]) -> str:
    """Summarise the page in a sentence; both compartments of a knee have the same ticks and cycles, counted once."""
    knees = [run for run in runs if run.beside is None and not is_lateral(run.topic)]
    cycles = sum(len(run.gathered.cycles) for run in knees)
    ticks = sum(run.gathered.totals.ticks for run in knees)
    each = ", each" if len({run.source for run in runs}) > 1 else ","
    compared = f"{each} computed again with another contact law" if any(run.beside is not None for run in runs) else ""
    files = len({run.source for run in runs})
    return (
        f"Tibiofemoral contact in {files} recording{'s' * (files != 1)}{compared}: {ticks} ticks, "
        f"{cycles} whole gait cycle{'s' * (cycles != 1)}."
    )


def section(run: Run) -> dict[str, Any]:
    """Content of the page's sections on a single run, by the names in the template."""
    return {
        "label": run.label,
        "origin": run.origin,
        "source": run.source.name,
        "damage": run.damage,
        "peaks": words.peak_table(run),
        "parameters": words.parameter_table(run),
    }
