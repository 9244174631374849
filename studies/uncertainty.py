"""Straight lines from the deviations of inputs to those of depth and force, against samples of all inputs at once.

python -m studies.uncertainty [--samples N] [--output FILE]
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.report import Section, machine, save
from knee_contact_ros import UsageError
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.lab.uncertainty import UncertainGait, Uncertainty, read_uncertain_gait
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.files import share_folder

KNEES: dict[str, list[str]] = {
    "circle, Kelvin-Voigt (healthy)": ["healthy"],
    "two layers, first one undamped (as printed)": ["osteoarthritis_as_printed"],
    "both compartments from MRI": ["healthy", "both_compartments"],
}
SMALL = {
    "flexion_angle": 0.01,
    "axial_load": "2 %",
    "medial_share": 0.02,
    "contact.stiffness": "5 %",
    "contact.damping": "10 %",
}
LARGE = {
    "flexion_angle": 0.035,
    "axial_load": "5 %",
    "medial_share": 0.06,
    "contact.stiffness": "20 %",
    "contact.damping": "50 %",
}
SIZES = {"small": SMALL, "as in examples/uncertainty.yaml": LARGE}
TEXT = """\
The shipped gait of the right leg. Sampled over linear: the standard deviation of the samples over that of the straight
lines at each tick, median and the range from the 5th to the 95th percentile of the ticks. Inside: how many samples lie
within the linear 95 % interval, on average over the ticks. Factors are log-normal, offsets normal, all independent and
constant through the gait."""


class Sampled(NamedTuple):
    """Standard deviation of a quantity over samples of the inputs, and share within the linear 95 % interval, (n,)."""

    deviation: NDArray[np.float64]
    inside: NDArray[np.float64]


def sampled(
    gait: UncertainGait, linear: Uncertainty, samples: int
) -> list[tuple[Sampled, Sampled]]:
    """Draw all inputs at once (JCGM 101:2008), and give depth and force of each compartment.

    A sample with a parameter out of its range is drawn again.
    """
    compartments = [linear.medial, *([linear.lateral] if linear.lateral else [])]
    random = np.random.default_rng(0)
    before = [depth_and_force(one.rows) for one in compartments]
    bounds = [np.stack([one.depth_interval(), one.force_interval()], 1) for one in compartments]
    sums = [np.zeros((3, *one.shape)) for one in before]
    done = 0
    while done < samples:
        drawn = random.standard_normal(len(gait.deviations)).tolist()
        try:
            answers = gait.answers(dict(zip(gait.deviations, drawn, strict=True)))
        except UsageError:
            continue
        for place, rows in enumerate(answers):
            now = depth_and_force(rows)
            low, high = bounds[place]
            away = now - before[place]
            sums[place] += np.stack([away, away * away, (low <= now) & (now <= high)])
        done += 1
    results = []
    for first, second, inside in sums:
        spread = np.sqrt(np.maximum(second - first**2 / samples, 0.0) / (samples - 1))
        depth, force = (
            Sampled(each, part) for each, part in zip(spread, inside / samples, strict=True)
        )
        results.append((depth, force))
    return results


def depth_and_force(rows: Any) -> NDArray[np.float64]:
    """Depth [m] and force [N] of answers, shape (2, n)."""
    return np.stack([rows["penetration_depth"], rows["contact_force"]])


def ratios(drawn: NDArray[np.float64], linear: NDArray[np.float64]) -> str:
    """Median and range of a ratio over the ticks, for the table."""
    known = linear > 0.0
    low, middle, high = np.percentile(drawn[known] / linear[known], (5.0, 50.0, 95.0))
    return f"{middle:.2f} ({low:.2f} … {high:.2f})"


@click.command()
@click.option("--samples", default=4000, show_default=True)
@click.option(
    "--output",
    default="docs/studies/uncertainty.md",
    show_default=True,
    type=click.Path(path_type=Path),
)
def main(samples: int, output: Path) -> None:
    """Measure and write the table."""
    rows: list[list[str]] = []
    bag = share_folder() / "bags" / "gait2354_right"
    for name, files in KNEES.items():
        for size, deviations in SIZES.items():
            with Bag(bag) as opened:
                parameters = load_parameters(files)
                gait = read_uncertain_gait(opened, parameters, deviations, compiled=True)
            found = gait.propagate()
            linear = [found.medial, *([found.lateral] if found.lateral else [])]
            for which, one, (depth, force) in zip(
                ("medial", "lateral"), linear, sampled(gait, found, samples), strict=False
            ):
                at = int(one.rows["load"].argmax())
                cells: list[Any] = [f"{name}, {which}" if len(linear) > 1 else name, size]
                cells += [f"{1e6 * one.depth[at]:.0f}", f"{one.force[at]:.0f}"]
                cells += [ratios(depth.deviation, one.depth), ratios(force.deviation, one.force)]
                cells += [
                    f"{100.0 * inside.mean():.1f} %" for inside in (depth.inside, force.inside)
                ]
                rows.append(cells)
    header = (
        "knee",
        "deviations",
        "depth at the largest load [µm]",
        "force there [N]",
        "depth, sampled over linear",
        "force, sampled over linear",
        "depths inside",
        "forces inside",
    )
    command = f"python -m studies.uncertainty --samples {samples}"
    save(
        output,
        "Straight lines against samples",
        command,
        [Section("", TEXT, header, rows)],
        machine(),
    )
    click.echo(str(output))


if __name__ == "__main__":
    main()
