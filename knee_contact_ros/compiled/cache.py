"""Where compiled code is kept: in the user's cache folder, by all that it depends on."""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numba
from numba import config

import knee_contact_ros.core

SOURCES = (Path(knee_contact_ros.core.__file__).parent, Path(__file__).parent)


@contextmanager
def cache_folder() -> Iterator[None]:
    """Let Numba keep what it compiles meanwhile under a name of our own: its own looks at one source file only."""
    before = config.CACHE_DIR
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    config.CACHE_DIR = str(Path(home) / "knee_contact_ros" / f"kernel-{_fingerprint()}")
    try:
        yield
    finally:
        config.CACHE_DIR = before


@functools.cache
def _fingerprint() -> str:
    """What the compiled code depends on: the model's source and the compiler."""
    digest = hashlib.sha256(numba.__version__.encode())
    for folder in SOURCES:
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
