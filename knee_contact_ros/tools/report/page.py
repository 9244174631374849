"""The report's page: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

from knee_contact_ros import __version__
from knee_contact_ros.tools.report import words
from knee_contact_ros.tools.report.figures import Figure, moves
from knee_contact_ros.tools.report.in_vivo import SOURCES, which_load
from knee_contact_ros.tools.report.runs import Run

TEMPLATE = "report.html.jinja"


def page(runs: Sequence[Run], cycle_figures: Sequence[Figure], time_figures: Sequence[Figure]) -> str:
    """The page as text."""
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
        loads="; ".join(dict.fromkeys(which_load(run.parameters) for run in runs)),
        version=__version__,
        doubts=[(run.label, sentence) for run in runs for sentence in run.gathered.totals.doubts.sentences],
        overview=words.run_table(runs),
        cycles=words.cycle_table(cyclic),
        cycle_figures=cycle_figures,
        still=bool(cyclic) and not moves(cyclic),
        time_figures=time_figures,
        without_cycles=[run.label for run in runs if not run.gathered.cycles],
        runs=[section(run) for run in runs],
        sources=SOURCES,
    )


def lead(runs: Sequence[Run]) -> str:
    """The page in a sentence."""
    cycles = sum(len(run.gathered.cycles) for run in runs if run.beside is None)
    ticks = sum(run.gathered.totals.ticks for run in runs if run.beside is None)
    compared = ", each computed again with other parameters" if any(run.beside is not None for run in runs) else ""
    files = len({run.source for run in runs})
    return (
        f"Tibiofemoral contact in {files} recording{'s' * (files != 1)}{compared}: {ticks} ticks, "
        f"{cycles} whole gait cycle{'s' * (cycles != 1)}."
    )


def section(run: Run) -> dict[str, Any]:
    """What the page says of a single run."""
    return {
        "label": run.label,
        "origin": run.origin,
        "source": run.source.name,
        "damage": run.damage,
        "peaks": words.peak_table(run),
        "events": words.event_table(run) if run.beside is None else None,
        "parameters": words.parameter_table(run),
    }
