"""The scene: what is in it, where and when; curves, states, events; frame, titles and colours of the layout."""

import math

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")


from knee_contact_ros import load_model
from knee_contact_ros.model.types import FIRST_DATE, ROW, Rows
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.strides import strides_of
from knee_contact_ros.view import layout, plots
from knee_contact_ros.view.anatomy import (
    OVERLAP_POINTS,
    KneeOutlines,
    outlines_of,
    outlines_of_compartments,
    to_tibia_frame,
)
from knee_contact_ros.view.colours import KNEE_COLOURS
from knee_contact_ros.view.layout import about, plane_title
from knee_contact_ros.view.plots import (
    DETAIL_PLOTS,
    FORCES,
    KNEE_PLOTS,
    SOLVER_PLOTS,
    plots_of,
    title_of,
)
from knee_contact_ros.view.scene import PICTURE_PERIOD, EventFinder
from tests.helpers.answers import contact
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, walking
from tests.view.scenes import (
    SHIPPED,
    WEIGHT,
    answered,
    at,
    column,
    constant,
    entities,
    lists,
    texts_of,
    written,
)

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several
Knee = tuple[KneeOutlines, Rows]
SECOND = 1_000_000_000


def test_entities_are_where_the_answers_are(right_bag, tmp_path):
    names = {
        "translation.mechanism": "parallel_mechanism",
        "tibia.geometry": "circle",
        "load.share": 1.0,
    }
    stream = ContactPipeline(load_parameters(names), compiled=False)
    rows, model = answered(stream, right_bag, 240), stream.model
    path = written(tmp_path / "knee.rrd", outlines_of(model, "knee", WEIGHT), [rows])

    def drawn(entity, component):
        """One vector per tick, y turned from the screen's direction (down) to the tibia's (up)."""
        vectors = column(path, f"/knee/sagittal/{entity}", component).reshape(len(rows), -1)
        return vectors * np.where(np.arange(vectors.shape[1]) == 1, -1.0, 1.0)

    angles, force = rows["flexion_angle"], rows["contact_force"]
    x = np.array([1e3 * model.pair.mechanism.translation(angle)[0] for angle in angles.tolist()])
    point = 1e3 * np.stack([rows["contact_point"]["x"], rows["contact_point"]["y"]], axis=1)
    closest = [
        model.pair.closest(*pose)
        for pose in zip(angles.tolist(), rows["femoral_height"].tolist(), strict=True)
    ]
    arrow = (
        np.array([(where.normal_x, where.normal_y) for where in closest]) * force[:, None] / 50.0
    )  # N per mm
    # Rerun keeps single precision: 6e-8 of lengths of 40 mm, and of quaternions of 1.
    place = np.stack([x, 1e3 * rows["femoral_height"], 0.0 * angles], axis=1)
    assert drawn("femur", "Transform3D:translation") == pytest.approx(place, abs=1e-5)
    for entity, component in (
        ("contact_point", "Points2D:positions"),
        ("contact_path", "Points2D:positions"),
        ("contact_force_on_femur", "Arrows2D:origins"),
    ):
        assert drawn(entity, component) == pytest.approx(point, abs=1e-5)
    assert drawn("contact_force_on_femur", "Arrows2D:vectors") == pytest.approx(arrow, abs=1e-5)
    words = [f"{newtons:.0f} N\n{newtons / WEIGHT:.2f} BW" for newtons in force.tolist()]
    assert texts_of(path, "sagittal/contact_force", "Points2D:labels") == words
    in_front, behind = (
        column(path, f"/knee/{root}/femur", "Transform3D:quaternion")
        for root in ("sagittal", "body")
    )
    assert np.array_equal(in_front, behind)
    quaternion = in_front.reshape(len(rows), 4)
    # Flexion turns the femur from anterior to superior, which is backwards on a screen whose y points down.
    assert 2.0 * np.arctan2(quaternion[:, 2], quaternion[:, 3]) == pytest.approx(-angles, abs=1e-6)
    assert quaternion[:, :2] == pytest.approx(0.0, abs=0.0)
    leg = {
        name: column(path, f"/knee/leg/{name}", part).reshape(len(rows), -1)
        for name, part in (
            ("thigh", "Transform3D:translation"),
            ("contact_force_on_femur", "Arrows3D:vectors"),
        )
    }
    assert leg["thigh"] == pytest.approx(1e-3 * place, abs=1e-8)
    # 0.1 m for a kN.
    assert leg["contact_force_on_femur"][:, :2] == pytest.approx(5e-3 * arrow, abs=3e-8)
    # There is something to see in every one of them.
    assert min(np.ptp(angles), np.ptp(x), np.abs(arrow[:, 0]).max()) > 0.4


def test_the_overlap_is_as_deep_as_the_answers_say(knee, drawn):
    rows = knee[1]
    corners = column(drawn, "/knee/body/overlap", "Mesh3D:vertex_positions")
    # As it is, and magnified: its cartilage, its bone; each along the tibia and along the femur.
    assert corners.shape == (len(rows), 3 * 2 * OVERLAP_POINTS, 3)
    upper, lower, top, cartilage, bone, bottom = corners.reshape(
        len(rows), 6, OVERLAP_POINTS, 3
    ).transpose(1, 0, 2, 3)
    depth, point = 1e3 * rows["penetration_depth"], 1e3 * rows["contact_point"]["x"]
    # 13 points: the deepest is within half a step, 1/24 of the width, and a parabola is 1/144 lower there; the
    # outline's corners cut some micrometres off. On the screen y points down.
    assert (lower - upper)[..., 1].max(axis=1) == pytest.approx(depth, rel=0.01, abs=2e-3)
    assert np.array_equal(upper, top)
    assert (bottom - top)[..., 1].max(axis=1) == pytest.approx(10.0 * depth, rel=0.01, abs=2e-2)
    assert (cartilage - top)[..., 1].max(axis=1) == pytest.approx(
        10.0 * np.minimum(depth, 0.5), rel=0.01, abs=2e-2
    )
    assert np.array_equal(cartilage, bone)
    assert ((upper[:, 0, 0] < point) & (point < upper[:, -1, 0])).all()
    words = [f"{one:.2f} mm deep\ndrawn × 10" for one in depth.tolist()]
    assert texts_of(drawn, "sagittal/depth", "Points2D:labels") == words


def test_apart_there_is_no_overlap_and_the_force_stands_on_the_tibia(tmp_path):
    flying = contact(penetration_depth=0.0, contact_force=0.0, gap=14e-3, femoral_height=0.048)
    rows = np.frombuffer(flying.tobytes() + contact(contact_force=700.0).tobytes(), ROW)
    drawing = outlines_of(load_model({}), "knee", WEIGHT)
    path = written(tmp_path / "knee.rrd", drawing, [at(rows, [0, PICTURE_PERIOD])])
    corners = column(path, "/knee/body/overlap", "Mesh3D:vertex_positions")
    assert corners.shape == (2, 2 * 2 * OVERLAP_POINTS, 3)
    assert np.ptp(corners[0], axis=0) == pytest.approx([0.0, 0.0, 0.0])
    assert texts_of(path, "sagittal/depth", "Points2D:labels")[0] == "14.00 mm apart"
    words, point = (
        column(path, f"/knee/sagittal/{name}", "Points2D:positions").reshape(2, 2)
        for name in ("contact_force", "contact_point")
    )
    # Words stand below their places: in the tibia, not in the gap.
    assert words[0] == pytest.approx(point[0])
    assert words[1, 1] < point[1, 1] - 700.0 / 50.0  # N per mm; the screen's y points down


def test_how_answers_are_cut_into_batches_makes_no_difference(knee, drawn, tmp_path):
    drawing, rows = knee
    cut = written(tmp_path / "cut.rrd", drawing, np.split(rows, [1, 2, 40, 41, 200]))
    assert entities(drawn) == entities(cut)
    for entity, components in entities(drawn).items():
        if entity != "/knee/curves/layer":  # two points of a level line a batch
            for component in components:
                assert lists(drawn, entity, component) == lists(cut, entity, component), (
                    entity,
                    component,
                )


def test_no_more_pictures_than_a_screen_can_show(knee, tmp_path):
    drawing, rows = knee
    fast = at(rows, rows["stamp"][0] + 1_000_000 * np.arange(len(rows)))
    path = written(tmp_path / "knee.rrd", drawing, [fast[:100], fast[100:]])
    assert len(column(path, "/knee/curves/flexion")) == 387
    pictures = lists(path, "/knee/sagittal/femur", "Transform3D:translation")
    assert len(pictures) == math.ceil(387 * 1_000_000 / PICTURE_PERIOD)


def test_every_curve_holds_every_tick(knee, drawn):
    drawing, rows = knee
    # The same arithmetic in another order: a few roundings of 1e-16.
    near = {"rel": 1e-12}
    curves = {
        plot.path: column(drawn, f"/knee/curves/{plot.path}")
        for plot in (*KNEE_PLOTS, *DETAIL_PLOTS, *SOLVER_PLOTS)
        if not (plot.live or plot.from_readouts)
    }
    for plot in (*KNEE_PLOTS, *DETAIL_PLOTS, *SOLVER_PLOTS):
        assert (
            plot.live or plot.from_readouts or curves[plot.path].shape == (387, len(plot.series))
        ), plot
        assert all(
            "[" in series.name or series.name == "evaluations per tick" for series in plot.series
        )
    error, force, uncertain = (
        rows[name] for name in ("error_estimate", "contact_force", "force_error_estimate")
    )
    depth, more = rows["penetration_depth"] - rows["gap"], force - rows["load"]
    assert curves["depth"] == pytest.approx(
        1e3 * np.stack([depth - error, depth + error, depth], 1), **near
    )
    bands = np.stack([force - uncertain, force + uncertain, force, rows["load"], more], 1)
    assert curves["force"] == pytest.approx(bands / WEIGHT, **near)
    assert np.ptp(1e3 * rows["sliding_velocity"]) > 100.0
    for name, values in (
        ("flexion", np.degrees(rows["flexion_angle"])),
        ("contact_point", 1e3 * rows["contact_point"]["x"]),
        ("sliding_velocity", 1e3 * rows["sliding_velocity"]),
        ("evaluations", rows["evaluations"]),
    ):
        assert curves[name][:, 0] == pytest.approx(values, **near)
    assert curves["error"] == pytest.approx(
        np.stack([uncertain, 1e6 * error], 1), nan_ok=True, **near
    )
    assert column(drawn, "/knee/curves/layer").ravel() == pytest.approx([0.5, 0.5])
    assert "/knee/curves/latency" not in entities(drawn)
    assert drawing.patch is not None
    read = drawing.patch.readouts(drawing.law, rows)
    pressure = 1e-6 * np.stack([read["mean_pressure"], read["peak_pressure"]], axis=1)
    np.testing.assert_array_equal(column(drawn, "/knee/curves/pressure"), pressure)
    for name, field, factor in (("patch", "half_width", 1e3), ("strain", "strain", 100.0)):
        np.testing.assert_array_equal(
            column(drawn, f"/knee/curves/{name}")[:, 0], factor * read[field]
        )
    rates = column(drawn, "/knee/curves/loading_rate")
    np.testing.assert_array_equal(rates[:, 0], 1e-3 * read["loading_rate"][1:])


@pytest.mark.parametrize("files", SHIPPED, ids=" ".join)
def test_no_plot_is_flat_and_no_title_empty_for_any_shipped_knee(
    config, right_bag, tmp_path, files
):
    stream = ContactPipeline(load_parameters([config / file for file in files]), compiled=False)
    drawing = outlines_of(stream.model, "knee", WEIGHT)
    rows = answered(stream, right_bag, 150).copy()
    rows["latency"] = 1e-4 * (1.0 + np.arange(len(rows)) % 7)
    path = written(tmp_path / "knee.rrd", drawing, [rows], latency=True)
    with_bone, moving = "osteoarthritis_as_printed.yaml" in files, len(files) > 1
    plots = plots_of(drawing, latency=True)
    assert ("contact_point" in [plot.path for plot in plots]) == moving
    assert (
        ("ripple" in about(drawing))
        == ("rings" in title_of([drawing], KNEE_PLOTS[2]))
        == with_bone
    )
    for plot in plots:
        curve = column(path, f"/knee/curves/{plot.path}")
        assert np.isfinite(curve).all()
        assert np.ptp(curve, axis=0).max() > 0.0, plot.path
        assert ("bone begins" in title_of([drawing], plot)) == (with_bone and plot.path == "depth")
    assert column(path, "/knee/curves/latency").ravel() == pytest.approx(1e3 * rows["latency"])
    curves = {entity for entity in entities(path) if entity.startswith("/knee/curves/")}
    assert curves == {
        f"/knee/curves/{name}" for name in [*(plot.path for plot in plots), *["layer"][:with_bone]]
    }
    assert ("drawn only" in plane_title(drawing)) != with_bone
    assert {"/knee/states/contact", "/knee/states/level"} <= set(entities(path))


def test_where_the_height_drives_no_load_is_drawn(tmp_path):
    model = load_model({"drive": "displacement"})
    time, angle = np.arange(0.0, 0.2, 0.01), np.full(20, 0.3)
    rows = np.asarray(model.run(time, angle, 0.0 * time, 0.0335 - 1e-4 * np.sin(30.0 * time)))
    drawing = outlines_of(model, "knee", WEIGHT)
    (forces,) = (plot for plot in plots_of(drawing, latency=False) if plot.path == FORCES)
    assert title_of([drawing], forces) == "Contact force [BW of 737 N]"
    assert not any("load" in series.name for series in forces.series)
    path = written(tmp_path / "knee.rrd", drawing, [rows])
    assert column(path, f"/knee/curves/{FORCES}").shape == (20, 3)


def test_a_single_answer_is_seen_in_every_plot(knee, tmp_path):
    drawing, rows = knee
    shown = {f"/knee/curves/{plot.path}" for plot in plots_of(drawing, latency=False)} | {
        "/knee/curves/layer"
    }
    one = written(tmp_path / "one.rrd", drawing, [rows[:1]])
    assert constant(one, "SeriesPoints:marker_sizes") == shown
    assert texts_of(one)[0].endswith(" s  no events")
    assert not constant(
        written(tmp_path / "two.rrd", drawing, [rows[:1], rows[1:2]]), "SeriesPoints:marker_sizes"
    )


def test_states_are_written_where_they_change_and_repeated_in_a_server(knee, drawn, tmp_path):
    drawing, rows = knee
    states = [("apart", "cartilage", "bone")[state] for state in rows["contact_state"]]
    changes = [state for i, state in enumerate(states) if i == 0 or state != states[i - 1]]
    assert texts_of(drawn, "states/contact", "StateChange:state") == changes
    assert len(changes) > 3
    parts = [at(rows[:1], SECOND * second) for second in (100, 103, 20, 23)]  # stamps may go back
    path = written(tmp_path / "knee.rrd", drawing, parts, forgetful=True)
    kept = lists(path, "/knee/states/contact", "StateChange:state")
    assert [(stamp // SECOND, state[0]) for stamp, state in kept] == [
        (s, "cartilage") for s in (20, 23, 100, 103)
    ]


def test_stamps_of_today_are_dates_and_a_note_before_the_first_answer_waits_for_its_stamp(
    knee, tmp_path
):
    """A timeline has one kind of time: it is not known before."""
    (drawing, rows), today = knee, FIRST_DATE * 5
    dated = at(rows, today + rows["stamp"])
    path = written(tmp_path / "knee.rrd", drawing, [("reset", {"tick": "0"}), dated])
    assert [stamp for stamp, _ in lists(path, "/knee/curves/flexion", "Scalars:scalars")] == dated[
        "stamp"
    ].tolist()
    assert lists(path, "/knee/events", "TextLog:text")[0] == (
        dated["stamp"][0],
        ["2019-12-20 00:00:00.530  reset"],
    )
    assert "2019-12-20 00:00:02.430  load peak 2.19 BW (1613.8 N)" in texts_of(path)


def test_events_have_their_times(knee, drawn):
    texts = texts_of(drawn)
    assert {
        "2.015 s  load peak 1.81 BW (1337.7 N)",
        "2.430 s  load peak 2.19 BW (1613.8 N)",
        "1.955 s  bone contact begins",
        "2.125 s  bone contact ends",
    } <= set(texts)
    assert [
        sum(words in text for text in texts) for words in ("heel strike", "toe-off", "stride")
    ] == [2, 1, 1]
    phases = lists(drawn, "/knee/states/gait", "StateChange:state")
    assert [(stamp // 1_000_000, phase[0]) for stamp, phase in phases] == [
        (530, "no stride yet"),
        (622, "stance"),
        (1408, "swing"),
        (1854, "stance"),
    ]
    (one,) = strides_of(knee[1], WEIGHT)
    words = f"stride of {one.span.duration:.2f} s: impulse {one.impulse:.1f} N s, stance {one.stance_impulse:.1f} N s"
    assert f"{one.span.end / 1e9:.3f} s  {words}" in texts


def phases(angle, size):
    """Phases [s] of a gait with other angles, whose answers come in batches of this size."""
    stamps, _, load = (each[: len(angle)] for each in walking(200.0, 8.0))
    rows = np.zeros(len(stamps), ROW)
    rows["stamp"], rows["flexion_angle"], rows["load"] = stamps, angle, load
    finder, events = EventFinder(BODY_WEIGHT), []
    for begin in range(0, len(rows), size):
        events += finder.find(rows[begin : begin + size])
    found = sorted([*events, *finder.finish()])
    return [((each.stamp - stamps[0]) / SECOND, each.phase) for each in found if each.phase]


@pytest.mark.parametrize("size", [7, 10_000])
def test_a_phase_that_the_load_contradicts_is_unknown(size):
    stamps, angle, _ = walking(200.0, 8.0)
    right = phases(angle, size)
    for end in range(1080, 1300, 10):  # the run ends around a heel strike
        assert "unknown" not in dict(phases(angle[:end], size)).values()
    assert "unknown" not in dict(right).values()
    time = (stamps - stamps[0]) / SECOND
    lands = (time + 0.2) % STRIDE < 0.9  # the knee neither extends before nor flexes after landing
    bent = phases(np.where(lands, np.maximum(angle, 0.6), angle), size)
    assert [phase for _, phase in bent if phase != "swing"] == 5 * ["unknown"]
    # The sixth stance has 0.34 s at the end: its heel strike might not be known yet
    assert all(phase == ("swing", "unknown")[i % 2] for i, (_, phase) in enumerate(bent))
    stiff = phases(np.minimum(angle, 0.3), size)  # swings with little flexion: no toe-off
    assert [phase for _, phase in stiff] == [*6 * ["stance", "unknown"], "stance"]


def test_knees_of_one_scene_have_one_frame(config):
    drawings = [
        outlines_of(load_model([config / file for file in files]), "knee", WEIGHT)
        for files in SHIPPED
    ]
    ends_of = layout.bounds_of(drawings).range.as_arrow_array().to_pylist()[0].values()
    for drawing in drawings:
        knee = drawing.anatomy
        lowest = knee.femur_cartilage[:, 1].min()
        for angle in (0.0, 1.0):
            points = 1e3 * np.concatenate(
                [to_tibia_frame(knee.femur_bone, angle, 0.0, -lowest), knee.tibia_bone]
            )
            for axis, ends in zip((points[:, 0], -points[:, 1]), ends_of, strict=True):
                assert ends[0] < axis.min() < axis.max() < ends[1]


@pytest.mark.parametrize(
    "changes", [{"tibia.slope": -0.7}, {"tibia.slope": 0.7}, {"femur.radius": 0.2}]
)
def test_a_steep_or_large_knee_is_seen_whole_with_its_words(changes):
    model = load_model(["healthy", changes])
    drawing = outlines_of(model, "knee", WEIGHT)
    frame = layout.frame_of(drawing)
    for angle in (0.0, 1.0):
        x, _ = model.pair.mechanism.translation(angle)
        touching = model.pair.closest(angle, 1.0)
        height = 1.0 + touching.depth / touching.normal_y  # a circle and a plane: the normal stays
        assert (
            frame.y[0]
            < -1e3 * to_tibia_frame(drawing.anatomy.femur_bone, angle, x, height)[:, 1].max()
        )
    # Below the marks, where their words stand.
    assert frame.y[1] - frame.scale[1] > 0.05 * (frame.y[1] - frame.y[0])


def test_both_compartments_are_drawn_as_one_knee(config):
    profiles = [
        {"femur.profile": str(config / f"femur_{side}.csv")} for side in ("medial", "lateral")
    ]
    models = [load_model(["mri_femur", profile]) for profile in profiles]

    def sizes(drawing):
        """Widths of the femur's shaft and of the tibia [m]."""
        femur = drawing.anatomy.femur_bone
        return float(np.ptp(femur[femur[:, 1] > femur[:, 1].max() - 1e-6, 0])), float(
            np.ptp(drawing.anatomy.tibia_bone[:, 0])
        )

    alone = [sizes(outlines_of(model, "knee", WEIGHT)) for model in models]
    assert alone[1] > tuple(1.1 * size for size in alone[0])
    medial, lateral = map(sizes, outlines_of_compartments(models, ["medial", "lateral"], WEIGHT))
    assert medial == pytest.approx(lateral, rel=1e-9)


def test_several_knees_have_different_colours(knee):
    drawing, _ = knee
    both = [drawing._replace(knee="left"), drawing._replace(knee="right", body_weight=800.0)]
    assert title_of(both, KNEE_PLOTS[1]).endswith("[BW of 737 or 800 N]: left blue, right orange")
    thin = drawing._replace(knee="thin", patch=drawing.patch._replace(thickness=2e-3))
    (strain,) = (plot for plot in DETAIL_PLOTS if plot.path == "strain")
    assert title_of([thin], strain) == "Nominal strain of 2 mm of cartilage [%]"
    assert title_of([drawing, thin], strain).startswith("Nominal strain of 0.5 or 2 mm of")
    still = drawing._replace(knee="circle", contact_range=(0.0, 0.0))
    assert title_of([still, drawing], DETAIL_PLOTS[0]).endswith("[mm]: knee orange")
    assert len({*KNEE_COLOURS.values()}) == len(KNEE_COLOURS)
    four = [
        drawing._replace(knee=f"{side}_{of}")
        for side in ("left", "right")
        for of in ("medial", "lateral")
    ]
    assert title_of(four, KNEE_PLOTS[0]) == (
        "Flexion angle [deg]: left_medial blue, left_lateral orange, right_medial green, right_lateral violet"
    )
    for plot in (*KNEE_PLOTS, *DETAIL_PLOTS, *SOLVER_PLOTS):
        title = title_of(four, plot)
        assert len(title) <= plots.LONGEST_TITLE
        assert title.endswith((": colours as for flexion", "right_lateral violet"))


def test_curves_can_be_seen_in_a_dark_and_in_a_light_viewer():
    """Rerun follows the user's theme; in a browser that is mostly the light one."""

    def luminance(colour):
        """Relative luminance of the web's contrast formula (WCAG 2)."""
        parts = [part / 255.0 for part in colour]
        linear = [
            part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts
        ]
        return float(np.dot([0.2126, 0.7152, 0.0722], linear))

    series = {
        series.colour
        for plot in (*KNEE_PLOTS, *DETAIL_PLOTS, *SOLVER_PLOTS)
        for series in plot.series
    }
    for colour in {plots.LAYER_COLOUR, *KNEE_COLOURS.values(), *series}:
        light = luminance(colour)
        assert 1.05 / (light + 0.05) > 2.5, colour
        assert (light + 0.05) / (luminance((16, 17, 20)) + 0.05) > 2.5, colour


def test_before_the_first_answer_no_knee_is_shown(knee, tmp_path):
    """Without a pose the femur would lie in the tibia."""
    drawing, rows = knee
    bones = [
        constant(written(tmp_path / f"{len(each)}.rrd", drawing, each), "Mesh3D:vertex_positions")
        for each in ([], [rows[:1]])
    ]
    assert not bones[0]
    assert "/knee/body/femur/bone" in bones[1]
