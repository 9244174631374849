"""The layout: the frame that knees share, and what stands beside what."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
import rerun.blueprint as rrb
from rerun.blueprint.api import Container

from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.topics import Answer
from knee_contact_ros.view.anatomy import KneeOutlines, drawing_of, placed
from knee_contact_ros.view.layout import blueprint, common, frame_of
from tests.view.scenes import SHIPPED, WEIGHT

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


def test_knees_of_one_scene_have_one_frame(config: Path) -> None:
    drawings = [
        drawing_of(
            ContactStream(load_parameters([config / file for file in files]), compiled=False).model, "knee", WEIGHT
        )
        for files in SHIPPED.values()
    ]
    frame = common([frame_of(drawing) for drawing in drawings])
    for drawing in drawings:
        knee = drawing.anatomy
        lowest = knee.femur_cartilage[:, 1].min()
        for angle in (0.0, 1.0):
            points = 1e3 * np.concatenate([placed(knee.femur_bone, angle, 0.0, -lowest), knee.tibia_bone])
            assert frame.x[0] < points[:, 0].min()
            assert points[:, 0].max() < frame.x[1]
            assert frame.y[0] < -points[:, 1].max()
            assert -points[:, 1].min() < frame.y[1]


@pytest.mark.parametrize(
    ("files", "changes"),
    [
        (["healthy"], {"tibia.slope": -0.7}),
        (["healthy"], {"tibia.slope": 0.7}),
        (["healthy"], {"femur.radius": 0.2}),
    ],
)
def test_a_steep_or_large_knee_is_seen_whole_with_its_words(files: list[str], changes: dict[str, float]) -> None:
    model = load_model([*files, changes])
    drawing = drawing_of(model, "knee", WEIGHT)
    frame = frame_of(drawing)
    for angle in (0.0, 1.0):
        x, _ = model.pair.mechanism.translation(angle)
        touching = model.closest(angle, 1.0)
        height = 1.0 + touching.depth / touching.normal_y  # a circle and a plane: the normal stays
        assert frame.y[0] < -1e3 * placed(drawing.anatomy.femur_bone, angle, x, height)[:, 1].max()
    room = (frame.y[1] - frame.scale[1]) / (frame.y[1] - frame.y[0])
    assert room > 0.05  # below the marks, where their words stand


@pytest.mark.parametrize("knees", [["left", "right"], ["left_medial", "left_lateral", "right"]])
def test_narrow_views_of_states_have_short_names(knees: list[str], knee: tuple[KneeOutlines, list[Answer]]) -> None:
    def views(container: Any) -> list[Any]:
        within = isinstance(container, Container)
        return [view for part in container.contents for view in views(part)] if within else [container]

    drawn = blueprint([knee[0]._replace(knee=name) for name in knees])
    states = [view.name for view in views(drawn.root_container) if isinstance(view, rrb.StateTimelineView)]
    assert states == ([f"{name}: contact and level" for name in knees] if len(knees) == 2 else knees)


@pytest.mark.parametrize(("knees", "columns"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_two_planes_at_most_stand_side_by_side(
    knee: tuple[KneeOutlines, list[Answer]], knees: int, columns: int
) -> None:
    layout = blueprint([knee[0]._replace(knee=f"knee_{number}") for number in range(knees)])
    planes = layout.root_container.contents[0].contents[0]
    assert (len(planes.contents), planes.grid_columns) == (knees, columns)
