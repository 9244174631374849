"""What a person sees: every view of the scene holds data and shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="needs the extra viewer: pip install 'knee-contact-ros[viewer]'")

from knee_contact_ros.commands.main import main
from knee_contact_ros.view.colours import BONE, CARTILAGE, COVER, DEPTH, FEMUR, FORCE, TIBIA
from knee_contact_ros.view.layout import DETAILS, KNEE, SOLVER
from tests.helpers.viewer import pixels_of, rendered, wait_for
from tests.view.scenes import entities, lists

PEAK = 2_430_000_000
STAMPS = (530_000_000, 2_460_000_000)
RECORDED = [plot for plot in (*KNEE, *DETAILS, *SOLVER) if not plot.live and plot.path != "loading_rate"]
SAGITTAL = ("femur", "contact_point", "contact_path", "contact_force_on_femur", "contact_force", "depth")
BODY = ("femur", "overlap")
LEG = ("leg/thigh", "leg/contact_force_on_femur")
OTHERS = {"/knee/curves/layer", "/knee/states/gait", "/knee/states/contact", "/knee/states/level", "/knee/events"}


@pytest.fixture(scope="module")
def scene(osteoarthritic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "knee.rrd"
    assert main(["view", str(osteoarthritic), "--save", str(path)]) == 0
    return path


def test_every_view_holds_data(scene: Path) -> None:
    held = entities(scene)
    moving = {f"/knee/curves/{plot.path}": 387 for plot in RECORDED} | {
        f"/knee/sagittal/{name}": 387 for name in SAGITTAL
    }
    moving |= {f"/knee/{path}": 387 for path in (*(f"body/{name}" for name in BODY), *LEG)}
    for entity, rows in moving.items():
        (component, *_) = sorted(held[entity])
        stamps = [stamp for stamp, _ in lists(scene, entity, component)]
        assert len(stamps) == rows, entity
        assert (stamps[0], stamps[-1]) == STAMPS, entity
    rates = lists(scene, "/knee/curves/loading_rate", "Scalars:scalars")
    assert len(rates) == 386  # the first answer has none
    assert set(held) - set(moving) == OTHERS | {"/knee/curves/loading_rate"}


def test_the_first_tab_shows_the_knee_and_its_curves(scene: Path) -> None:
    with rendered(scene) as screen:
        screen.set_time("stamp", PEAK)
        shown = set(screen.views())
        others = {plot.title for plot in (*DETAILS, *SOLVER) if not plot.live}
        others |= {
            "knee: leg and contact force",
            "knee: contact and level",
            "knee: events",
            "What you see",
            "Stance, shaded, and swing",
        }
        assert others < shown
        assert len(shown) == 1 + len(KNEE) + len(others)
        for plot in KNEE:
            (title,) = (name for name in shown if name.startswith(plot.title.split("{")[0]))
            picture = screen.picture(title)
            for series in plot.series:
                if series.name.startswith(("contact force", "depth [", "flexion", "anterior")):
                    assert pixels_of(picture, series.colour, within=40) > 200, (title, series.name)
        plane = screen.picture("knee: sagittal plane, cartilage 2 × 0.25 mm")
        height, width, _ = plane.shape
        assert width > 700  # half of the window
        bones = pixels_of(plane, FEMUR) + pixels_of(plane, TIBIA)
        assert 0.15 < bones / (height * width) < 0.6
        assert pixels_of(plane, FORCE, within=30) > 300
        assert pixels_of(plane, COVER, within=30) > 300
        assert pixels_of(plane, CARTILAGE) > 500  # the overlap, magnified
        assert pixels_of(plane, BONE, within=30) > 30  # 0.04 mm of it, and the contact point
        assert screen.complaints() == []
        whole = screen.picture()
    assert whole.shape == (900, 1600, 3)
    assert pixels_of(whole, DEPTH, within=20) > 300


def test_rerun_alone_draws_the_leg_of_a_recording(osteoarthritic: Path) -> None:
    with rendered(osteoarthritic) as screen:
        wait_for(lambda: not screen.complaints(), "the frames to be connected")
        (space,) = (view for view in screen.state.views if view.view_class == "3D")
        shown = screen.picture(space.name)
    assert pixels_of(shown, (204, 199, 191), within=60) > 200
