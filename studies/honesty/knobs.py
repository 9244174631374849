"""What each tuned constant of the model is worth: studies once more, with one constant switched off at a time.

A constant is tuned if its docstring says so, and names a study; those of the surfaces are judged by brute force, in
tests/model/test_surfaces.py. Its value without effect is in `OFF`. The model is translated once; in
the code of each variant, the numbers that stand for the constants are replaced.
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
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

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


def marked_code(values: Mapping[str, float]) -> tuple[str, dict[str, str]]:
    """Translate the model, and return its code and what stands there for each constant: a number near its value.

    Raises:
        LookupError: a constant does not appear in the code.
    """
    marks = {
        name: one * (1.0 + (i + 1) * 2.0**-40) for i, (name, one) in enumerate(values.items())
    }
    set_constants(marks)
    code = compiler.translate(ticks.run, kernel.example_knee())
    bits = {name: in_code(one) for name, one in marks.items()}
    if missing := [name for name, text in bits.items() if text not in code]:
        raise LookupError(f"not in the kernel's code: {', '.join(missing)}")
    return code, bits


def in_code(value: float) -> str:
    """Return a number in LLVM's language."""
    return f"0x{struct.pack('>d', value).hex().upper()}"


def judged(
    code: str, bits: Mapping[str, str], numbers: Mapping[str, range], values: Mapping[str, float]
) -> list[Row]:
    """Build a variant of the model, and run numbers of studies with it; in a process of its own, which ends."""
    set_constants(values)
    for name, value in values.items():
        code = code.replace(bits[name], in_code(value))
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "variant.so")
        compiler.build(code, compiler.host()._replace(fast_cpu=""), library)
        kernel.has_fast_processor = lambda: False
        kernel.library_file = lambda: library
        kernel.library.cache_clear()
        return [
            row
            for study, those in numbers.items()
            for number in those
            for row in found(study, 1.0, number)[1]
        ]


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
    tuned, first = knobs(), seed * 1_000_000
    modules = {
        one.name: importlib.import_module(f"{model.__name__}.{one.module}") for one in tuned
    }
    values = {name: float(getattr(module, name)) for name, module in modules.items()}
    variants = [values, *(values | {one.name: OFF[one.name]} for one in tuned)]
    numbers = {
        study: range(first, first + max(1, round(share * count)))
        for study, count in NUMBERS.items()
    }
    for number in numbers["measured"]:
        measured.truth(number)  # most of the work, which the processes of all variants inherit
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        code = pool.submit(marked_code, values).result()  # `translate` changes Numba
    work = partial(judged, *code, numbers)
    names = [("", "as it is", "", "", "")]
    names += [(*one[:3], f"{OFF[one.name]:g}", one.meaning) for one in tuned]
    with multiprocessing.get_context("fork").Pool(workers, maxtasksperchild=1) as forks:
        for name, rows in zip(names, forks.imap(work, variants), strict=True):
            yield *name, *worth(rows)


def write(path: Path, found: Iterable[tuple[str, ...]]) -> None:
    """Write a table of such lines, and say each as soon as it is there."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for line in chain([HEAD], found):
            csv.writer(file, lineterminator="\n").writerow(line)
            click.echo("  ".join(line[:4] + line[5:]))
