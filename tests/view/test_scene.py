"""The scene: what is in it, where and when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.model.types import ROW
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.results import DATES_FROM
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.topics import Answer
from knee_contact_ros.view.anatomy import POINTS, KneeOutlines, drawing_of
from knee_contact_ros.view.output import RerunFile
from knee_contact_ros.view.scene import PICTURE_PERIOD, Scene
from tests.helpers.answers import contact, rows_of
from tests.view.rrd import column, entities, lists
from tests.view.scenes import WEIGHT, answered, at, written

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


def test_what_is_drawn_is_where_the_answers_say(right_bag: Path, tmp_path: Path) -> None:
    names = {"translation.mechanism": "parallel_mechanism", "tibia.geometry": "circle", "load.share": 1.0}
    pipeline = ContactStream(load_parameters(names), compiled=False)
    answers = answered(pipeline, right_bag, 240)
    model = pipeline.model
    path = written(tmp_path / "knee.rrd", drawing_of(model, "knee", WEIGHT), [rows_of(answers)])

    def drawn(entity: str, component: str) -> np.ndarray:
        """One vector per tick, y turned from the screen's direction (down) to the tibia's (up)."""
        vectors = column(path, f"/knee/sagittal/{entity}", component).reshape(len(answers), -1)
        return vectors * np.where(np.arange(vectors.shape[1]) == 1, -1.0, 1.0)

    contacts = list(rows_of(answers))
    angles = np.array([contact.flexion_angle for contact in contacts])
    height = [1e3 * contact.femoral_height for contact in contacts]
    x = [1e3 * model.pair.mechanism.translation(angle)[0] for angle in angles.tolist()]
    point = [(1e3 * contact.contact_point.x, 1e3 * contact.contact_point.y) for contact in contacts]
    closest = [model.closest(contact.flexion_angle, contact.femoral_height) for contact in contacts]
    force = np.array([contact.contact_force for contact in contacts])
    arrow = np.array([(where.normal_x, where.normal_y) for where in closest]) * force[:, None] / 50.0  # N per mm
    # Rerun keeps single precision: 6e-8 of lengths of 40 mm, and of quaternions of 1.
    assert drawn("femur", "Transform3D:translation") == pytest.approx(np.stack([x, height, 0.0 * angles], 1), abs=1e-5)
    assert drawn("contact_point", "Points2D:positions") == pytest.approx(np.array(point), abs=1e-5)
    assert drawn("contact_path", "Points2D:positions") == pytest.approx(np.array(point), abs=1e-5)
    assert drawn("contact_force_on_femur", "Arrows2D:origins") == pytest.approx(np.array(point), abs=1e-5)
    assert drawn("contact_force_on_femur", "Arrows2D:vectors") == pytest.approx(arrow, abs=1e-5)
    told = [text[0] for _, text in lists(path, "/knee/sagittal/contact_force", "Points2D:labels")]
    assert told == [f"{newtons:.0f} N\n{newtons / WEIGHT:.2f} BW" for newtons in force.tolist()]
    in_front, behind = (column(path, f"/knee/{root}/femur", "Transform3D:quaternion") for root in ("sagittal", "body"))
    assert np.array_equal(in_front, behind)
    quaternion = in_front.reshape(len(answers), 4)
    # Flexion turns the femur from anterior to superior, which is backwards on a screen whose y points down.
    assert 2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3]) == pytest.approx(-angles, abs=1e-6)
    assert quaternion[:, :2] == pytest.approx(0.0, abs=0.0)
    # There is something to see in every one of them.
    assert min(np.ptp(angles), np.ptp(x), np.abs(arrow[:, 0]).max()) > 0.4


def test_the_overlap_is_as_deep_as_the_answers_say(knee: tuple[KneeOutlines, list[Answer]], drawn: Path) -> None:
    _, answers = knee
    contacts = rows_of(answers)
    corners = column(drawn, "/knee/body/overlap", "Mesh3D:vertex_positions")
    # As it is, and magnified: its cartilage, its bone; each along the tibia and along the femur.
    assert corners.shape == (len(answers), 3 * 2 * POINTS, 3)
    upper, lower, top, cartilage, bone, bottom = corners.reshape(len(answers), 6, POINTS, 3).transpose(1, 0, 2, 3)
    depth = 1e3 * contacts["penetration_depth"]
    # 13 places: the deepest is within half a step, 1/24 of the width, and a parabola is 1/144 lower there; the
    # outline's corners cut some micrometres off. On the screen y points down.
    near = {"rel": 0.01, "abs": 2e-3}
    assert (lower - upper)[..., 1].max(axis=1) == pytest.approx(depth, **near)
    assert np.array_equal(upper, top)
    assert (bottom - top)[..., 1].max(axis=1) == pytest.approx(10.0 * depth, rel=0.01, abs=2e-2)
    assert (cartilage - top)[..., 1].max(axis=1) == pytest.approx(10.0 * np.minimum(depth, 0.5), rel=0.01, abs=2e-2)
    assert np.array_equal(cartilage, bone)
    point = 1e3 * contacts["contact_point"]["x"]
    assert (upper[:, 0, 0] < point).all()
    assert (point < upper[:, -1, 0]).all()
    told = [text[0] for _, text in lists(drawn, "/knee/sagittal/depth", "Points2D:labels")]
    assert told == [f"{one:.2f} mm deep\ndrawn × 10" for one in depth.tolist()]


def test_apart_there_is_no_overlap(tmp_path: Path) -> None:
    model = ContactStream(load_parameters({}), compiled=False).model
    rows = np.frombuffer(contact(penetration_depth=0.0, gap=1e-3, femoral_height=0.035).tobytes(), ROW)
    path = written(tmp_path / "knee.rrd", drawing_of(model, "knee", WEIGHT), [rows])
    corners = column(path, "/knee/body/overlap", "Mesh3D:vertex_positions")
    assert corners.shape == (1, 2 * 2 * POINTS, 3)
    assert np.ptp(corners[0], axis=0) == pytest.approx([0.0, 0.0, 0.0])
    assert [text[0] for _, text in lists(path, "/knee/sagittal/depth", "Points2D:labels")] == ["1.00 mm apart"]


def test_apart_the_force_is_told_on_the_tibia_and_else_above_its_arrow(tmp_path: Path) -> None:
    model = ContactStream(load_parameters({}), compiled=False).model
    flying = contact(penetration_depth=0.0, contact_force=0.0, gap=14e-3, femoral_height=0.048)
    rows = np.frombuffer(flying.tobytes() + contact(contact_force=700.0).tobytes(), ROW)
    path = written(tmp_path / "knee.rrd", drawing_of(model, "knee", WEIGHT), [at(rows, [0, PICTURE_PERIOD])])
    words, point = (
        column(path, f"/knee/sagittal/{name}", "Points2D:positions").reshape(2, 2)
        for name in ("contact_force", "contact_point")
    )
    assert words[0] == pytest.approx(point[0])  # words stand below their places: in the tibia, not in the gap
    assert words[1, 1] < point[1, 1] - 700.0 / 50.0  # N per mm; the screen's y points down


def test_how_answers_are_cut_into_batches_makes_no_difference(
    knee: tuple[KneeOutlines, list[Answer]], drawn: Path, tmp_path: Path
) -> None:
    (drawing, answers), whole = knee, drawn
    cuts = [0, 1, 2, 40, 41, 200, 387]
    parts = [rows_of(answers[begin:end]) for begin, end in pairwise(cuts)]
    cut = written(tmp_path / "cut.rrd", drawing, parts)
    assert entities(whole) == entities(cut)
    for entity, components in entities(whole).items():
        if entity != "/knee/curves/layer":  # two points of a level line a batch
            for component in components:
                assert lists(whole, entity, component) == lists(cut, entity, component), (entity, component)


def test_no_more_pictures_than_a_screen_can_show(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    whole = rows_of(answers)
    fast = at(whole, whole["stamp"][0] + 1_000_000 * np.arange(len(whole)))
    path = written(tmp_path / "knee.rrd", drawing, [fast[:100], fast[100:]])
    assert len(column(path, "/knee/curves/flexion", "Scalars:scalars")) == 387
    stamps = [stamp for stamp, _ in lists(path, "/knee/sagittal/femur", "Transform3D:translation")]
    assert len(stamps) == math.ceil(387 * 1_000_000 / PICTURE_PERIOD)


def test_states_are_written_where_they_change(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    path = written(tmp_path / "knee.rrd", drawing, [rows_of(answers[:100]), rows_of(answers[100:])])
    told = [state[0] for _, state in lists(path, "/knee/states/contact", "StateChange:state")]
    names = ["apart", "cartilage", "bone"]
    states = [names[contact.contact_state] for contact in rows_of(answers)]
    assert told == [state for i, state in enumerate(states) if i == 0 or state != states[i - 1]]
    assert len(told) > 3


@pytest.mark.parametrize(
    ("seconds", "repeated"),
    [(range(1, 30), [1, 6, 11, 16, 21, 26]), ((100, 103, 20, 23, 26), [20, 26, 100])],
    ids=["for long", "after stamps went back"],
)
def test_states_are_repeated_where_what_is_old_gets_lost(
    knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path, seconds: Sequence[int], repeated: list[int]
) -> None:
    drawing, answers = knee
    outlet = RerunFile(tmp_path / "knee.rrd", [drawing])
    scene = Scene(outlet.recording, drawing, forgetful=True)
    for second in seconds:
        scene.show(at(rows_of(answers[:1]), 1_000_000_000 * second))
    outlet.close()
    told = lists(outlet.path, "/knee/states/contact", "StateChange:state")
    assert [stamp // 1_000_000_000 for stamp, _ in told] == repeated
    assert {state[0] for _, state in told} == {"cartilage"}


def test_a_new_layer_depth_moves_the_line_and_is_told(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    outlet = RerunFile(tmp_path / "knee.rrd", [drawing])
    scene = Scene(outlet.recording, drawing)
    scene.show(rows_of(answers[:10]))
    scene.note("parameters_changed", {"tick": "10", "contact.layer_depth": "0.001"})
    scene.show(rows_of(answers[10:20]))
    scene.note("reset", {"tick": "20"})
    outlet.close()
    assert column(outlet.path, "/knee/curves/layer", "Scalars:scalars").ravel() == pytest.approx([0.5, 0.5, 1.0, 1.0])
    told = [text[0] for _, text in lists(outlet.path, "/knee/events", "TextLog:text")]
    assert "0.575 s  parameters changed: contact.layer_depth = 0.001" in told
    assert len(column(outlet.path, "/knee/curves/pressure", "Scalars:scalars")) == 10  # of another law nothing is said
    assert len(column(outlet.path, "/knee/curves/loading_rate", "Scalars:scalars")) == 19
    assert "0.625 s  reset" in told


def test_a_note_before_the_first_answer_waits_for_its_stamp(
    knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path
) -> None:
    """A timeline has one kind of time: it is not known before."""
    drawing, answers = knee
    outlet = RerunFile(tmp_path / "knee.rrd", [drawing])
    scene = Scene(outlet.recording, drawing)
    scene.note("reset", {"tick": "0"})
    scene.show(at(rows_of(answers[:1]), DATES_FROM * 5))
    outlet.close()
    told = lists(outlet.path, "/knee/events", "TextLog:text")
    assert told == [(DATES_FROM * 5, ["2019-12-20 00:00:00.000  reset"])]


def test_stamps_of_today_are_dates(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    today, whole = DATES_FROM * 5, rows_of(answers)
    path = written(tmp_path / "knee.rrd", drawing, [at(whole, today + whole["stamp"])])
    stamps = [stamp for stamp, _ in lists(path, "/knee/curves/flexion", "Scalars:scalars")]
    assert stamps == (today + whole["stamp"]).tolist()
    assert "2019-12-20 00:00:02.430  load peak 2.19 BW (1613.8 N)" in [
        text[0] for _, text in lists(path, "/knee/events", "TextLog:text")
    ]
