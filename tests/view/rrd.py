"""What is in a Rerun recording."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
from rerun.chunk import RrdReader


def chunks(path: Path) -> list[Any]:
    """All that a recording holds; it is read once, as long as it is the same."""
    status = path.stat()
    return _chunks(path, status.st_ino, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=2)
def _chunks(path: Path, *_status: int) -> list[Any]:
    return list(RrdReader(path).stream())


def column(path: Path, entity: str, component: str) -> np.ndarray:
    """All values that a recording holds of one component, in the order of the stamps."""
    values: list[tuple[int, int, Any]] = []
    for chunk in chunks(path):
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                rows = zip(
                    batch.column("stamp").cast("int64").to_pylist(), batch.column(component).to_pylist(), strict=True
                )
                values += [(stamp, len(values) + i, value) for i, (stamp, value) in enumerate(rows)]
    return np.array([value for _, _, value in sorted(values)])


def lists(path: Path, entity: str, component: str) -> list[tuple[int, Any]]:
    """The same with the stamps, where values have not all the same length."""
    values = []
    for chunk in chunks(path):
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                values += zip(
                    batch.column("stamp").cast("int64").to_pylist(), batch.column(component).to_pylist(), strict=True
                )
    return sorted(values, key=lambda pair: pair[0])


def entities(path: Path) -> dict[str, set[str]]:
    """The components that change, by entity."""
    found: dict[str, set[str]] = {}
    for chunk in chunks(path):
        if not chunk.is_static:
            names = {name for name in chunk.to_record_batch().schema.names if ":" in name}
            found.setdefault(chunk.entity_path, set()).update(names)
    return found


def still(path: Path, component: str) -> set[str]:
    """The entities that hold a component which does not change."""
    found = (chunk for chunk in chunks(path) if chunk.is_static)
    return {chunk.entity_path for chunk in found if component in chunk.to_record_batch().schema.names}
