"""Knees and gaits that tests of the scene draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.model.types import Rows
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.topics import Answer
from knee_contact_ros.view.anatomy import KneeOutlines
from knee_contact_ros.view.output import RerunFile
from knee_contact_ros.view.scene import Scene
from tests.helpers.messages import raw_inputs

WEIGHT = 737.068


SHIPPED: dict[str, list[str]] = {
    "healthy": ["healthy.yaml"],
    "osteoarthritis": ["osteoarthritis.yaml"],
    "healthy, MRI femur": ["healthy.yaml", "mri_femur.yaml"],
    "osteoarthritis, MRI femur": ["osteoarthritis.yaml", "mri_femur.yaml"],
    "healthy, MRI knee": ["healthy.yaml", "mri_knee.yaml"],
    "osteoarthritis, MRI knee": ["osteoarthritis.yaml", "mri_knee.yaml"],
}


def answered(pipeline: ContactStream, bag: Path, most: int = 10_000) -> list[Answer]:
    answers: list[Answer] = []
    for topic, _, message in raw_inputs(bag)[:most]:
        answers += (pipeline.joint_state if topic == "/joint_states" else pipeline.force)(message)
    return answers


def written(path: Path, drawing: KneeOutlines, batches: list[Rows], latency: bool = False) -> Path:
    outlet = RerunFile(path, [drawing], latency=latency)
    scene = Scene(outlet.recording, drawing, latency=latency)
    for batch in batches:
        scene.show(batch)
    scene.finish()
    outlet.close()
    return path


def at(rows: Rows, stamps: Any) -> Rows:
    """The same answers at other stamps [ns]."""
    rows = rows.copy()
    rows["stamp"] = stamps
    return rows
