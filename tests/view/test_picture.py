"""What a person sees: every view of the scene holds data and shows it."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rerun", reason="needs the extra viewer: pip install 'knee-contact-ros[viewer]'")

from knee_contact_ros.cli.main import main
from knee_contact_ros.view.colours import BONE, CARTILAGE, DEPTH, FORCE, SURFACE
from knee_contact_ros.view.plots import PLOTS
from tests.helpers.viewer import pixels_of, rendered
from tests.view.rrd import entities, lists

PEAK = 2_430_000_000
STAMPS = (530_000_000, 2_460_000_000)
RECORDED = [plot for plot in PLOTS if not plot.live]
SAGITTAL = ("femur", "contact_point", "contact_path", "contact_force_on_femur", "overlap")


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
    for entity, rows in moving.items():
        (component, *_) = sorted(held[entity])
        stamps = [stamp for stamp, _ in lists(scene, entity, component)]
        assert len(stamps) == rows, entity
        assert (stamps[0], stamps[-1]) == STAMPS, entity
    others = {"/knee/curves/layer", "/knee/states/contact", "/knee/states/level", "/knee/events"}
    assert set(held) - set(moving) == others


def test_every_view_shows_something(scene: Path) -> None:
    with rendered(scene) as screen:
        screen.set_time("stamp", PEAK)
        views = screen.views()
        titles = {f"knee: {plot.title[0].lower()}{plot.title[1:]}": plot for plot in RECORDED}
        for title, plot in titles.items():
            picture = screen.picture(title)
            for series in plot.series:
                if series.name.startswith(("contact force", "penetration", "flexion", "anterior", "error", "eval")):
                    assert pixels_of(picture, series.colour, within=40) > 200, (title, series.name)
        plane = screen.picture("knee: sagittal [mm], arrow 50 N/mm")
        close = screen.picture("knee: contact, overlap and path [mm]")
        assert pixels_of(plane, SURFACE, within=30) > 500
        assert pixels_of(plane, FORCE, within=30) > 100
        assert pixels_of(close, CARTILAGE, within=30) > 300  # the overlap: cartilage at its sides, bone in the middle
        assert pixels_of(close, BONE, within=30) > 300
        assert pixels_of(screen.picture("knee: contact and level"), BONE, within=60) > 300
        events = screen.picture("knee: events")
        assert (events.max(axis=2) > 150).sum() > 500  # text
        assert len(views) == len(titles) + 4
        assert all(view.visible for view in views.values())
        assert screen.complaints() == []
        whole = screen.picture()
    assert whole.shape == (900, 1600, 3)
    assert pixels_of(whole, DEPTH, within=20) > 300
