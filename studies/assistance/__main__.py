"""Walk with more and more assistance and write docs/assistance.md and its picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import click
import numpy as np

from benchmarks.report import machine
from knee_contact_ros import load_model
from knee_contact_ros.commands.demo import FORCE_LIMIT, LOAD_FILE, RECORDED, largest
from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE
from knee_contact_ros.system.files import share_folder
from studies.assistance.figure import MM, draw
from studies.assistance.walks import LAWS, Walk, constant_in_stance, person, sensors, walk, walks

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
    deviation = LEVELS[level].error.uncalibrated
    recorded = largest(share_folder() / "bags" / RECORDED, JOINT_REACTION_FORCE)
    numbers = {
        "machine": machine(),
        "most": f"{torques[-1]:g}", "limit": f"{FORCE_LIMIT:g}", "floor": f"{deviation.floor:g}",
        "part": f"{deviation.part:g}",
        "deviation": f"{deviation.at(constant[0].axial.max(), weight):.0f}",
        "shown": f"{torques[SHOWN]:g}",
        "rows": "\n".join(f"| {torques[i]:g} | {cells(constant[i])} | {cells(law[i])} |" for i in TABLE),
        "slope": f"{(middle[0] - middle[SHOWN]) / torques[SHOWN]:.1f}",
        "least": f"{middle[best]:.0f}", "best": f"{torques[best]:g}",
        "law": f"{middle[0] - min(walk.peaks.force[1] for walk in law):.0f}",
        "effect": f"{middle[0] - middle[best]:.0f}", "band": f"{forces[best, 2] - middle[best]:.0f}",
"given": f"{parameters.person.co_contraction:g}", "doubled": f"{more:g}",
        "co": f"{higher - middle[0]:.0f}",
        "recorded": f"{recorded.axial:.0f}", "estimated": f"{constant[0].axial.max():.0f}",
    }  # fmt: skip
    return Template(PAGE.read_text(encoding="utf-8")).substitute(numbers)


@click.command()
@click.option(
    "--output", type=click.Path(path_type=Path), default="docs", show_default=True, help="Gets the page, and images/."
)
def main(output: Path) -> None:
    """Compute the walks, draw the picture and write the page."""
    found = dict(walks(TORQUES))
    draw(TORQUES, found, SHOWN, output / "images" / "assistance.png")
    (output / "assistance.md").write_text(text(TORQUES, found), encoding="utf-8")


if __name__ == "__main__":
    main()
