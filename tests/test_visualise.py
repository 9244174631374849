"""The Rerun file: what is in it, and that it never holds up its caller."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import load_parameters
from knee_contact_ros.pipeline import Answer, Pipeline
from knee_contact_ros.stream_in.bag import INPUT_TYPES, read_bag
from knee_contact_ros.visualise import SERIES, RerunFile, RerunThread


@pytest.fixture(scope="module")
def knee(config: Path, right_bag: Path) -> tuple[Pipeline, list[Answer]]:
    """The osteoarthritic knee with its MRI profile, and its gait."""
    pipeline = Pipeline(load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"]))
    answers: list[Answer] = []
    for topic, _, message in read_bag(right_bag, INPUT_TYPES):
        answers += (pipeline.joint_state if topic == "/joint_states" else pipeline.joint_reaction_force)(message)
    return pipeline, answers


def column(path: Path, entity: str, component: str) -> np.ndarray:
    """All values that a recording holds of one component, in the order of the stamps."""
    values: list[tuple[object, object]] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            values += zip(batch.column("stamp").to_pylist(), batch.column(component).to_pylist(), strict=True)
    return np.array([value for _, value in sorted(values)])


def test_every_curve_holds_every_tick(knee: tuple[Pipeline, list[Answer]], tmp_path: Path) -> None:
    pipeline, answers = knee
    path = tmp_path / "knee.rrd"
    thread = RerunThread(RerunFile(path, pipeline.model, 737.068), pytest.fail)
    for answer in answers:
        thread.put(answer)
    thread.close(pipeline.ending())
    assert (thread.dropped, thread.failure) == (0, "")
    assert [p.name for p in tmp_path.iterdir()] == ["knee.rrd"]
    for series in SERIES:
        assert len(column(path, f"/curves/{series}", "Scalars:scalars")) == 387, series
    depth = column(path, "/curves/depth/penetration", "Scalars:scalars").ravel()
    assert depth == pytest.approx([1e3 * answer.contact.penetration_depth for answer in answers], rel=1e-12)
    flexion = column(path, "/curves/flexion/angle", "Scalars:scalars").ravel()
    assert flexion == pytest.approx([math.degrees(answer.contact.flexion_angle) for answer in answers], rel=1e-12)
    assert len(column(path, "/sagittal/contact_point", "Points2D:positions")) == 387


def test_a_full_queue_drops_and_counts(knee: tuple[Pipeline, list[Answer]], tmp_path: Path, monkeypatch) -> None:
    pipeline, answers = knee
    monkeypatch.setattr("knee_contact_ros.visualise.QUEUE", 5)
    monkeypatch.setattr(RerunThread, "_run", lambda self: None)  # a viewer that takes nothing
    thread = RerunThread(RerunFile(tmp_path / "knee.rrd", pipeline.model, 737.068), pytest.fail)
    for answer in answers[:12]:
        thread.put(answer)
    assert thread.dropped == 7


def test_a_viewer_that_fails_says_so_once_and_stops(knee, tmp_path: Path, monkeypatch) -> None:
    pipeline, answers = knee
    told: list[str] = []

    def broken(self: RerunFile, batch: list[Answer]) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(RerunFile, "show", broken)
    monkeypatch.setattr("knee_contact_ros.visualise.QUEUE", 200)  # as if it had filled before the failure
    thread = RerunThread(RerunFile(tmp_path / "knee.rrd", pipeline.model, 737.068), told.append)
    for answer in answers:
        thread.put(answer)
    thread.close(pipeline.ending())
    assert len(told) == 1
    assert "disk full" in told[0]


def test_existing_files_and_bad_folders_are_refused(knee, tmp_path: Path) -> None:
    model = knee[0].model
    (tmp_path / "old.rrd").touch()
    with pytest.raises(UsageError, match="exists already"):
        RerunFile(tmp_path / "old.rrd", model, 737.0)
    (tmp_path / "cut.rrd.partial").touch()
    with pytest.raises(UsageError, match="was cut off"):
        RerunFile(tmp_path / "cut.rrd", model, 737.0)
    with pytest.raises(UsageError, match="cannot write"):
        RerunFile(tmp_path / "old.rrd" / "new.rrd", model, 737.0)
