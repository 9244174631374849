"""Knees and gaits that tests of the scene draw, and what is in the Rerun files."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
from rerun.chunk import RrdReader

from knee_contact_ros.view.output import RerunFile
from knee_contact_ros.view.scene import Scene
from tests.helpers.answers import answers_to, rows_of
from tests.helpers.bags import raw_messages

WEIGHT = 737.068
SHIPPED = [
    [law, *surface]
    for law in ("healthy.yaml", "osteoarthritis_as_printed.yaml")
    for surface in ([], ["mri_femur.yaml"], ["mri_knee.yaml"])
]
"""Parameter files of all shipped knees"""


def answers_of(stream, bag, most=10_000):
    return answers_to(stream, raw_messages(bag)[:most])


def answered(stream, bag, most=10_000):
    return rows_of([*answers_of(stream, bag, most)])


def written(path, drawing, parts, latency=False, **options):
    """A scene of batches of answers, and of notes (name and values) between them."""
    file = RerunFile(path, [drawing], latency=latency)
    scene = Scene(file.recording, drawing, latency=latency, **options)
    for part in parts:
        scene.note(*part) if isinstance(part, tuple) else scene.show(part)
    scene.finish()
    file.close()
    return path


def at(rows, stamps):
    """The same answers at other stamps [ns]."""
    rows = rows.copy()
    rows["stamp"] = stamps
    return rows


@lru_cache(maxsize=2)
def _chunks(path, *_status):
    return [
        (chunk.entity_path, chunk.is_static, chunk.to_record_batch())
        for chunk in RrdReader(path).stream()
    ]


def chunks(path):
    """All that a recording holds (path, whether it is constant, data); it is read once, as long as it is the same."""
    status = path.stat()
    return _chunks(path, status.st_ino, status.st_size, status.st_mtime_ns)


def lists(path, entity, component):
    """Stamps and values of one component, in the order of the stamps."""
    values: list[tuple[int, Any]] = []
    for place, still, batch in chunks(path):
        if place == entity and not still and component in batch.schema.names:
            stamps = batch.column("stamp").cast("int64").to_pylist()
            values += zip(stamps, batch.column(component).to_pylist(), strict=True)
    return sorted(values, key=lambda pair: pair[0])


def column(path, entity, component="Scalars:scalars"):
    """The values alone, where all have the same length."""
    return np.array([value for _, value in lists(path, entity, component)])


def texts_of(path, entity="events", component="TextLog:text"):
    """Texts of the knee, in the order of the stamps."""
    return [text[0] for _, text in lists(path, f"/knee/{entity}", component)]


def entities(path):
    """The components that change, by entity."""
    found: dict[str, set[str]] = {}
    for place, still, batch in chunks(path):
        if not still:
            found.setdefault(place, set()).update(
                name for name in batch.schema.names if ":" in name
            )
    return found


def constant(path, component):
    """The entities that hold a component which does not change."""
    return {
        place for place, still, batch in chunks(path) if still and component in batch.schema.names
    }
