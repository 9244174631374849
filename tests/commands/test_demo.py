"""The picture that the demo draws of a recording; the demo itself: `tests/ros`."""

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.view import picture
from tests.helpers.offline import solve
from tests.offline.test_solve import make_bag

pytest.importorskip("rclpy", reason="the demo needs ROS")

from knee_contact_ros.commands import demo
from knee_contact_ros.commands.demo import draw_peak


def drawn(bag, source, folder):
    """Title of the picture `knee.png` of a bag, which is computed first."""
    parameters = load_parameters(source)
    solve(bag, parameters, folder / "knee.mcap")
    return draw_peak(
        folder / "knee.mcap", build_model(parameters), parameters, folder / "knee.png"
    )


@pytest.mark.parametrize(
    "files",
    [["healthy"], ["healthy", "osteoarthritis", "mri_femur"], ["healthy", "mri_knee"]],
    ids=lambda files: files[-1],
)
def test_the_picture_is_of_the_largest_load(files, right_bag, tmp_path):
    from PIL import Image

    title = drawn(right_bag, files, tmp_path)
    answers = read_answers(tmp_path / "knee.mcap")
    peak = answers[int(answers["load"].argmax())]
    # As the table of peaks has it.
    assert title == f"largest load, at {1e-9 * peak['stamp']:.3f} s"
    with Image.open(tmp_path / "knee.png") as image:
        assert min(image.size) > 700
        pixels = np.asarray(image.convert("RGB")).astype(int)
    surface = [int(picture.CARTILAGE_LINE[i : i + 2], 16) for i in (1, 3, 5)]
    # Cartilage is seen, also half a millimetre of it.
    assert (np.abs(pixels - surface) < 6).all(axis=2).sum() > 800


@pytest.mark.parametrize(
    ("begin", "step", "parameters", "heights", "words"),
    [  # where the height drives, of the largest force; a stamp of today from the first one on
        (
            0,
            0.0,
            {"drive": "displacement"},
            0.0335 - 1e-5 * np.arange(20.0),
            "largest contact force, at 0.095 s",
        ),
        (1_764_027_108_530_000_000, 1.0, {}, None, "largest load, at +0.095 s"),
    ],
)
def test_the_title_names_the_largest_value_and_its_time(
    tmp_path, begin, step, parameters, heights, words
):
    rows = [(begin + i * 5_000_000, 0.1, 800.0 + step * i) for i in range(20)]
    assert (
        drawn(make_bag(tmp_path / "in.mcap", rows, heights=heights), parameters, tmp_path) == words
    )


def test_an_answer_without_a_number_is_not_the_largest(tmp_path, monkeypatch):
    bag = make_bag(tmp_path / "in.mcap", [(i * 5_000_000, 0.1, 800.0 + i) for i in range(20)])

    def holed(recording):
        answers = read_answers(recording).copy()
        answers["load"][[0, 19]] = np.nan
        return answers

    monkeypatch.setattr(demo, "read_answers", holed)
    assert drawn(bag, {}, tmp_path) == "largest load, at 0.090 s"


def test_the_title_names_the_compartment(right_bag, tmp_path):
    assert drawn(right_bag, "both_compartments", tmp_path).startswith(
        "medial compartment, largest load, at "
    )
