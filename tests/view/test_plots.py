"""The plots: every tick, units, legends and colours."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.topics import Answer
from knee_contact_ros.view.anatomy import KneeOutlines, drawing_of
from knee_contact_ros.view.colours import KNEE_COLOURS
from knee_contact_ros.view.layout import (
    DETAILS,
    FORCES,
    KNEE,
    LAYER_COLOUR,
    LONGEST_TITLE,
    READ_OFF,
    plane_title,
    plots_of,
    title_of,
)
from knee_contact_ros.view.viewer import peak_of
from tests.helpers.answers import rows_of
from tests.view.rrd import column, entities, lists, still
from tests.view.scenes import SHIPPED, WEIGHT, answered, written

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several


PLOTS = (*KNEE, *DETAILS)


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
    assert curves["sliding_velocity"][:, 0] == near(sliding, rel=1e-12)
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


@pytest.mark.parametrize("name", SHIPPED)
def test_no_plot_is_flat_and_no_legend_empty_for_any_shipped_knee(
    config: Path, right_bag: Path, tmp_path: Path, name: str
) -> None:
    pipeline = ContactStream(load_parameters([config / file for file in SHIPPED[name]]), compiled=False)
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
