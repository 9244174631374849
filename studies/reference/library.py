"""The solver's C source, compiled on first use into the user's cache folder."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path

SOURCE = Path(__file__).parent
FLAGS = ("-O2", "-std=gnu11", "-shared", "-fPIC")


class Constants(ctypes.Structure):
    """`Constants` of `run.h`."""

    _fields_ = (
        ("stiffness", ctypes.c_double * 2),
        ("exponent", ctypes.c_double * 2),
        ("damping", ctypes.c_double * 2),
        ("layer_depth", ctypes.c_double),
        ("loss", ctypes.c_double),
        ("least_speed", ctypes.c_double),
        ("tension", ctypes.c_int),
        ("mass", ctypes.c_double),
        ("a", ctypes.c_double),
        ("b", ctypes.c_double),
        ("slope", ctypes.c_double),
    )


class Accuracy(ctypes.Structure):
    """`Accuracy` of `run.h`."""

    _fields_ = (
        ("tolerance", ctypes.c_double),
        ("force_tolerance", ctypes.c_double),
        ("degree", ctypes.c_int),
        ("most_cost", ctypes.c_double),
        ("implicit", ctypes.c_int),
    )


@functools.cache
def fingerprint() -> str:
    """What the compiled solver depends on."""
    digest = hashlib.sha256(" ".join((os.environ.get("CC", "cc"), *FLAGS)).encode())
    for path in sorted([*SOURCE.glob("*.c"), *SOURCE.glob("*.h")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path:
    """Where compiled code and solutions are kept."""
    return (
        Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        / "knee_contact_ros"
        / "reference"
    )


@functools.cache
def library() -> ctypes.CDLL:
    """The solver.

    Raises:
        subprocess.CalledProcessError: the C compiler fails.
    """
    path = cache_folder() / f"solver-{fingerprint()}.so"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            made = Path(folder) / path.name
            sources = [str(source) for source in sorted(SOURCE.glob("*.c"))]
            subprocess.run(
                [os.environ.get("CC", "cc"), *FLAGS, "-o", str(made), *sources, "-lm"], check=True
            )
            made.replace(path)
    loaded = ctypes.CDLL(str(path))
    loaded.state_size.restype = ctypes.c_ulong
    loaded.run.restype = ctypes.c_long
    return loaded
