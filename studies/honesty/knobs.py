"""What each tuned constant of the model is worth: studies once more, with one constant switched off at a time.

A constant is tuned if its docstring says so, and names a study. Its value without effect is in `OFF`. The model is
translated once; each variant is that code with other numbers, built and judged in a process that ends.
"""

from __future__ import annotations

import ast
import csv
import importlib
import multiprocessing
import struct
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import click

from knee_contact_ros import model
from knee_contact_ros.model import compiler, kernel, ticks
from studies.honesty import measured
from studies.honesty.kinds import found
from studies.honesty.study import Row

OFF: dict[str, float] = {
    "LINEAR_FORCE_FRACTION": 1e30,
    "VELOCITY_HORIZON": 0.03,
    "SAFETY_FACTOR": 1.0,
    "CROSS_CORRELATION": 0.0,
    "CURVATURE_FACTOR": 0.0,
    "MIN_PROBES": 2.0,
    "GRAZE_TOLERANCE": 1e-2,
    "MIN_PROBE_SPACING": 1e-3,
    "UNKNOWN_MOTION": 0.0,
    "MAX_PHASE_ERROR": 1e30,
    "SOFT_LAYER_PHASE": 1e-9,
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
NUMBERS = {
    "scenes": (0, 40),
    "changes": (0, 20),
    "measured": (0, 3),
    "cut": (0, 20),
    "long_runs": (20, 1),
}
"""First number and count of each study that judges a variant"""
TIME = 0.02
"""Part of the time of long runs"""


class Knob(NamedTuple):
    """A tuned constant of the model."""

    module: str
    name: str
    value: float
    meaning: str


def knobs() -> list[Knob]:
    """Find the tuned constants in the sources of the model."""
    tuned = []
    for file in sorted(Path(model.__path__[0]).glob("*.py")):
        body = ast.parse(file.read_text(encoding="utf-8")).body
        for one, following in pairwise(body):
            match one, following:
                case (
                    ast.Assign(targets=[ast.Name(id=name)]),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ) if "Tuned" in text and "studies.honesty" in text:
                    module = importlib.import_module(f"{model.__name__}.{file.stem}")
                    tuned.append(Knob(file.stem, name, vars(module)[name], " ".join(text.split())))
    return tuned


def set_constants(values: Mapping[str, float]) -> None:
    """Give constants other values, in all modules of the model that hold them."""
    for file in Path(model.__path__[0]).glob("[!_]*.py"):
        importlib.import_module(f"{model.__name__}.{file.stem}")
    for name, module in sys.modules.items():
        if name.startswith(model.__name__):
            vars(module).update({key: values[key] for key in values if key in vars(module)})


def marked(values: Mapping[str, float]) -> tuple[str, dict[str, float]]:
    """Translate the model, in a process that does nothing else, with marks for constants: numbers next to theirs."""
    marks = {name: values[name] * (1.0 + (i + 1) * 2.0**-40) for i, name in enumerate(values)}
    set_constants(marks)
    return compiler.translate(ticks.run, kernel.example_knee()), marks


def variant(code: str, marks: Mapping[str, float], values: Mapping[str, float]) -> str:
    """Return the code with values in the places of marks."""
    for name, mark in marks.items():
        old, new = (f"0x{struct.pack('>d', one).hex().upper()}" for one in (mark, values[name]))
        if old not in code:
            raise LookupError(name)
        code = code.replace(old, new)
    return code


def judged(
    code: tuple[str, dict[str, float]], numbers: list[tuple[str, int]], values: dict[str, float]
) -> list[Row]:
    """Answer with a variant of the model from now on, and run numbers of studies with it."""
    set_constants(values)
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "variant.so")
        compiler.build(variant(*code, values), compiler.host()._replace(fast_cpu=""), library)
        kernel.has_fast_processor = lambda: False
        kernel.library_file = lambda: library
        kernel.library.cache_clear()
        return [row for study, number in numbers for row in found(study, TIME, number)[1]]


def worth(rows: list[Row]) -> dict[str, str]:
    """Add up the rows of a variant."""
    ticks, known = sum(one.ticks for one in rows), sum(one.known for one in rows)
    forces = [sum(one.forces[i] for one in rows) for i in range(3)]
    return {
        "covered": f"{sum(one.covered for one in rows) - known} of {known}",
        "wrong without a flag": str(sum(one.wrong for one in rows)),
        "forces covered": f"{forces[1] - forces[0]} of {forces[0]}",
        "forces wrong without a flag": str(forces[2]),
        "flagged": f"{100.0 * sum(one.flagged for one in rows) / ticks:.2f} %",
        "falsely flagged": f"{100.0 * sum(one.falsely for one in rows) / ticks:.2f} %",
        "evaluations per tick": f"{sum(one.evaluations for one in rows) / ticks:.1f}",
    }


def lines(share: float, seed: int, workers: int) -> Iterator[dict[str, Any]]:
    """Yield the line of the model as it is, and of each constant switched off; `share` is that of `NUMBERS`."""
    numbers = [
        (study, seed * 1_000_000 + first + i)
        for study, (first, count) in NUMBERS.items()
        for i in range(max(1, round(share * count)))
    ]
    tuned = knobs()
    values = {one.name: one.value for one in tuned}
    variants = [values, *(values | {one.name: OFF[one.name]} for one in tuned)]
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        code = pool.submit(marked, values).result()
    for _, number in (one for one in numbers if one[0] == "measured"):
        measured.truth(number)  # most of the work; the processes below begin with it
    with multiprocessing.get_context("fork").Pool(workers, maxtasksperchild=1) as pool:
        runs = pool.imap(partial(judged, code, numbers), variants)
        for knob, rows in zip([Knob("", "as it is", 0.0, ""), *tuned], runs, strict=True):
            yield knob._asdict() | {"off": OFF.get(knob.name, "")} | worth(rows)


def write(path: Path, found: Iterable[dict[str, Any]]) -> None:
    """Write a table of such lines, and say each as soon as it is there."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for i, line in enumerate(found):
            for row in [list(line), list(line.values())][i > 0 :]:
                csv.writer(file, lineterminator="\n").writerow(row)
            click.echo("  ".join(str(line[name]) for name in line if name != "meaning"))
