"""What a person sees: every view of the scene holds data and shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="needs the extra viewer: pip install 'knee-contact-ros[viewer]'")

from knee_contact_ros.commands.main import main
from knee_contact_ros.view.colours import BONE, CARTILAGE, COVER, DEPTH, FEMUR, FORCE, TIBIA
from knee_contact_ros.view.layout import DETAILS, KNEE, SOLVER
from tests.helpers.viewer import pixels_of, rendered, wait_for

PEAK = 2_430_000_000


@pytest.fixture(scope="module")
def scene(osteoarthritic: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "knee.rrd"
    assert main(["view", str(osteoarthritic), "--save", str(path)]) == 0
    return path


def test_the_first_tab_shows_the_knee_and_its_curves(scene: Path) -> None:
    with rendered(scene) as screen:
        screen.set_time("stamp", PEAK)
        shown = set(screen.views())
        others = {plot.title for plot in (*DETAILS, *SOLVER) if not plot.live}
        others |= {f"knee: {name}" for name in ("leg and contact force", "contact and level", "events")}
        others |= {"What you see", "Stance, shaded, and swing"}
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
