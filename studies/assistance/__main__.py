"""Walk with more and more assistance and write docs/studies/assistance.md and its picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import click
import numpy as np

from benchmarks.report import machine
from knee_contact_ros import load_model
from knee_contact_ros.commands.demo import FORCE_LIMIT, LOAD_BAG, LOAD_FILE, largest_load
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.system.files import share_folder
from studies.assistance.walks import (
    LAWS,
    Floats,
    Peaks,
    Walk,
    constant_in_stance,
    person,
    sensors,
    walk,
    walks,
)

COLOURS = ("#0072B2", "#D55E00", "#555555")
"""Okabe and Ito's colours of the laws in their order, and of a knee without assistance"""
LINES: tuple[Any, ...] = ("-", (0, (5, 2)))
SIZE, DPI = (7.5, 5.6), 150
STANCE = (0.55, 1.45)
"""Times [s] of the first stance"""
MM = 1e3
HEADROOM = 1.12
"""Ratio of the axis' upper end to the largest value, which leaves room for the key"""


def draw(
    torques: Sequence[float], found: Mapping[str, Sequence[Walk]], shown: int, path: Path
) -> None:
    """Draw the picture; `shown` is the place of the torque whose stance is drawn below."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic(
        [["force", "depth"], ["stance", "stance"]], height_ratios=(1.0, 0.95)
    )
    _peaks(
        axes["force"],
        torques,
        found,
        lambda peaks: np.array(peaks.force),
        "peak contact force [N]",
    )
    _peaks(
        axes["depth"],
        torques,
        found,
        lambda peaks: MM * np.array(peaks.depth),
        "peak penetration depth [mm]",
    )
    for name in ("force", "depth"):
        axes[name].set_title("whole gait; band: load ± 1 standard deviation", fontsize=9)
    axes["stance"].set_title("first stance, as estimated", fontsize=9)
    axes["force"].legend(loc="lower left", fontsize=8, frameon=False)
    _stance(axes["stance"], found, shown, torques[shown])
    for axis in axes.values():
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8.5)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DPI)


def _peaks(
    axis: Any,
    torques: Sequence[float],
    found: Mapping[str, Sequence[Walk]],
    values: Callable[[Peaks], Floats],
    label: str,
) -> None:
    for (name, series), colour, line in zip(found.items(), COLOURS, LINES, strict=False):
        below, middle, above = np.array([values(each.peaks) for each in series]).T
        axis.fill_between(torques, below, above, color=colour, alpha=0.14, linewidth=0.0)
        axis.plot(torques, middle, color=colour, linestyle=line, linewidth=1.8, label=name)
    axis.set_xlim(torques[0], torques[-1])
    axis.set_ylim(0.0)
    axis.set_xlabel("nominal torque of the assistance [N m]", fontsize=9)
    axis.set_ylabel(label, fontsize=9)


def _stance(axis: Any, found: Mapping[str, Sequence[Walk]], shown: int, torque: float) -> None:
    first = next(iter(found.values()))[0]
    seen = (first.time >= STANCE[0]) & (first.time <= STANCE[1])
    axis.plot(
        first.time[seen], first.force[seen], color=COLOURS[2], linewidth=1.4, label="no assistance"
    )
    for (name, series), colour, line in zip(found.items(), COLOURS, LINES, strict=False):
        force = series[shown].force[seen]
        axis.plot(
            first.time[seen],
            force,
            color=colour,
            linestyle=line,
            linewidth=1.8,
            label=f"{torque:g} N m, {name}",
        )
    axis.set_xlim(*STANCE)
    axis.set_ylim(0.0, HEADROOM * first.force[seen].max())
    axis.set_xlabel("time [s]", fontsize=9)
    axis.set_ylabel("contact force [N]", fontsize=9)
    axis.legend(loc="lower center", fontsize=8, frameon=False)


PAGE = Path(__file__).with_name("page.txt")
TORQUES = [float(torque) for torque in range(41)]
"""Assisting torques [N m]"""
SHOWN, TABLE = 20, (0, 5, 10, 20, 30, 40)
"""Places of the torques whose stance is drawn, and of those in the table's rows"""
MORE = 2.0
"""Factor of the co-contraction that assistance may cause"""


def cells(walk: Walk) -> str:
    """Cells of the table with a walk's peaks."""
    force = "{1:.0f} ({0:.0f} … {2:.0f})".format(*walk.peaks.force)
    depth = "{1:.2f} ({0:.2f} … {2:.2f})".format(*(MM * depth for depth in walk.peaks.depth))
    return f"{force} | {depth}"


def with_more_co_contraction() -> tuple[float, float]:
    """A larger `person.co_contraction`, and the peak contact force [N] with it and without assistance."""
    more = MORE * person().person.co_contraction
    parameters = load_parameters([LOAD_FILE, {"person.co_contraction": more}], LoadParameters)
    found = walk(sensors(), constant_in_stance(0.0), load_model("healthy"), parameters)
    return more, found.peaks.force[1]


def text(torques: Sequence[float], found: Mapping[str, Sequence[Walk]]) -> str:
    """Text of the whole page."""
    constant, law = (found[name] for name in LAWS)
    forces = np.array([walk.peaks.force for walk in constant])
    middle, best = forces[:, 1], int(forces[:, 1].argmin())
    parameters, (more, higher) = person(), with_more_co_contraction()
    weight, level = parameters.person.constants.weight, parameters.chosen_level
    deviation = LOAD_LEVELS[level].uncalibrated
    recorded = largest_load(share_folder() / "bags" / LOAD_BAG)
    numbers = {
        "machine": machine(),
        "most": f"{torques[-1]:g}",
        "limit": f"{FORCE_LIMIT:g}",
        "floor": f"{deviation.floor:g}",
        "part": f"{deviation.part:g}",
        "deviation": f"{deviation.deviation_of(constant[0].axial.max(), weight):.0f}",
        "shown": f"{torques[SHOWN]:g}",
        "rows": "\n".join(
            f"| {torques[i]:g} | {cells(constant[i])} | {cells(law[i])} |" for i in TABLE
        ),
        "slope": f"{(middle[0] - middle[best]) / max(torques[best], 1.0):.1f}",
        "least": f"{middle[best]:.0f}",
        "best": f"{torques[best]:g}",
        "law": f"{middle[0] - min(walk.peaks.force[1] for walk in law):.0f}",
        "effect": f"{middle[0] - middle[best]:.0f}",
        "band": f"{forces[best, 2] - middle[best]:.0f}",
        "given": f"{parameters.person.co_contraction:g}",
        "doubled": f"{more:g}",
        "co": f"{higher - middle[0]:.0f}",
        "recorded": f"{recorded:.0f}",
        "estimated": f"{constant[0].axial.max():.0f}",
    }
    return Template(PAGE.read_text(encoding="utf-8")).substitute(numbers)


@click.command()
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default="docs",
    show_default=True,
    help="Gets studies/ and images/.",
)
def main(output: Path) -> None:
    """Compute the walks, draw the picture and write the page."""
    found = dict(walks(TORQUES))
    draw(TORQUES, found, SHOWN, output / "images" / "assistance.png")
    (output / "studies" / "assistance.md").write_text(text(TORQUES, found), encoding="utf-8")


if __name__ == "__main__":
    main()
