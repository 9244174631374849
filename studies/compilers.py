"""One hot function under several compilers: a tick by Fehlberg's method under Kelvin-Voigt, with error control.

python -m studies.compilers; needs numba, cython, pythran, mypy, setuptools and a C++ compiler.
"""

from __future__ import annotations

import importlib
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np
from tabulate import tabulate

SOURCE = """
from math import cos, exp, sin, sqrt

# pythran export run(float64[], float64[], float, float, float, float, float, float)


def acceleration(y: float, v: float, load: float, radius: float, k: float, c: float, mass: float) -> float:
    depth = radius - y
    elastic = k * sqrt(depth) * depth if depth > 0.0 else 0.0
    return (elastic - c * v - load) / mass


def run(
    loads: list[float], depths: list[float], duration: float, radius: float, k: float, c: float, mass: float,
    tolerance: float,
) -> None:
    y, v, error, error_rate = radius - (loads[0] / k) ** (2.0 / 3.0), 0.0, 0.0, 0.0
    parts = 1.0
    for i in range(1, len(loads)):
        slope = (loads[i] - loads[i - 1]) / duration
        s = 0.0
        h = duration / parts
        while s < duration * (1.0 - 1e-12):
            load = loads[i - 1] + slope * s
            a = acceleration(y, v, load, radius, k, c, mass)
            v2 = v + h * 0.25 * a
            a2 = acceleration(y + h * 0.25 * v, v2, load + slope * 0.25 * h, radius, k, c, mass)
            v3 = v + h * (3 / 32 * a + 9 / 32 * a2)
            a3 = acceleration(y + h * (3 / 32 * v + 9 / 32 * v2), v3, load + slope * 0.375 * h, radius, k, c, mass)
            v4 = v + h * (1932 / 2197 * a - 7200 / 2197 * a2 + 7296 / 2197 * a3)
            y4 = y + h * (1932 / 2197 * v - 7200 / 2197 * v2 + 7296 / 2197 * v3)
            a4 = acceleration(y4, v4, load + slope * (12 / 13) * h, radius, k, c, mass)
            v5 = v + h * (439 / 216 * a - 8.0 * a2 + 3680 / 513 * a3 - 845 / 4104 * a4)
            y5 = y + h * (439 / 216 * v - 8.0 * v2 + 3680 / 513 * v3 - 845 / 4104 * v4)
            a5 = acceleration(y5, v5, load + slope * h, radius, k, c, mass)
            v6 = v + h * (-8 / 27 * a + 2.0 * a2 - 3544 / 2565 * a3 + 1859 / 4104 * a4 - 11 / 40 * a5)
            y6 = y + h * (-8 / 27 * v + 2.0 * v2 - 3544 / 2565 * v3 + 1859 / 4104 * v4 - 11 / 40 * v5)
            a6 = acceleration(y6, v6, load + slope * 0.5 * h, radius, k, c, mass)
            local = h * (1 / 360 * v - 128 / 4275 * v3 - 2197 / 75240 * v4 + 1 / 50 * v5 + 2 / 55 * v6)
            local_rate = h * (1 / 360 * a - 128 / 4275 * a3 - 2197 / 75240 * a4 + 1 / 50 * a5 + 2 / 55 * a6)
            stiffness = 1.5 * k * sqrt(max(radius - y6, 0.0))
            whole = sqrt(local * local + local_rate * local_rate * mass / (stiffness + 1e-300))
            if whole > tolerance and h > 1e-9:
                h = 0.5 * h
                parts = 2.0 * parts
                continue
            decay, root = exp(-0.5 * c / mass * h), sqrt(abs(stiffness / mass - 0.25 * c * c / mass / mass))
            even, odd = decay * cos(root * h), decay * sin(root * h) / root
            carried = even * error + odd * error_rate
            error_rate = even * error_rate - stiffness / mass * odd * error + local_rate
            error = carried + local
            y = y + h * (25 / 216 * v + 1408 / 2565 * v3 + 2197 / 4104 * v4 - 1 / 5 * v5)
            v = v + h * (25 / 216 * a + 1408 / 2565 * a3 + 2197 / 4104 * a4 - 1 / 5 * a5)
            s = s + h
        if parts > 1.0:
            parts = 0.5 * parts
        depths[i] = radius - y + 1e-3 * error
"""
NAMES = (
    "y v error error_rate parts slope s h load a v2 a2 v3 a3 v4 y4 a4 v5 y5 a5 v6 y6 a6 local local_rate stiffness "
    "whole decay root even odd carried"
)
DECLARATIONS = f"""
import cython
cdef extern from "math.h":
    cpdef double sqrt(double)
    cpdef double exp(double)
    cpdef double sin(double)
    cpdef double cos(double)
cdef double acceleration(double, double, double, double, double, double, double)
@cython.locals(i=cython.Py_ssize_t, {", ".join(f"{name}=cython.double" for name in NAMES.split())})
cpdef run(
    double[::1] loads, double[::1] depths, double duration, double radius, double k, double c, double mass,
    double tolerance)
"""
"""Declarations for Cython beside the source, in a .pxd file"""
COMMANDS = {
    "cython, as it stands": ["cythonize", "-3", "-i", "hot.py"],
    "cython, with a .pxd": [
        "cythonize", "-3", "-i", "-X", "boundscheck=False", "-X", "wraparound=False",
        "-X", "annotation_typing=False", "hot.py",
    ],
    "pythran": ["pythran", "-O3", "hot.py"],
    "mypyc": ["mypyc", "hot.py"],
}  # fmt: skip
CONSTANTS = (1e-3, 0.034, 7.905694e7, 5000.0, 9.3014, 1e-7)
ON_ARRAYS = ("numba", "pythran", "cython, with a .pxd")
"""Compilers whose functions take arrays; the others take lists"""
TICKS, ROUNDS = 10_001, 30


def built(command: Sequence[str], folder: Path, declarations: str) -> Callable[..., None]:
    """Compile the source with a compiler of this environment, and import it."""
    (folder / "hot.py").write_text(SOURCE, encoding="utf-8")
    if declarations:
        (folder / "hot.pxd").write_text(declarations, encoding="utf-8")
    if command:
        tool = Path(sys.executable).parent / command[0]
        subprocess.run([str(tool), *command[1:]], cwd=folder, check=True, capture_output=True)
    sys.modules.pop("hot", None)
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        module: Any = importlib.import_module("hot")
    finally:
        sys.path.remove(str(folder))
    return module.run  # type: ignore[no-any-return]


def measured(name: str, run: Callable[..., None], begin: float, exact: bytes) -> list[str]:
    """Row of the table for a compiled function; compiling began at `begin` [s]."""
    loads = 150.0 + 1465.0 * np.sin(math.pi * np.arange(TICKS) * 1e-3) ** 2
    depths = np.zeros(TICKS)
    given: list[Any] = [loads, depths] if name in ON_ARRAYS else [loads.tolist(), depths.tolist()]
    run(*given, *CONSTANTS)
    compiling = time.perf_counter() - begin
    times = []
    for _ in range(ROUNDS if name != "plain Python" else 1):
        before = time.perf_counter()
        run(*given, *CONSTANTS)
        times.append(time.perf_counter() - before)
    same = np.asarray(given[1]).tobytes() == exact if exact else True
    return [name, f"{min(times) / TICKS * 1e9:.0f}", f"{compiling:.1f}", "yes" if same else "no"]


@click.command()
def main() -> None:
    """Measure and print the table."""
    from numba import njit
    from numba.extending import register_jitable

    rows = []
    with tempfile.TemporaryDirectory() as folder:
        plain = built([], Path(folder), "")
        loads = (150.0 + 1465.0 * np.sin(math.pi * np.arange(TICKS) * 1e-3) ** 2).tolist()
        depths = [0.0] * TICKS
        plain(loads, depths, *CONSTANTS)
        exact = np.array(depths).tobytes()
        rows.append(measured("plain Python", plain, time.perf_counter(), exact))
        begin = time.perf_counter()
        register_jitable(sys.modules["hot"].acceleration)
        rows.append(measured("numba", njit(error_model="numpy")(plain), begin, exact))
    for name, command in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            run = built(command, Path(folder), DECLARATIONS if "pxd" in name else "")
            rows.append(measured(name, run, begin, exact))
    click.echo(tabulate(rows, ("compiler", "ns per tick", "compiling [s]", "same bits"), tablefmt="pipe"))


if __name__ == "__main__":
    main()
