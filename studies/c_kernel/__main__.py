"""Time per tick of the compiled kernel and of the same algorithm in C (`dynamic.c`), and what a long run costs.

python -m studies.c_kernel [--compiler gcc] [--output FILE]
"""

from __future__ import annotations

import ctypes
import math
import resource
import shlex
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.report import Section, machine, save
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.model.types import blank
from studies.accuracy import CIRCLE, DAMPING, EXPONENT, K1, K2, LAYER, MASS, TOLERANCES, A

FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-shared", "-fPIC", "-lm")
TICK = 1e-3
TICKS = 2_000
ROUNDS = 200
LENGTHS = (1_000, 10_000, 100_000, 1_000_000)
SPRING = {"stiffness": K1, "exponent": EXPONENT}
MEBIBYTE = 2**20
FIELDS = ("penetration_depth", "gap", "error_estimate", "evaluations")

Floats = NDArray[np.float64]


class Problem(NamedTuple):
    """A circle on a plane under a load."""

    name: str
    load: Callable[[Floats], Floats]
    law: ContactLaw
    mass: float = MASS


class Found(NamedTuple):
    """Results that both kernels compute, shape (n,) each."""

    depth: Floats
    error_estimate: Floats
    evaluations: NDArray[np.int32]


def gait(time: Floats) -> Floats:
    """Load [N] of one step each second, between 150 N and 1615 N."""
    return 150.0 + 1465.0 * np.sin(math.pi * time) ** 2


def lift_off(time: Floats) -> Floats:
    """Load [N] that lifts the femur off four times a second, as in `accuracy.py`."""
    return 300.0 + 350.0 * np.cos(math.tau * time / 0.25)


def problems() -> list[Problem]:
    """List the problems."""
    kelvin_voigt = CONTACT_LAWS["kelvin_voigt"](**SPRING, damping=DAMPING)
    layered = {"layer_depth": LAYER, "stiffness_2": K2, "damping": DAMPING, "damp_first_layer": False}
    return [
        Problem("gait, 9.3 kg", gait, kelvin_voigt),
        Problem("gait, 1 kg", gait, kelvin_voigt, 1.0),
        Problem("lift-off and landing", lift_off, kelvin_voigt),
        Problem("osteoarthritis: gait on two layers", gait,
                CONTACT_LAWS["two_layer_viscoelastic"](**SPRING, **layered)),
        Problem("impact: lift-off and landing, C = 50 N s/m", lift_off,
                CONTACT_LAWS["kelvin_voigt"](**SPRING, damping=50.0)),
    ]  # fmt: skip


def model_of(problem: Problem, tolerance: float) -> KneeModel:
    """Compiled model of a problem."""
    level = LEVELS["dynamic"]
    return KneeModel(CIRCLE.pair, problem.law, problem.mass, tolerance, 0, level=level, compiled=True)


def series(problem: Problem, count: int) -> tuple[Floats, Floats]:
    """Durations [s] and loads [N] of the ticks, as many as `count`."""
    time = np.arange(count, dtype=np.float64) * TICK
    return np.asarray(np.diff(np.rint(time * 1e9), prepend=0.0) * 1e-9), problem.load(time)


def ours(problem: Problem, tolerance: float, count: int) -> tuple[Callable[[], None], Callable[[], Found]]:
    """Prepare our run of a problem, with its results."""
    model = model_of(problem, tolerance)
    durations, loads = series(problem, count)
    answers = blank(count)
    samples = np.column_stack([durations, np.zeros(count), loads, np.full(count, math.nan)])

    def call() -> None:
        model.compute(samples, answers)

    def found() -> Found:
        depth, gap, error, evaluations = (answers[name] for name in FIELDS)
        return Found(depth - gap, error, evaluations.astype(np.int32))

    return call, found


def in_c(function: Any, problem: Problem, tolerance: float, count: int) -> tuple[Callable[[], None], Found]:
    """Prepare the run of a problem in C, with its results."""
    durations, loads = series(problem, count)
    layers = np.array([layer[:5] for layer in problem.law.layers])  # begin, base, stiffness, exponent, damping
    found = Found(np.zeros(count), np.zeros(count), np.zeros(count, dtype=np.int32))
    address, number, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_int

    def call() -> None:
        function(
            address(durations.ctypes.data), address(loads.ctypes.data), whole(count), number(A), number(1.0),
            number(problem.mass), number(tolerance), address(layers.ctypes.data), whole(len(layers)),
            *(address(column.ctypes.data) for column in found),
        )  # fmt: skip

    return call, found


def library(compiler: str, path: Path) -> Any:
    """Compile `dynamic.c` to a library with a compiler."""
    subprocess.run(
        [*shlex.split(compiler), *FLAGS, str(Path(__file__).with_name("dynamic.c")), "-o", str(path)], check=True
    )
    return ctypes.CDLL(str(path)).run


def seconds(call: Callable[[], None]) -> float:
    """Time of a call [s]."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def row(functions: Sequence[Any], problem: Problem, tolerance: float) -> list[str]:
    """Row of the table for a problem and a tolerance [m]."""
    run, found = ours(problem, tolerance, TICKS)
    in_turns = [run]
    for function in functions:
        run_c, theirs = in_c(function, problem, tolerance, TICKS)
        in_turns.append(run_c)
    run()
    times = np.array([[seconds(call) for call in in_turns] for _ in range(ROUNDS)]).min(axis=0) / TICKS
    mine = found()
    return [
        problem.name, f"{tolerance:.0e}", *(f"{time * 1e9:.0f}" for time in times),
        f"{times[0] / times[1:].min():.2f}", f"{mine.evaluations.mean():.1f}",
        f"{np.abs(mine.depth - theirs.depth).max():.1g}",
        f"{np.abs(mine.error_estimate / np.maximum(theirs.error_estimate, 1e-30) - 1.0)[1:].max():.1g}",
        str(np.count_nonzero(mine.evaluations != theirs.evaluations)),
    ]  # fmt: skip


def resident() -> int:
    """Resident memory of this process [B]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def length_row(problem: Problem, count: int) -> list[str]:
    """Row of the table for a run of `count` ticks: time per tick at once, and streamed tick by tick."""
    tick = model_of(problem, TOLERANCES[0]).stream().tick_ns
    loads = series(problem, count)[1].tolist()
    tick(0, 0.0, loads[0])
    before = resident()
    begin = time.perf_counter()
    for i, load in enumerate(loads, 1):
        tick(i * 1_000_000, 0.0, load)
    streamed = (time.perf_counter() - begin) / count
    growth = (resident() - before) / MEBIBYTE
    run, _ = ours(problem, TOLERANCES[0], count)
    run()
    at_once = min(seconds(run) for _ in range(5)) / count
    return [f"{count:,}", f"{at_once * 1e9:.0f}", f"{streamed * 1e9:.0f}", f"{growth:.1f}"]


def version(compiler: str) -> str:
    """Name and version of a C compiler."""
    command = [*shlex.split(compiler), "--version"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[0]


@click.command()
@click.option("--compiler", "compilers", multiple=True, default=("gcc",), help="C compiler; may be given repeatedly")
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/c_kernel.md"))
def main(compilers: tuple[str, ...], output: Path) -> None:
    """Measure and write the page."""
    lengths = []
    for count in LENGTHS:
        lengths.append(length_row(problems()[0], count))
        click.echo(" | ".join(lengths[-1]), err=True)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        functions = [library(compiler, Path(folder) / f"{i}.so") for i, compiler in enumerate(compilers)]
        for problem in problems():
            for tolerance in TOLERANCES:
                rows.append(row(functions, problem, tolerance))
                click.echo(" | ".join(rows[-1]), err=True)
    text = (
        "The level `dynamic` at 1 kHz, a circle on a plane: `run` of the compiled kernel and "
        f"`studies/c_kernel/dynamic.c` with `{' '.join(FLAGS)}`. Least of {ROUNDS} runs of {TICKS} ticks, in turns; "
        "the ratio is to the quickest C. Differences are the largest of all ticks and to the last C: those that "
        "fuse sine and cosine differ in their last bits, which only the estimate shows. C gives depth, estimate and "
        "evaluations; the kernel gives the whole answer."
    )
    header = (
        "problem", "tolerance [m]", "kernel [ns/tick]", *(f"C{i + 1} [ns/tick]" for i in range(len(compilers))),
        "ratio", "evaluations per tick", "difference of depth [m]", "of estimate, relative",
        "ticks with other evaluations",
    )  # fmt: skip
    length_text = (
        "Gait, 9.3 kg, tolerance 1e-6 m: one `run`, and `stream().tick_ns` with all that Python does about it; growth "
        "of the process's resident memory over the streamed ticks."
    )
    length_header = ("ticks", "run [ns/tick]", "streamed [ns/tick]", "growth of memory [MiB]")
    versions = ", ".join(f"C{i}: {version(compiler)}" for i, compiler in enumerate(compilers, 1))
    sections = [
        Section("Against C", text, header, rows),
        Section("Length of the run", length_text, length_header, lengths),
    ]
    options = "" if compilers == ("gcc",) else "".join(f" --compiler '{compiler}'" for compiler in compilers)
    save(output, "The kernel against C", f"python -m studies.c_kernel{options}", sections, f"{machine()}, {versions}")


if __name__ == "__main__":
    main()
