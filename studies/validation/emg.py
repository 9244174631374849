"""Whether the activity of muscles improves the load estimate of a person who was left out; it does not.

The strides of `data.STRIDE_HEADER` have EMG envelopes. Each muscle's activity is its envelope over 0.1 s, relative to
the largest in the person's own walking, 40 ms late. The error of the estimate is fitted as a line in the activity of
quadriceps, hamstrings and gastrocnemius and in their co-contraction, on the other persons. See
docs/decisions/electromyography.md.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from scipy.ndimage import uniform_filter1d

from benchmarks.report import table
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from studies.validation.data import Floats, Walk, of, walks
from studies.validation.total import (
    Estimate,
    axial,
    clocks,
    constants,
    errors_of,
    on_time,
    same_signs,
)

GROUPS = (("vasmed", "vaslat", "rf"), ("semimem", "bifem"), ("medgas", "latgas"))
"""Columns of quadriceps, hamstrings and gastrocnemius"""
ENVELOPE = 0.1
"""Time [s] over which an activity is averaged"""
DELAY = 0.04
"""Electromechanical delay [s] of the activity"""
PENALTY = 5.0
"""Ridge penalty: a fifth of a person's samples would weigh as much"""


def activities(walk: Walk, path: Path) -> Floats:
    """Mean activity of the three groups [V, each muscle by its own scale], shape (n, muscles)."""
    recorded = np.genfromtxt(path, delimiter=",", names=True, skip_header=1)
    wide = round(ENVELOPE / float(np.median(np.diff(walk.time))))
    muscles = [name for group in GROUPS for name in group]
    rows = [
        np.interp(walk.time - DELAY, walk.time, uniform_filter1d(recorded[f"emg_{name}"], wide))
        for name in muscles
    ]
    return np.stack(rows, axis=1)


def features(activity: Floats, largest: Floats) -> Floats:
    """Activity of the groups and their co-contraction, relative to the largest of each muscle, shape (n, 6)."""
    relative, begin, columns = activity / largest, 0, []
    for group in GROUPS:
        columns.append(relative[:, begin : begin + len(group)].mean(axis=1))
        begin += len(group)
    quadriceps, hamstrings, calf = columns
    both = np.minimum(quadriceps, hamstrings)
    behind = np.minimum(calf, quadriceps + hamstrings)
    return np.stack((*columns, both, behind, np.ones(len(both))), axis=1)


@click.command()
@click.option("--data", type=click.Path(path_type=Path), envvar="INSTRUMENTED_KNEE", required=True)
def main(data: Path) -> None:
    """Print errors and signs of persons who were left out, without and with EMG."""
    paths = {path.stem: path for path in data.rglob("*.csv")}
    found = walks(data)
    late = clocks(found)
    with_emg = [walk for walk in on_time(found, late) if not np.isfinite(walk.medial).all()]
    activity = {walk.name: activities(walk, paths[walk.name]) for walk in with_emg}
    rows = []
    for level in LOAD_LEVELS:
        for name in dict.fromkeys(walk.person.name for walk in with_emg):
            mine = of(with_emg, name)
            others = [walk for walk in with_emg if walk.person.name != name]

            def activity_of(walk: Walk) -> Floats:
                own = np.concatenate(
                    [activity[each.name] for each in of(with_emg, walk.person.name)]
                )
                return features(activity[walk.name], own.max(axis=0))

            known = np.concatenate([activity_of(walk) for walk in others])
            missed = np.concatenate(
                [
                    (walk.total - axial(walk, level, constants(walk))) / walk.person.body_weight
                    for walk in others
                ]
            )
            factors = np.linalg.solve(
                known.T @ known + PENALTY * np.eye(known.shape[1]), known.T @ missed
            )
            plain = [
                Estimate(walk, level, "", (), axial(walk, level, constants(walk))) for walk in mine
            ]
            helped = [
                each._replace(
                    force=each.force
                    + each.walk.person.body_weight * (activity_of(each.walk) @ factors)
                )
                for each in plain
            ]
            cells = []
            for each in (plain, helped):
                signs = " / ".join(f"{right} of {asked}" for right, asked in same_signs(each))
                cells += [f"{next(iter(errors_of(each).values())):.3f}", signs]
            rows.append([f"`{level}`", name, *cells])
    header = (
        "level",
        "left out",
        "error [BW]",
        "signs, first / second",
        "with EMG",
        "signs, first / second",
    )
    click.echo(table(header, rows))


if __name__ == "__main__":
    main()
