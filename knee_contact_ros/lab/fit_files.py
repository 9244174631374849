"""Files of fits: CSV tables of measurements that are read, and results that appear when they are complete."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import read_regular
from knee_contact_ros.system.output_files import partial_name, write_new

LARGEST_FILE = 2**28
"""Largest size [B] of a file"""


class NumberTable(NamedTuple):
    """Contents of a CSV file: names in the first line, then rows of numbers; lines that begin with # are comments."""

    names: list[str]
    """Names of the columns, n of them"""
    rows: Floats
    """Numbers, shape (m, n)"""
    digest: str
    """SHA-256 of the file"""


def read_number_table(path: Path, *, gaps: bool = False) -> NumberTable:
    """Read a file; with `gaps`, an empty cell is allowed, and is not a number.

    Raises:
        UsageError: the file cannot be read, or a row does not hold as many numbers as there are names.
    """
    try:
        content = read_regular(path, LARGEST_FILE)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"cannot read {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise UsageError(f"cannot read {path}: it is not a text file in UTF-8") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    names = [name.strip() for name in lines[0].split(",")] if lines else []
    rows = np.empty((max(len(lines) - 1, 0), len(names)))
    for number, line in enumerate(lines[1:]):
        try:
            cells = [math.nan if gaps and not cell.strip() else float(cell) for cell in line.split(",")]
        except ValueError:
            cells = []
        if len(cells) != len(names):
            wanted = f"{len(names)} numbers{' or empty cells' if gaps else ''}"
            raise UsageError(f"{path}: row {number + 1} does not hold {wanted}: {line[:60]}")
        rows[number] = cells
    return NumberTable(names, rows, sha256(content).hexdigest())


def write_complete(contents: Mapping[Path, bytes]) -> None:
    """Write files, which get their names when all of them are complete, and replace others.

    Raises:
        UsageError: one cannot be written.
    """
    try:
        for path, content in contents.items():
            write_new(partial_name(path), content)
        for path in contents:
            partial_name(path).replace(path)
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from None
    finally:
        for path in contents:
            with suppress(OSError):  # its folder may be what cannot be used
                partial_name(path).unlink()
