"""The layout: the frame that knees share, what stands beside what, titles and colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")

from knee_contact_ros.model.types import Rows
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.view import layout
from knee_contact_ros.view.anatomy import KneeOutlines, drawing_of, drawings_of, placed
from knee_contact_ros.view.colours import KNEE_COLOURS
from knee_contact_ros.view.layout import DETAILS, KNEE, SOLVER, title_of
from tests.view.scenes import SHIPPED, WEIGHT

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several
Knee = tuple[KneeOutlines, Rows]


def test_knees_of_one_scene_have_one_frame(config: Path) -> None:
    drawings = [drawing_of(load_model([config / file for file in files]), "knee", WEIGHT) for files in SHIPPED]
    ends_of = layout.bounds_of(drawings).range.as_arrow_array().to_pylist()[0].values()
    for drawing in drawings:
        knee = drawing.anatomy
        lowest = knee.femur_cartilage[:, 1].min()
        for angle in (0.0, 1.0):
            points = 1e3 * np.concatenate([placed(knee.femur_bone, angle, 0.0, -lowest), knee.tibia_bone])
            for axis, ends in zip((points[:, 0], -points[:, 1]), ends_of, strict=True):
                assert ends[0] < axis.min() < axis.max() < ends[1]


@pytest.mark.parametrize("changes", [{"tibia.slope": -0.7}, {"tibia.slope": 0.7}, {"femur.radius": 0.2}])
def test_a_steep_or_large_knee_is_seen_whole_with_its_words(changes: dict[str, float]) -> None:
    model = load_model(["healthy", changes])
    drawing = drawing_of(model, "knee", WEIGHT)
    frame = layout.frame_of(drawing)
    for angle in (0.0, 1.0):
        x, _ = model.pair.mechanism.translation(angle)
        touching = model.closest(angle, 1.0)
        height = 1.0 + touching.depth / touching.normal_y  # a circle and a plane: the normal stays
        assert frame.y[0] < -1e3 * placed(drawing.anatomy.femur_bone, angle, x, height)[:, 1].max()
    assert (frame.y[1] - frame.scale[1]) / (frame.y[1] - frame.y[0]) > 0.05  # below the marks, where their words stand


def test_both_compartments_are_drawn_as_one_knee(config: Path) -> None:
    profiles = [{"femur.profile": str(config / f"femur_{side}.csv")} for side in ("medial", "lateral")]
    models = [load_model([config / "mri_femur.yaml", profile]) for profile in profiles]

    def sizes(drawing: KneeOutlines) -> tuple[float, float]:
        """Widths of the femur's shaft and of the tibia [m]."""
        femur = drawing.anatomy.femur_bone
        return float(np.ptp(femur[femur[:, 1] > femur[:, 1].max() - 1e-6, 0])), float(
            np.ptp(drawing.anatomy.tibia_bone[:, 0])
        )

    alone = [sizes(drawing_of(model, "knee", WEIGHT)) for model in models]
    assert alone[1] > tuple(1.1 * size for size in alone[0])
    medial, lateral = map(sizes, drawings_of(models, ["medial", "lateral"], WEIGHT))
    assert medial == pytest.approx(lateral, rel=1e-9)


def test_several_knees_are_told_apart_by_their_colours(knee: Knee) -> None:
    drawing, _ = knee
    both = [drawing._replace(knee="left"), drawing._replace(knee="right", body_weight=800.0)]
    assert title_of(both, KNEE[1]).endswith("[BW of 737 or 800 N]: left blue, right orange")
    still = drawing._replace(knee="circle", contact_range=(0.0, 0.0))
    assert title_of([still, drawing], DETAILS[0]).endswith("[mm]: knee orange")
    assert len({*KNEE_COLOURS.values()}) == len(KNEE_COLOURS)
    four = [drawing._replace(knee=f"{side}_{of}") for side in ("left", "right") for of in ("medial", "lateral")]
    assert title_of(four, KNEE[0]) == (
        "Flexion angle [deg]: left_medial blue, left_lateral orange, right_medial green, right_lateral violet"
    )
    for plot in (*KNEE, *DETAILS, *SOLVER):
        title = title_of(four, plot)
        assert len(title) <= layout.LONGEST_TITLE
        assert title.endswith((": colours as for flexion", "right_lateral violet"))


def test_curves_can_be_seen_in_a_dark_and_in_a_light_viewer() -> None:
    """Rerun follows the user's theme; in a browser that is mostly the light one."""

    def luminance(colour: tuple[int, int, int]) -> float:
        """Relative luminance of the web's contrast formula (WCAG 2)."""
        parts = [part / 255.0 for part in colour]
        linear = [part / 12.92 if part <= 0.03928 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return float(np.dot([0.2126, 0.7152, 0.0722], linear))

    series = {series.colour for plot in (*KNEE, *DETAILS, *SOLVER) for series in plot.series}
    for colour in {layout.LAYER_COLOUR, *KNEE_COLOURS.values(), *series}:
        light = luminance(colour)
        assert 1.05 / (light + 0.05) > 2.5, colour
        assert (light + 0.05) / (luminance((16, 17, 20)) + 0.05) > 2.5, colour
