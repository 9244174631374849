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
from knee_contact_ros.view import picture
from knee_contact_ros.view.anatomy import picture_of
from knee_contact_ros.view.picture import magnified, write_peak
from tests.offline.test_solve import make_bag, silent

pytest.importorskip("matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7")
KNEES = (["healthy.yaml"], ["healthy.yaml", "osteoarthritis.yaml", "mri_femur.yaml"], ["healthy.yaml", "mri_knee.yaml"])


@pytest.fixture(scope="module", params=KNEES, ids=lambda files: files[-1])
def recording(request: Any, tmp_path_factory: pytest.TempPathFactory, right_bag: Path, config: Path) -> Path:
    path = tmp_path_factory.mktemp("picture") / "knee.mcap"
    solve(right_bag, load_parameters([config / name for name in request.param]), path, silent)
    return path


def test_the_picture_is_of_the_largest_load(recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image

    told = write_peak(recording, tmp_path / "knee.png")
    answers = read_answers(recording)
    peak = answers[int(answers["load"].argmax())]
    assert told == f"largest load, at {1e-9 * peak['stamp']:.3f} s"  # as the table of peaks has it
    with Image.open(tmp_path / "knee.png") as image:
        assert min(image.size) > 700
        pixels = np.asarray(image.convert("RGB")).astype(int)
    surface = [int(picture.SURFACE[i : i + 2], 16) for i in (1, 3, 5)]
    assert (np.abs(pixels - surface) < 6).all(axis=2).sum() > 800  # cartilage is seen, also half a millimetre of it
    holed = answers.copy()  # a load that is missing, as in recordings of others, is not the largest
    holed["load"][[0, 200]] = np.nan
    monkeypatch.setattr(picture, "read_answers", lambda *_: holed)
    assert write_peak(recording, tmp_path / "knee.png") == told


@pytest.mark.parametrize(
    ("begin", "step", "parameters", "heights", "words"),
    [  # where the height drives, of the largest force; a stamp of today from the first one on
        (0, 0.0, {"drive": "displacement"}, 0.0335 - 1e-5 * np.arange(20.0), "largest contact force, at 0.095 s"),
        (1_764_027_108_530_000_000, 1.0, {}, None, "largest load, at +0.095 s"),
    ],
)
def test_it_says_what_is_largest_and_when(
    tmp_path: Path, begin: int, step: float, parameters: dict[str, str], heights: Any, words: str
) -> None:
    rows = [(begin + i * 5_000_000, 0.1, 800.0 + step * i) for i in range(20)]
    bag = make_bag(tmp_path / "in.mcap", rows, heights=heights)
    solve(bag, load_parameters(parameters), tmp_path / "knee.mcap", silent)
    assert write_peak(tmp_path / "knee.mcap", tmp_path / "knee.png") == words


def test_of_both_compartments_the_picture_says_which_and_a_bag_without_answers_is_refused(
    config: Path, right_bag: Path, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match="has no answers"):
        write_peak(right_bag, tmp_path / "knee.png")
    assert not list(tmp_path.iterdir())
    solve(right_bag, load_parameters([config / "both_compartments.yaml"]), tmp_path / "knee.mcap", silent)
    assert write_peak(tmp_path / "knee.mcap", tmp_path / "knee.png").startswith("medial compartment, largest load, at ")


ANGLE = 0.1


def test_what_is_drawn_is_as_deep_as_it_says() -> None:
    posed = picture_of(load_model(["healthy", "osteoarthritis"]), ANGLE, 0.034 - 0.7e-3)  # a circle on a plane
    # Chords of the drawn outline: half a degree of a circle of 34 mm lies 0.3 µm behind it
    assert np.ptp(posed.overlap[:, 1]) == pytest.approx(0.7e-3, abs=1e-5)
    deep = magnified(posed, np.inf, 0.5e-3)
    assert np.ptp(deep[:, 1]) == pytest.approx(2e-3, abs=1e-4)
    assert np.ptp(magnified(posed, 0.5e-3)[:, 1]) == pytest.approx(5e-3, abs=1e-4)
    assert not len(magnified(posed, np.inf, 0.8e-3))


@pytest.mark.parametrize(("depth", "told"), [(0.7e-3, "0.700 mm deep\n(drawn × 10)"), (-0.4e-3, "0.400 mm apart")])
def test_depth_and_scale_are_told_and_a_knee_that_is_apart_is_drawn(depth: float, told: str) -> None:
    from matplotlib.figure import Figure

    knee = Figure().subplots()
    picture.draw_knee(knee, load_model("healthy"), ANGLE, 0.034 - depth, 1000.0, 737.0)
    texts = {text.get_text() for text in knee.texts}
    assert {"femur", "tibia", "anterior →", "10 mm", "1.36 BW\n(1000 N)", told} <= texts
