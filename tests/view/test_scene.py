"""The scene: what is in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
import rerun.blueprint as rrb
from rerun.blueprint.api import Container

from knee_contact_ros.core.types import ROW, Rows
from knee_contact_ros.messages.answer import Answer
from knee_contact_ros.offline.in_memory import solve
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.pipeline.gait.strides import impulse_per_stride
from knee_contact_ros.pipeline.pipeline import Pipeline
from knee_contact_ros.results.columns import DATES_FROM
from knee_contact_ros.view.anatomy import placed
from knee_contact_ros.view.colours import KNEE_COLOURS
from knee_contact_ros.view.cursor import peak_of
from knee_contact_ros.view.frame import common, frame_of
from knee_contact_ros.view.layout import LONGEST_TITLE, blueprint, plane_title, title_of
from knee_contact_ros.view.outlets import RerunFile
from knee_contact_ros.view.outlines import KneeOutlines, drawing_of
from knee_contact_ros.view.overlap import POINTS
from knee_contact_ros.view.plots import DETAILS, FORCES, KNEE, LAYER_COLOUR, LOAD_PLACE, READ_OFF, plots_of
from knee_contact_ros.view.remarks import Remarks
from knee_contact_ros.view.sagittal import PICTURE_PERIOD
from knee_contact_ros.view.scene import Scene
from tests.helpers.answers import contact, rows_of
from tests.helpers.messages import raw_inputs
from tests.view.rrd import column, entities, lists, still

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several
WEIGHT = 737.068
PLOTS = (*KNEE, *DETAILS)


def answered(pipeline: Pipeline, bag: Path, most: int = 10_000) -> list[Answer]:
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


@pytest.fixture(scope="module")
def knee(config: Path, right_bag: Path) -> tuple[KneeOutlines, list[Answer]]:
    """The osteoarthritic knee with its MRI profile, and its gait."""
    pipeline = Pipeline(load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"]), compiled=False)
    answers = answered(pipeline, right_bag)
    return drawing_of(pipeline.model, "knee", WEIGHT), answers


@pytest.fixture(scope="module")
def drawn(knee: tuple[KneeOutlines, list[Answer]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of it, drawn at once."""
    drawing, answers = knee
    return written(tmp_path_factory.mktemp("drawn") / "knee.rrd", drawing, [rows_of(answers)])


def at(rows: Rows, stamps: Any) -> Rows:
    """The same answers at other stamps [ns]."""
    rows = rows.copy()
    rows["stamp"] = stamps
    return rows


def test_every_curve_holds_every_tick(knee: tuple[KneeOutlines, list[Answer]], drawn: Path) -> None:
    (_, answers), path = knee, drawn
    assert [p.name for p in path.parent.iterdir()] == ["knee.rrd"]
    contacts = list(rows_of(answers))
    curves = {
        plot.path: column(path, f"/knee/curves/{plot.path}", "Scalars:scalars") for plot in PLOTS if not plot.live
    }
    for plot in PLOTS:
        if not plot.live:
            assert curves[plot.path].shape == (387, len(plot.series)), plot
    depth, error = (np.array([getattr(c, name) for c in contacts]) for name in ("penetration_depth", "error_estimate"))
    load, force = (np.array([getattr(contact, name) for contact in contacts]) for name in ("load", "contact_force"))
    near = pytest.approx  # the same arithmetic in another order: a few roundings of 1e-16
    gap = np.array([contact.gap for contact in contacts])
    signed = 1e3 * np.stack([depth - gap - error, depth - gap + error, depth - gap], 1)
    assert curves["depth"] == near(signed, rel=1e-12)
    uncertain = np.array([contact.force_error_estimate for contact in contacts])
    noise = np.maximum(3.0 * uncertain, 0.01 * WEIGHT)
    excess = np.where(np.abs(force - load) > noise, force - load, 0.0)
    assert 0 < np.count_nonzero(excess) < len(excess)
    bands = np.stack([force - uncertain, force + uncertain, force, load, excess], 1)
    assert curves["force"] == near(bands / WEIGHT, rel=1e-12)
    assert curves["flexion"][:, 0] == near([math.degrees(contact.flexion_angle) for contact in contacts], rel=1e-12)
    assert curves["contact_point"][:, 0] == near([1e3 * contact.contact_point.x for contact in contacts], rel=1e-12)
    sliding = [1e3 * contact.sliding_velocity for contact in contacts]
    assert curves["sliding"][:, 0] == near(sliding, rel=1e-12)
    assert np.ptp(sliding) > 100.0
    assert curves["error"] == near(np.stack([uncertain, 1e6 * error], 1), rel=1e-12, nan_ok=True)
    assert curves["evaluations"][:, 0] == near([contact.evaluations for contact in contacts])
    assert column(path, "/knee/curves/layer", "Scalars:scalars").ravel() == near([0.5, 0.5])
    assert "/knee/curves/latency" not in entities(path)


def test_latency_is_there_where_it_is_measured(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    measured = rows_of(answers[:5]).copy()
    measured["latency"] = 1e-3 * np.arange(5)
    path = written(tmp_path / "knee.rrd", drawing, [measured], latency=True)
    assert column(path, "/knee/curves/latency", "Scalars:scalars").ravel() == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0])


def test_what_is_drawn_is_where_the_answers_say(right_bag: Path, tmp_path: Path) -> None:
    names = {"translation.mechanism": "parallel_mechanism", "tibia.geometry": "circle", "load.share": 1.0}
    pipeline = Pipeline(load_parameters(names), compiled=False)
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
    x = [1e3 * model.mechanism.translation(angle)[0] for angle in angles.tolist()]
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
    model = Pipeline(load_parameters({}), compiled=False).model
    rows = np.frombuffer(contact(penetration_depth=0.0, gap=1e-3, femoral_height=0.035).tobytes(), ROW)
    path = written(tmp_path / "knee.rrd", drawing_of(model, "knee", WEIGHT), [rows])
    corners = column(path, "/knee/body/overlap", "Mesh3D:vertex_positions")
    assert corners.shape == (1, 2 * 2 * POINTS, 3)
    assert np.ptp(corners[0], axis=0) == pytest.approx([0.0, 0.0, 0.0])
    assert [text[0] for _, text in lists(path, "/knee/sagittal/depth", "Points2D:labels")] == ["1.00 mm apart"]


def test_apart_the_force_is_told_on_the_tibia_and_else_above_its_arrow(tmp_path: Path) -> None:
    model = Pipeline(load_parameters({}), compiled=False).model
    flying = contact(penetration_depth=0.0, contact_force=0.0, gap=14e-3, femoral_height=0.048)
    rows = np.frombuffer(flying.tobytes() + contact(contact_force=700.0).tobytes(), ROW)
    path = written(tmp_path / "knee.rrd", drawing_of(model, "knee", WEIGHT), [at(rows, [0, PICTURE_PERIOD])])
    words, point = (
        column(path, f"/knee/sagittal/{name}", "Points2D:positions").reshape(2, 2)
        for name in ("contact_force", "contact_point")
    )
    assert words[0] == pytest.approx(point[0])  # words stand below their places: in the tibia, not in the gap
    assert words[1, 1] < point[1, 1] - 700.0 / 50.0  # N per mm; the screen's y points down


SHIPPED: dict[str, list[str]] = {
    "healthy": ["healthy.yaml"],
    "osteoarthritis": ["osteoarthritis.yaml"],
    "healthy, MRI femur": ["healthy.yaml", "mri_femur.yaml"],
    "osteoarthritis, MRI femur": ["osteoarthritis.yaml", "mri_femur.yaml"],
    "healthy, MRI knee": ["healthy.yaml", "mri_knee.yaml"],
    "osteoarthritis, MRI knee": ["osteoarthritis.yaml", "mri_knee.yaml"],
}


@pytest.mark.parametrize("name", SHIPPED)
def test_no_plot_is_flat_and_no_legend_empty_for_any_shipped_knee(
    config: Path, right_bag: Path, tmp_path: Path, name: str
) -> None:
    pipeline = Pipeline(load_parameters([config / file for file in SHIPPED[name]]), compiled=False)
    drawing = drawing_of(pipeline.model, "knee", WEIGHT)
    rows = rows_of(answered(pipeline, right_bag, 150)).copy()
    rows["latency"] = 1e-4 * (1.0 + np.arange(len(rows)) % 7)
    for latency in (False, True):
        path = written(tmp_path / f"latency_{latency}.rrd", drawing, [rows], latency)
        check_plots_and_legends(name, drawing, latency, path)


def check_plots_and_legends(name: str, drawing: KneeOutlines, latency: bool, path: Path) -> None:
    with_bone, moving = "osteoarthritis" in name, "MRI" in name
    plots = plots_of(drawing, latency)
    assert [plot.path for plot in plots if plot in KNEE] == (
        ["flexion", "force", "depth", "contact_point"] if moving else ["flexion", "force", "depth"]
    )
    for plot in plots:
        curve = column(path, f"/knee/curves/{plot.path}", "Scalars:scalars")
        assert np.isfinite(curve).all()
        assert np.ptp(curve, axis=0).max() > 0.0, plot.path
    held = entities(path)
    curves = {entity for entity in held if entity.startswith("/knee/curves/")}
    layer = {"/knee/curves/layer"} if with_bone else set()
    assert curves == {f"/knee/curves/{plot.path}" for plot in plots} | layer
    for plot in plots:
        assert ("bone" in title_of([drawing], plot)) == (with_bone and plot.path == "depth")
    assert ("drawn only" in plane_title(drawing)) != with_bone
    assert {"/knee/states/contact", "/knee/states/level"} <= set(held)


def test_knees_of_one_scene_have_one_frame(config: Path) -> None:
    drawings = [
        drawing_of(Pipeline(load_parameters([config / file for file in files]), compiled=False).model, "knee", WEIGHT)
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
        x, _ = model.mechanism.translation(angle)
        touching = model.pair.closest(angle, x, 1.0)
        height = 1.0 + touching.depth / touching.normal_y  # a circle and a plane: the normal stays
        assert frame.y[0] < -1e3 * placed(drawing.anatomy.femur_bone, angle, x, height)[:, 1].max()
    room = (frame.y[1] - frame.scale[1]) / (frame.y[1] - frame.y[0])
    assert room > 0.05  # below the marks, where their words stand


def test_several_knees_are_told_apart_by_their_colours(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, _ = knee
    both = [drawing._replace(knee="left"), drawing._replace(knee="right", body_weight=800.0)]
    assert title_of(both, KNEE[1]).endswith("[BW of 737 or 800 N]: left blue, right orange")
    still = drawing._replace(knee="circle", contact_range=(0.0, 0.0))
    assert title_of([still, drawing], KNEE[3]).endswith("[mm]: knee orange")
    assert len({one.colour for one in KNEE_COLOURS}) == len(KNEE_COLOURS)
    four = [drawing._replace(knee=f"{side}_{of}") for side in ("left", "right") for of in ("medial", "lateral")]
    assert title_of(four, KNEE[0]) == (
        "Flexion angle [deg]: left_medial blue, left_lateral orange, right_medial green, right_lateral violet"
    )
    for plot in (*KNEE, *DETAILS, *READ_OFF):
        title = title_of(four, plot)
        assert len(title) <= LONGEST_TITLE
        assert title.endswith((": colours as of the flexion angle", "right_lateral violet"))


@pytest.mark.parametrize("knees", [["left", "right"], ["left_medial", "left_lateral", "right"]])
def test_narrow_views_of_states_have_short_names(knees: list[str], knee: tuple[KneeOutlines, list[Answer]]) -> None:
    def views(container: Any) -> list[Any]:
        within = isinstance(container, Container)
        return [view for part in container.contents for view in views(part)] if within else [container]

    drawn = blueprint([knee[0]._replace(knee=name) for name in knees])
    states = [view.name for view in views(drawn.root_container) if isinstance(view, rrb.StateTimelineView)]
    assert states == ([f"{name}: contact and level" for name in knees] if len(knees) == 2 else knees)


def test_the_largest_load_is_found_in_a_file(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    whole = rows_of(answers)
    assert KNEE[1].path == FORCES
    assert KNEE[1].series[LOAD_PLACE].name == "load [BW]"
    parts = [whole[:200], whole[200:]]
    assert peak_of(written(tmp_path / "knee.rrd", drawing, parts)) == (2_430_000_000, False)
    today = at(whole, DATES_FROM * 5 + whole["stamp"])
    assert peak_of(written(tmp_path / "today.rrd", drawing, [today])) == (DATES_FROM * 5 + 2_430_000_000, True)


@pytest.mark.parametrize(("knees", "columns"), [(1, 1), (2, 2), (3, 2), (4, 2)])
def test_two_planes_at_most_stand_side_by_side(
    knee: tuple[KneeOutlines, list[Answer]], knees: int, columns: int
) -> None:
    layout = blueprint([knee[0]._replace(knee=f"knee_{number}") for number in range(knees)])
    planes = layout.root_container.contents[0].contents[0]
    assert (len(planes.contents), planes.grid_columns) == (knees, columns)


def test_of_the_same_load_the_largest_force_is_found_and_nothing_counts_as_more(
    knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path
) -> None:
    drawing, answers = knee
    level = rows_of(answers).copy()
    level["load"] = 350.0  # as where the height drives
    assert peak_of(written(tmp_path / "level.rrd", drawing, [level])) == (
        int(level["stamp"][level["contact_force"].argmax()]),
        False,
    )
    missing = rows_of(answers).copy()
    missing["load"][:100] = np.nan
    assert peak_of(written(tmp_path / "missing.rrd", drawing, [missing])) == (2_430_000_000, False)


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


def test_events_are_told_with_their_times(knee: tuple[KneeOutlines, list[Answer]], drawn: Path) -> None:
    _, answers = knee
    told = [text[0] for _, text in lists(drawn, "/knee/events", "TextLog:text")]
    assert "2.015 s  load peak 1.81 BW (1337.7 N)" in told
    assert "2.430 s  load peak 2.19 BW (1613.8 N)" in told
    assert "1.955 s  bone contact begins" in told
    assert "2.125 s  bone contact ends" in told
    assert len([text for text in told if "heel strike" in text]) == 2
    assert len([text for text in told if "toe-off" in text]) == 1
    (stride,) = (text for text in told if "stride" in text)
    (expected,) = impulse_per_stride(rows_of(answers), WEIGHT)
    whole, stance = expected.impulse, expected.stance_impulse
    ending = f"stride of {expected.span.duration:.2f} s: impulse {whole:.1f} N s, stance {stance:.1f} N s"
    assert stride == f"{expected.span.end / 1e9:.3f} s  {ending}"


def test_every_stride_has_its_impulse_though_old_samples_go(right_bag: Path) -> None:
    """The shipped gait eight times without a pause, and once more from the beginning on."""
    gait = np.asarray(solve(right_bag))
    length = int(gait["stamp"][-1] - gait["stamp"][0]) + 5_000_000
    walked = np.concatenate([at(gait, gait["stamp"] + place * length) for place in range(8)])
    expected = impulse_per_stride(walked, WEIGHT)
    assert len(expected) >= 8
    whole = np.concatenate([walked, walked])
    for batches in ([whole], np.array_split(whole, 57), np.array_split(whole, 1000)):
        remarks = Remarks(WEIGHT)
        told = [remark for batch in batches for remark in remarks.take(batch)] + remarks.finish()
        strides = sorted(remark for remark in told if remark.text.startswith("stride"))
        for remark, one in zip(strides, [one for one in expected for _ in range(2)], strict=True):
            assert remark.stamp == one.span.end
            assert f"impulse {one.impulse:.1f} N s, stance {one.stance_impulse:.1f} N s" in remark.text


def test_where_the_height_drives_no_load_is_drawn(tmp_path: Path) -> None:
    model = load_model({"drive": "displacement"})
    time, angle = np.arange(0.0, 0.2, 0.01), np.full(20, 0.3)
    rows = np.asarray(model.run(time, angle, 0.0 * time, 0.0335 - 1e-4 * np.sin(30.0 * time)))
    drawing = drawing_of(model, "knee", WEIGHT)
    (forces,) = (plot for plot in plots_of(drawing, latency=False) if plot.path == FORCES)
    assert title_of([drawing], forces) == "Contact force ± error [BW of 737 N]"
    assert not any("load" in series.name for series in forces.series)
    path = written(tmp_path / "knee.rrd", drawing, [rows])
    assert column(path, f"/knee/curves/{FORCES}", "Scalars:scalars").shape == (20, 3)
    moment = peak_of(path)  # where the force is largest
    assert moment is not None
    assert moment.stamp == rows["stamp"][int(rows["contact_force"].argmax())]


def test_a_single_answer_is_seen_in_every_plot(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    shown = {f"/knee/curves/{plot.path}" for plot in plots_of(drawing, latency=False)} | {"/knee/curves/layer"}
    assert still(written(tmp_path / "one.rrd", drawing, [rows_of(answers[:1])]), "SeriesPoints:marker_sizes") == shown
    assert lists(tmp_path / "one.rrd", "/knee/events", "TextLog:text")[0][1][0].endswith(" s  no events")
    more = written(tmp_path / "two.rrd", drawing, [rows_of(answers[:1]), rows_of(answers[1:2])])
    assert still(more, "SeriesPoints:marker_sizes") == set()


def test_what_is_read_off_is_what_the_model_reads_off(knee: tuple[KneeOutlines, list[Answer]], tmp_path: Path) -> None:
    drawing, answers = knee
    rows = rows_of(answers)
    path = written(tmp_path / "knee.rrd", drawing, [rows[:200], rows[200:]])
    assert drawing.patch is not None
    read = drawing.patch.readouts(drawing.law, rows)
    pressure = column(path, "/knee/curves/pressure", "Scalars:scalars")
    np.testing.assert_array_equal(pressure, 1e-6 * np.stack([read["mean_pressure"], read["peak_pressure"]], axis=1))
    for name, field, factor in (("patch", "half_width", 1e3), ("strain", "strain", 100.0)):
        shown = column(path, f"/knee/curves/{name}", "Scalars:scalars")
        np.testing.assert_array_equal(shown[:, 0], factor * read[field])
    rates = column(path, "/knee/curves/loading_rate", "Scalars:scalars")
    np.testing.assert_array_equal(rates[:, 0], 1e-3 * read["loading_rate"][1:])


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


def test_names_have_units() -> None:
    for plot in PLOTS:
        for series in plot.series:
            assert "[" in series.name or series.name == "evaluations per tick"


def luminance(colour: tuple[int, int, int]) -> float:
    """Relative luminance of the web's contrast formula (WCAG 2)."""
    parts = [part / 255.0 for part in colour]
    linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def test_curves_can_be_seen_in_a_dark_and_in_a_light_viewer() -> None:
    """Rerun follows the user's theme; in a browser that is mostly the light one."""
    for colour in [
        LAYER_COLOUR,
        *(one.colour for one in KNEE_COLOURS),
        *(series.colour for plot in PLOTS for series in plot.series),
    ]:
        light = luminance(colour)
        assert 1.05 / (light + 0.05) > 2.5, colour
        assert (light + 0.05) / (luminance((16, 17, 20)) + 0.05) > 2.5, colour
