"""Times that a person waits for: help, first use, loading what is kept, a short bag, and a tick of gait.

python -m studies.waiting [--base TREE] [--turns N] [--output FILE]: in turns with another tree of this project.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks.report import Section, machine, save
from knee_contact_ros.system.files import share_folder

HERE = Path(__file__).parents[1]
BAG = share_folder() / "bags" / "gait2354_right"
KINDS = ("healthy", "mri_femur", "mri_knee")
CONCAVE = {"tibia.geometry": "circle"}
"""A circle in a circle: another kind of surfaces"""
COMMAND = ("-m", "knee_contact_ros.cli.main")
HEADER = ("what", "before [s]", "now [s]", "now over before")
TEXT = """
Medians of {turns} turns, each a process of its own, in turns with the tree before. "First use" is the processor time of
a process that has nothing kept, less that of one that has: run and stream of one kind of knee. "Loading" is the time
from a model to its first tick in a new process, with what is compiled kept, "without Numba's import" the same after
Numba was imported. A tick is one of a run over the recorded gait of the right leg (387 ticks), the best of many.
"""
FIRST_USE = """
import json, sys, time
import knee_contact_ros
model = knee_contact_ros.load_model(json.loads(sys.argv[1]), compiled=True)
model.run([0.0, 0.005], [0.3, 0.31], [700.0, 710.0])
model.stream().tick(0.0, 0.3, 700.0)
print(time.process_time())
"""
LOAD = """
import sys, time
import knee_contact_ros
model = knee_contact_ros.load_model(sys.argv[1], compiled=True)
if len(sys.argv) > 2:
    import numba
begun = time.perf_counter()
model.stream().tick(0.0, 0.3, 700.0)
print(time.perf_counter() - begun)
"""
TICK = """
import sys, time
import knee_contact_ros
gait = knee_contact_ros.solve(sys.argv[2], sys.argv[1], compiled=False)
series = gait.time, gait.flexion_angle, gait.load
model = knee_contact_ros.load_model(sys.argv[1], compiled=True)
model.run(*series)
best = float("inf")
until = time.perf_counter() + 2.0
while time.perf_counter() < until:
    begun = time.perf_counter()
    model.run(*series)
    best = min(best, (time.perf_counter() - begun) / len(gait))
print(best)
"""


class Tree(NamedTuple):
    """A working tree of the project, and its cache."""

    path: Path
    kept: Path
    """Folder for what it compiles"""

    def python(self, *arguments: str, kept: Path | None = None) -> tuple[float, str]:
        """Run Python with some arguments; return the time [s] that it took, and what it printed."""
        python = self.path / ".venv" / "bin" / "python"
        environment = os.environ | {"PYTHONPATH": str(self.path), "XDG_CACHE_HOME": str(kept or self.kept)}
        begun = time.perf_counter()
        done = subprocess.run(
            [str(python) if python.exists() else sys.executable, *arguments],
            cwd=self.path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True,
        )  # fmt: skip
        return time.perf_counter() - begun, done.stdout


def first_use(tree: Tree, parameters: object) -> float:
    """Processor time [s] of the first use of a kind of knee, with these parameters."""
    with tempfile.TemporaryDirectory() as nothing:
        cold = float(tree.python("-c", FIRST_USE, json.dumps(parameters), kept=Path(nothing))[1])
    return cold - float(tree.python("-c", FIRST_USE, json.dumps(parameters))[1])


def short_bag(tree: Tree) -> float:
    """Wall time [s] of `solve` on a short bag."""
    with tempfile.TemporaryDirectory() as folder:
        return tree.python(*COMMAND, "solve", str(BAG), "--output", f"{folder}/out.mcap")[0]


def measures() -> dict[str, Callable[[Tree], float]]:
    """Measurements [s] by their names."""
    return {
        "knee-contact --help": lambda tree: tree.python(*COMMAND, "--help")[0],
        "knee-contact solve, a bag of 2 s": short_bag,
        "loading, healthy": lambda tree: float(tree.python("-c", LOAD, "healthy")[1]),
        "loading, healthy, without Numba's import": lambda tree: float(
            tree.python("-c", LOAD, "healthy", "imported")[1]
        ),
        **{f"first use, {kind}": lambda tree, kind=kind: first_use(tree, kind) for kind in KINDS},  # type: ignore[misc]
        "first use, healthy in a circle": lambda tree: first_use(tree, CONCAVE),
        **{
            f"tick, {kind}": lambda tree, kind=kind: float(tree.python("-c", TICK, kind, str(BAG))[1])  # type: ignore[misc]
            for kind in KINDS
        },
    }


@click.command()
@click.option("--base", type=click.Path(exists=True, file_okay=False, path_type=Path), help="Another tree.")
@click.option("--turns", type=click.IntRange(1), default=3, show_default=True)
@click.option("--only", default="", help="Measure what has this in its name.")
@click.option("--output", type=click.Path(path_type=Path), default=HERE / "docs" / "studies" / "waiting.md")
def main(base: Path | None, turns: int, only: str, output: Path) -> None:
    """Measure and write the page."""
    with tempfile.TemporaryDirectory() as folder:
        trees = [Tree(path, Path(folder) / str(number)) for number, path in enumerate(filter(None, (base, HERE)))]
        for tree in trees:
            for parameters in (*KINDS, CONCAVE):  # what is not measured shall be there
                tree.python("-c", FIRST_USE, json.dumps(parameters))
        rows = []
        for name, measure in measures().items():
            if only not in name:
                continue
            seconds: list[list[float]] = [[measure(tree) for tree in trees] for _ in range(turns)]
            middles = [statistics.median(each) for each in zip(*seconds, strict=True)]
            before, now = middles[0] if base else None, middles[-1]
            told = (
                "" if before is None else f"{before:.3g}",
                f"{now:.3g}",
                "" if before is None else f"{now / before:.2f}",
            )
            rows.append((name, *told))
            click.echo("  ".join(rows[-1]))
    command = "python -m studies.waiting" + (" --base TREE" if base else "")
    section = Section("", TEXT.strip().format(turns=turns), HEADER, rows)
    save(output, "What a person waits for", command, [section], machine())


if __name__ == "__main__":
    main()
