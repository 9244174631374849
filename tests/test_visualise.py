"""The Rerun file: what is in it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from knee_contact_ros.answer import Answer
from knee_contact_ros.drawing import Shown, drawing_of, shown_row
from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import load_parameters
from knee_contact_ros.pipeline import Pipeline
from knee_contact_ros.visualise import SERIES, RerunFile, open_output
from tests.messages import raw_inputs


@pytest.fixture(scope="module")
def knee(config: Path, right_bag: Path) -> tuple[Pipeline, list[Answer]]:
    """The osteoarthritic knee with its MRI profile, and its gait."""
    pipeline = Pipeline(load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"]), compiled=False)
    answers: list[Answer] = []
    for topic, _, message in raw_inputs(right_bag):
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
    view = open_output(path, drawing_of(pipeline.model, 737.068))
    for answer in answers:
        view.write(shown_row(answer))
    view.finish(pipeline.ending())
    assert [p.name for p in tmp_path.iterdir()] == ["knee.rrd"]
    for series in SERIES:
        assert len(column(path, f"/curves/{series}", "Scalars:scalars")) == 387, series
    depth = column(path, "/curves/depth/penetration", "Scalars:scalars").ravel()
    assert depth == pytest.approx([1e3 * answer.contact.penetration_depth for answer in answers], rel=1e-12)
    flexion = column(path, "/curves/flexion/angle", "Scalars:scalars").ravel()
    assert flexion == pytest.approx([math.degrees(answer.contact.flexion_angle) for answer in answers], rel=1e-12)
    assert len(column(path, "/sagittal/contact_point", "Points2D:positions")) == 387


def test_what_is_drawn_is_where_the_answers_say(right_bag: Path, tmp_path: Path) -> None:
    names = {"translation.mechanism": "parallel_mechanism", "tibia.geometry": "circle", "load.share": 1.0}
    pipeline = Pipeline(load_parameters(names), compiled=False)
    answers: list[Answer] = []
    for topic, _, message in raw_inputs(right_bag)[:240]:
        answers += (pipeline.joint_state if topic == "/joint_states" else pipeline.joint_reaction_force)(message)
    path, model = tmp_path / "knee.rrd", pipeline.model
    scene = RerunFile(path, drawing_of(model, 737.068))
    scene.show([Shown(*shown_row(answer)) for answer in answers])
    scene.close()

    def drawn(entity: str, component: str) -> np.ndarray:
        """One vector per tick, y turned from the screen's direction (down) to the tibia's (up)."""
        vectors = column(path, f"/sagittal/{entity}", component).reshape(len(answers), -1)
        return vectors * np.where(np.arange(vectors.shape[1]) == 1, -1.0, 1.0)

    contacts = [answer.contact for answer in answers]
    angles = np.array([contact.flexion_angle for contact in contacts])
    height = [1e3 * contact.femoral_height for contact in contacts]
    x = [1e3 * model.mechanism.translation(angle)[0] for angle in angles.tolist()]
    point = [(1e3 * contact.contact_point.x, 1e3 * contact.contact_point.y) for contact in contacts]
    closest = [model.closest(contact.flexion_angle, contact.femoral_height) for contact in contacts]
    force = np.array([contact.contact_force for contact in contacts])
    arrow = np.array([(where.normal_x, where.normal_y) for where in closest]) * force[:, None] / 50.0  # N per mm
    # Rerun keeps single precision: 6e-8 of lengths of 40 mm, and of quaternions of 1.
    assert drawn("femur", "Transform3D:translation") == pytest.approx(np.stack([x, height, 0.0 * angles], 1), abs=1e-5)
    assert drawn("contact_point", "Points2D:positions") == pytest.approx(np.array(point), abs=1e-5)
    assert drawn("contact_force_on_femur", "Arrows2D:origins") == pytest.approx(np.array(point), abs=1e-5)
    assert drawn("contact_force_on_femur", "Arrows2D:vectors") == pytest.approx(arrow, abs=1e-5)
    quaternion = column(path, "/sagittal/femur", "Transform3D:quaternion").reshape(len(answers), 4)
    # Flexion turns the femur from anterior to superior, which is backwards on a screen whose y points down.
    assert 2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3]) == pytest.approx(-angles, abs=1e-6)
    assert quaternion[:, :2] == pytest.approx(0.0, abs=0.0)
    # There is something to see in every one of them.
    assert min(np.ptp(angles), np.ptp(x), np.abs(arrow[:, 0]).max()) > 0.4


def test_existing_files_and_bad_folders_are_refused(knee, tmp_path: Path) -> None:
    drawing = drawing_of(knee[0].model, 737.0)
    (tmp_path / "old.rrd").touch()
    with pytest.raises(UsageError, match="exists already"):
        RerunFile(tmp_path / "old.rrd", drawing)
    (tmp_path / "cut.rrd.partial").touch()
    with pytest.raises(UsageError, match="was cut off"):
        RerunFile(tmp_path / "cut.rrd", drawing)
    with pytest.raises(UsageError, match="cannot write"):
        RerunFile(tmp_path / "old.rrd" / "new.rrd", drawing)
