"""How honest the error estimates of every level are, on random scenes of all laws, against the reference.

python -m studies.honesty [--scenes N] [--seed S] [--output FILE] [--show SCENE]
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from tabulate import tabulate

from benchmarks.report import machine, save
from studies.honesty.page import TITLE, sections
from studies.honesty.scenes import draw
from studies.honesty.study import LEVELS, SETTINGS, runs, study
from studies.honesty.truth import reference

SPACING = 1_000_000
"""Distance between the scenes of two seeds"""


def show(seed: int) -> str:
    """Text of a scene, its reference solution, and where each run is wrong or not covered."""
    scene = draw(seed)
    truth = reference(scene)
    ticks = np.diff(scene.time)
    lines = [
        f"{scene.family}, {scene.law} {scene.arguments}",
        f"mass {scene.mass:.4g} kg, half axes {scene.half_axes} m, slope {scene.slope:.4g} rad, tension "
        f"{scene.allow_tension}",
        f"load {scene.loads}: {scene.load.min():.4g} to {scene.load.max():.4g} N, ticks of {ticks.min():.3g} to "
        f"{ticks.max():.3g} s",
        f"depth {np.nanmin(truth.depth):.4g} to {np.nanmax(truth.depth):.4g} m, apart in "
        f"{np.mean(truth.depth < 0):.0%} of ticks, known to 1e-9 m in {np.mean(truth.depth_bound < 1e-9):.0%}",
    ]
    rows = []
    for key, (_, judged) in runs(scene, LEVELS, SETTINGS).items():
        for name, verdict in (("depth", judged.depth), ("force", judged.force)):
            if verdict is not None:
                missed = verdict.known & ~verdict.covered
                rows.append([
                    key.level, key.tolerance, key.force_tolerance, name, verdict.known.sum(), np.nanmax(verdict.error),
                    np.nanmedian(verdict.ratio) if verdict.large.any() else np.nan, (~judged.said_right).sum(),
                    f"{verdict.wrong.sum()} {np.flatnonzero(verdict.wrong)[:5]}",
                    f"{missed.sum()} {np.flatnonzero(missed)[:5]}", judged.evaluations.mean(),
                ])  # fmt: skip
    header = (
        "level", "tolerance", "of force", "of", "known", "largest error", "median ratio", "flagged",
        "wrong: first ticks", "not covered: first ticks", "evaluations",
    )  # fmt: skip
    return "\n".join([*lines, tabulate(rows, header)])


@click.command()
@click.option("--scenes", default=2000, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/honesty.md"), show_default=True)
@click.option("--show", "shown", type=int, help="Print one scene by its number, and write nothing.")
def main(scenes: int, seed: int, output: Path, shown: int | None) -> None:
    """Measure and write the tables."""
    if shown is not None:
        click.echo(show(shown))
        return
    first = seed * SPACING
    outcome = study(
        range(first, first + scenes), told=lambda done: click.echo(f"\r{done} of {scenes}", nl=False, err=True)
    )
    click.echo(err=True)
    command = f"python -m studies.honesty --scenes {scenes} --seed {seed}"
    save(output, TITLE, command, sections(outcome), machine())


if __name__ == "__main__":
    main()
