"""The knee as matplotlib draws it: what is written, and that what is drawn is what was answered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.view.picture import (
    SURFACE,
    Moment,
    Window,
    beyond,
    draw_contact,
    draw_knee,
    in_contact_frame,
    posed,
    with_largest,
    write_peak,
)
from tests.offline.test_solve import make_bag, silent

pytest.importorskip("matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7")
KNEES = (
    ("healthy.yaml",),
    ("healthy.yaml", "osteoarthritis.yaml", "mri_femur.yaml"),
    ("healthy.yaml", "mri_knee.yaml"),
)


@pytest.fixture(scope="module", params=KNEES, ids=lambda files: files[-1])
def recording(request: Any, tmp_path_factory: pytest.TempPathFactory, config: Path) -> Path:
    path = tmp_path_factory.mktemp("picture") / "knee.mcap"
    files = [config / name for name in request.param]
    solve(config.parent / "bags" / "gait2354_right", load_parameters(files), path, silent)
    return path


def test_the_picture_is_of_the_largest_load(recording: Path, tmp_path: Path) -> None:
    from PIL import Image

    told = write_peak(recording, tmp_path / "knee.png")
    answers = read_answers(recording)
    peak = answers[int(answers["load"].argmax())]
    assert told.startswith(f"largest load, at {1e-9 * peak['stamp']:.3f} s: ")  # as the table of peaks has it
    assert f"({peak['contact_force']:.0f} N)" in told
    assert f"{1e3 * peak['penetration_depth']:.3f} mm" in told
    assert f"{np.degrees(peak['flexion_angle']):.0f}° of flexion" in told
    with Image.open(tmp_path / "knee.png") as image:
        assert min(image.size) > 700
        pixels = np.asarray(image.convert("RGB")).astype(int)
    surface = [int(SURFACE[i : i + 2], 16) for i in (1, 3, 5)]
    assert (np.abs(pixels - surface) < 6).all(axis=2).sum() > 800  # cartilage is seen, also half a millimetre of it


def test_a_load_that_is_missing_is_not_the_largest(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in recordings of others."""
    answers = read_answers(recording)
    holed = answers.copy()
    holed["load"][[0, 200]] = np.nan
    monkeypatch.setattr("knee_contact_ros.view.picture.answer_blocks", lambda *_: iter([holed[:150], holed[150:]]))
    assert with_largest("load", recording, "/knee_contact")["stamp"] == answers["stamp"][int(answers["load"].argmax())]


def test_where_the_height_drives_the_picture_is_of_the_largest_force(tmp_path: Path) -> None:
    rows = [(i * 5_000_000, 0.1, 800.0) for i in range(20)]
    bag = make_bag(tmp_path / "in.mcap", rows, heights=0.0335 - 1e-5 * np.arange(20.0))
    solve(bag, load_parameters({"drive": "displacement"}), tmp_path / "knee.mcap", silent)
    told = write_peak(tmp_path / "knee.mcap", tmp_path / "knee.png")
    assert told.startswith("largest contact force, at 0.095 s: ")  # all loads are the same


def test_a_stamp_of_today_is_told_from_the_first_one_on(tmp_path: Path) -> None:
    begin = 1_764_027_108_530_000_000
    bag = make_bag(tmp_path / "in.mcap", [(begin + i * 5_000_000, 0.1, 800.0 + i) for i in range(20)])
    solve(bag, load_parameters({}), tmp_path / "knee.mcap", silent)
    told = write_peak(tmp_path / "knee.mcap", tmp_path / "knee.png")
    assert told.startswith("largest load, at +0.095 s: ")  # as the table of peaks has it


def test_of_both_compartments_the_picture_says_which(config: Path, tmp_path: Path) -> None:
    parameters = load_parameters([config / "both_compartments.yaml"])
    solve(config.parent / "bags" / "gait2354_right", parameters, tmp_path / "knee.mcap", silent)
    assert write_peak(tmp_path / "knee.mcap", tmp_path / "knee.png").startswith("medial compartment, largest load, at ")


def test_a_bag_without_answers_is_refused(config: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has no answers"):
        write_peak(config.parent / "bags" / "gait2354_right", tmp_path / "knee.png")
    assert not list(tmp_path.iterdir())


def pressed(config: Path, depth: float, *files: str) -> Moment:
    """A circle on a plane at a depth [m]."""
    model = load_model([config / name for name in ("healthy.yaml", *files)])
    return Moment(model, 0.1, 0.034 - depth, 1000.0, 737.0)


def test_what_is_drawn_is_as_deep_as_it_says(config: Path) -> None:
    shown = pressed(config, 0.7e-3, "osteoarthritis.yaml")
    picture = posed(shown)
    anatomy = picture.anatomy
    overlap = in_contact_frame(picture, picture.overlap)
    # Chords of the drawn outline: half a degree of a circle of 34 mm lies 0.3 µm behind it
    assert np.ptp(overlap[:, 1]) == pytest.approx(0.7, abs=0.01)
    deep = beyond(overlap, 2e3 * anatomy.thickness)
    assert np.ptp(deep[:, 1]) == pytest.approx(0.7 - 0.5, abs=0.01)
    assert np.ptp(deep[:, 0]) < np.ptp(overlap[:, 0])
    assert not len(beyond(overlap, 0.8))


def test_axes_say_depth_and_scale(config: Path) -> None:
    from matplotlib.figure import Figure

    moments = [pressed(config, 0.7e-3), pressed(config, 0.3e-3)]
    window = Window.around(moments)
    assert window == Window.around(moments[::-1])
    for shown, told in zip(moments, ("depth 0.700 mm", "depth 0.300 mm"), strict=True):
        knee, contact = Figure().subplots(2, 1)
        draw_knee(knee, shown)
        draw_contact(contact, shown, window)
        assert {"femur", "tibia", "anterior →", "10 mm", "1.36 BW\n(1000 N)"} <= {
            text.get_text() for text in knee.texts
        }
        assert told in {text.get_text() for text in contact.texts}
        assert contact.get_xlabel() == f"contact, heights × {window.magnification:g}"
        assert contact.get_aspect() == window.magnification
        low, high = contact.get_ylim()
        assert low < -0.7 < 0.0 < high


def test_a_knee_that_is_apart_is_drawn(config: Path) -> None:
    from matplotlib.figure import Figure

    shown = pressed(config, -0.4e-3)._replace(contact_force=0.0)
    knee, contact = Figure().subplots(2, 1)
    draw_knee(knee, shown)
    draw_contact(contact, shown, Window.around([shown]))
    assert "0.400 mm apart" in {text.get_text() for text in contact.texts}
    assert contact.get_ylim()[1] > 0.4  # mm: the femur is seen
