"""What each tuned constant of the model is worth: studies once more, with one constant switched off at a time.

A constant is tuned if its docstring says so, and names a study; those of the surfaces are judged by brute force, in
tests/model/test_surfaces.py. Its value without effect is in `OFF`. Each variant is compiled in a
process that ends, and judged in another one.
"""

from __future__ import annotations

import ast
import csv
import importlib
import multiprocessing
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

import click

from knee_contact_ros import model
from knee_contact_ros.model import compiler, kernel, ticks
from studies.honesty.kinds import found
from studies.honesty.study import Row

OFF: dict[str, float] = {
    "LINEAR_FORCE_FRACTION": 1e30,
    "VELOCITY_HORIZON": 0.03,
    "SAFETY_FACTOR": 1.0,
    "CROSS_CORRELATION": 0.0,
    "CURVATURE_FACTOR": 0.0,
    "BOUNDARY_TOLERANCE": 1.0,
    "MIN_PROBES": 2.0,
    "GRAZE_TOLERANCE": 1e-2,
    "MIN_PROBE_SPACING": 1e-3,
    "UNKNOWN_MOTION": 0.0,
    "MAX_PHASE_ERROR": 1e30,
    "SOFT_LAYER_PHASE": 1e-9,
    "GRAZE_DOUBT": 0.0,
    "LOCAL_ERROR_SHARE": 1.0,
    "MAX_MEMORY_PHASE": 1e30,
    "RELEASE_STEPS": 0.0,
    "REBOUND_FORCE_RATIO": 1e30,
    "FLIGHT_TOLERANCE_FACTOR": 1.0,
    "MAX_OSCILLATION_ERROR": 1e30,
    "DAMPED_PHASE": 1e30,
    "TRANSIENT_ERROR_FRACTION": 0.0,
    "MAX_EXPLICIT_STEP": 1.5,
    "STIFF_ORDER_LIMIT": 1e30,
    "MAX_GLIDE_RADIUS": 1e30,
    "NEWTON_DEPTH_SHARE": 1e30,
    "FLIGHT_ROUNDING": 0.0,
}
"""Value of each tuned constant that takes its effect away"""
NUMBERS = {"scenes": 40, "changes": 20, "measured": 3, "cut": 20}
"""How many numbers of each study judge a variant"""
HEAD = (
    "module",
    "constant",
    "value",
    "off",
    "meaning",
    "covered",
    "wrong without a flag",
    "forces covered",
    "forces wrong without a flag",
    "flagged",
    "falsely flagged",
    "evaluations per tick",
)


class Knob(NamedTuple):
    """A tuned constant of the model."""

    module: str
    name: str
    value: str
    """As the source has it"""
    meaning: str


def knobs() -> list[Knob]:
    """Find the tuned constants in the sources of the model."""
    tuned = []
    for file in sorted(Path(model.__path__[0]).glob("*.py")):
        body = ast.parse(file.read_text(encoding="utf-8")).body
        for one, following in pairwise(body):
            match one, following:
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=value),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ) if "Tuned" in text and "studies.honesty" in text:
                    meaning = " ".join(text.split())
                    tuned.append(Knob(file.stem, name, ast.unparse(value), meaning))
    return tuned


def set_constants(values: Mapping[str, float]) -> None:
    """Give constants other values, in all modules of the model that hold them."""
    for file in Path(model.__path__[0]).glob("[!_]*.py"):
        importlib.import_module(f"{model.__name__}.{file.stem}")
    for name, module in sys.modules.items():
        if name.startswith(model.__name__):
            vars(module).update({key: values[key] for key in values if key in vars(module)})


def build(values: Mapping[str, float], library: Path) -> None:
    """Build the model with other values of constants."""
    set_constants(values)
    code = compiler.translate(ticks.run, kernel.example_knee())
    compiler.build(code, compiler.host()._replace(fast_cpu=""), library)


def use(values: Mapping[str, float], library: Path) -> None:
    """Answer with such a model from now on."""
    set_constants(values)
    kernel.has_fast_processor = lambda: False
    kernel.library_file = lambda: library


def judged(
    values: Mapping[str, float], numbers: Mapping[str, int], seed: int, workers: int
) -> dict[str, list[Row]]:
    """Build a variant of the model, and run the first numbers of studies with it."""
    context = multiprocessing.get_context("spawn")  # `translate` changes Numba
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "variant.so")
        with ProcessPoolExecutor(1, context) as pool:
            pool.submit(build, values, library).result()
        with ProcessPoolExecutor(workers, context, use, (values, library)) as pool:
            runs = {
                study: list(pool.map(partial(found, study, 1.0), range(first, first + count)))
                for first in [seed * 1_000_000]
                for study, count in numbers.items()
            }
    return {study: [row for _, rows in some for row in rows] for study, some in runs.items()}


def worth(rows: list[Row]) -> tuple[str, ...]:
    """Add up the rows of a variant: the last columns."""
    ticks, known = sum(one.ticks for one in rows), sum(one.known for one in rows)
    forces = [sum(one.forces[i] for one in rows) for i in range(3)]
    return (
        f"{sum(one.covered for one in rows) - known} of {known}",
        str(sum(one.wrong for one in rows)),
        f"{forces[1] - forces[0]} of {forces[0]}",
        str(forces[2]),
        f"{100.0 * sum(one.flagged for one in rows) / ticks:.2f} %",
        f"{100.0 * sum(one.falsely for one in rows) / ticks:.2f} %",
        f"{sum(one.evaluations for one in rows) / ticks:.1f}",
    )


def lines(share: float, seed: int, workers: int) -> Iterator[tuple[str, ...]]:
    """Yield the line of the model as it is, and of each constant switched off; `share` is that of `NUMBERS`."""

    def line(values: dict[str, float]) -> tuple[str, ...]:
        runs = judged(values, numbers, seed, workers).values()
        return worth([row for rows in runs for row in rows])

    numbers = {study: max(1, round(share * count)) for study, count in NUMBERS.items()}
    yield "", "as it is", "", "", "", *line({})
    for knob in knobs():
        off = OFF[knob.name]
        yield *knob[:3], f"{off:g}", knob.meaning, *line({knob.name: off})


def write(path: Path, found: Iterable[tuple[str, ...]]) -> None:
    """Write a table of such lines, and say each as soon as it is there."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for line in chain([HEAD], found):
            csv.writer(file, lineterminator="\n").writerow(line)
            click.echo("  ".join(line[:4] + line[5:]))
